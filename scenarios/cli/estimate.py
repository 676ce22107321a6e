"""Commands that train, calibrate and run estimators."""

import sys
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import Positional, arg

from surefoot.models.calibration.settings import CalibrateSettings
from surefoot.models.observer.settings import TrainSettings
from surefoot.models.registry import ARCHITECTURES, CALIBRATORS, LOSSES
from surefoot.scenarios.cli import options
from surefoot.scenarios.estimate.estimators import ESTIMATORS
from surefoot.sim.common.errors import SurefootError

if TYPE_CHECKING:
    from surefoot.estimator.evaluation.health import Health
    from surefoot.estimator.metrics import Metrics

NOT_TRUSTED = 3
"""Exit code for an estimate that is not to be trusted; 1 is bad input, 2 bad options."""


def _labels(default: str) -> str:
    """Labels of the calibration methods, which are imported when help is printed."""
    methods = CALIBRATORS.usable()[0].items()
    return "; ".join(f"{name}: {kind.label}" for name, kind in methods) + f". (default: {default})"


def _walk_enough(gamma: str) -> str:
    from surefoot.models.calibration.walk_length import walk_enough

    seconds = walk_enough(float(gamma))
    return f"{seconds:g} s of walk with a reference suffice at {gamma}. (default: {gamma})"


InputNames = Literal["q", "q,dq", "q,dq,tau", "feet", "tau,feet", "q,dq,tau,feet"]
Method = Annotated[options.one_of(CALIBRATORS), arg(help_behavior_hint=_labels)]


@options.command
class Train(TrainSettings):
    """Train a velocity observer on one or more logs; an interrupted training is resumed."""

    logs: options.Logs
    """Logs with a reference, of at least ten seconds each."""
    out: Path
    """File for the observer (.pt)."""
    loss: options.one_of(LOSSES) = "mse"  # pyright: ignore[reportInvalidTypeForm]
    inputs: Annotated[InputNames, arg(metavar="INPUTS")] = "q,dq,tau"
    model: options.one_of(ARCHITECTURES) = "gru"  # pyright: ignore[reportInvalidTypeForm]
    robot: options.RobotName = None
    strict: options.Strict = False
    as_json: options.Json = False
    force: options.Force = False

    def run(self) -> None:
        from surefoot.models.calibration.walk_length import walk_enough
        from surefoot.models.observer.device import torch_device
        from surefoot.models.observer.training import partial_path, train
        from surefoot.sim.common.files import refuse_overwrite

        refuse_overwrite(self.out, self.force)
        torch_device(self.device)  # before the logs are read
        recorded = options.read_logs(self.logs, self.robot)
        warnings = options.not_plausible(recorded, strict=self.strict)
        partial = partial_path(self.out)
        observer = train(options.as_declared(recorded), None, self, True, partial)
        seen = [replace(one, warnings=warnings.get(one.name, ())) for one in observer.logs]
        observer = replace(observer, logs=tuple(seen))
        observer.save(self.out, self.force)
        partial.unlink(missing_ok=True)
        x, y, z = observer.rmse
        if self.as_json:
            options.print_json({"observer": self.out, "hash": observer.hash, "rmse": observer.rmse})
            return
        print(
            f"{self.out}: validation RMSE {x:.4f}, {y:.4f}, {z:.4f} m/s "
            "(forward, lateral, vertical)\n"
            f"next: surefoot calibrate {self.out} LOG -o BOUNDS.json; LOG is a walk that the "
            f"observer has not seen, of which {walk_enough():g} s with a reference suffice"
        )


@options.command
class Calibrate(CalibrateSettings):
    """Calibrate bounds on an observer's velocity errors, from a log it has not seen."""

    observer: Annotated[Positional[Path], arg(metavar="OBSERVER")]
    """Observer, a file from `train`."""
    log: Annotated[Positional[Path], arg(metavar="LOG")]
    """Log with a reference that the observer was not trained on."""
    out: Path
    """File for the bounds (JSON)."""
    gamma: Annotated[float, arg(help_behavior_hint=_walk_enough)] = 0.8
    method: Method = "conformal"  # pyright: ignore[reportInvalidTypeForm]
    report: Path | None = None
    """Folder for a report: decay of dependence, methods, and coverage on the walks of --on."""
    on: Annotated[tuple[Path, ...], arg(metavar="LOG...", help_behavior_hint=options.OPTIONAL)] = ()
    """Logs on which the report evaluates the bounds; needs --report."""
    page: Path | None = None
    """Page of results to write as well, such as docs/results/bounds.md; needs --report."""
    robot: options.RobotName = None
    strict: options.Strict = False
    as_json: options.Json = False
    force: options.Force = False

    def run(self) -> None:
        from surefoot.models.calibration.calibrate import calibrate
        from surefoot.models.observer.observer import Observer
        from surefoot.scenarios.reporting.calibration_report import write_calibration_report
        from surefoot.sim.common.files import refuse_full, refuse_overwrite, whole_folder

        refuse_overwrite(self.out, self.force)
        for name in ("on", "page"):
            if getattr(self, name) and not self.report:
                raise SurefootError(f"--{name}: needs --report DIR")
        recorded = options.read_logs((self.log, *self.on), self.robot)
        if self.report:
            refuse_full(self.report, self.force)
        observer = Observer.load(self.observer)
        log = recorded[0]
        warnings = options.not_plausible([log], strict=self.strict).get(log.name, ())
        (log,) = options.as_declared([log])
        bounds = replace(calibrate(observer, log, self), warnings=warnings)
        with whole_folder(self.report, self.force) if self.report else nullcontext() as folder:
            if folder:
                write_calibration_report(folder, observer, bounds, recorded, self.page)
            bounds.save(self.out, self.force)
        if self.as_json:
            print(self.out.read_text(encoding="utf-8"))
            return
        x, y, z = bounds.epsilon
        print(
            f"{self.out}: |error| <= {x:.4f}, {y:.4f}, {z:.4f} m/s (forward, lateral, vertical), "
            f"jointly at gamma {bounds.gamma:g} ({bounds.method}, quantile "
            f"{bounds.level_per_axis:.4f}), from {bounds.n} errors {bounds.K} steps of 10 ms apart"
        )
        if bounds.mixing is not None and not bounds.mixing.mixed:
            print(
                "note: the errors stay correlated over the longest lag examined; the bounds rest "
                "on fewer independent samples than they count"
            )
        if self.report:
            print(f"report: {self.report / 'report.html'}")


@options.command
class Estimate:
    """Run one filter over a log; prints metrics if the log has a reference.

    Exit code 3: the trajectory is written, but is not to be trusted; the last line says why.
    """

    log: Annotated[Positional[Path], arg(metavar="LOG")]
    """Log with IMU, and with what the filter needs besides."""
    filter: Annotated[str, arg(metavar="NAME", help=f"One of {', '.join(ESTIMATORS)}.")]
    robot: options.RobotName = None
    observer: options.Observers = ()
    bounds: options.BoundsFiles = ()
    out: Path | None = None
    """File for the trajectory with covariances (.parquet); its poses are also written beside it as
    a .tum file.
    """
    settings: options.SettingsFile = None
    set_lines: options.SettingLines = ()
    strict: options.Strict = False
    as_json: options.Json = False
    force: options.Force = False

    def run(self) -> None:
        from surefoot.scenarios.estimate.file import TrajectoryFile, estimate_file, first_minutes
        from surefoot.scenarios.estimate.settings import read_settings
        from surefoot.sim.common.files import refuse_overwrite
        from surefoot.sim.log import LogReader

        reader = LogReader(self.log)
        if self.out:
            refuse_overwrite(self.out, self.force)
            if self.out.suffix != ".parquet":
                raise SurefootError(
                    f"-o {self.out}: give a .parquet file; the .tum is written beside it, and "
                    "`surefoot export` writes CSV or MCAP"
                )
            refuse_overwrite(self.out.with_suffix(".tum"), self.force)
        learnt = options.learnt_from(self.observer, self.bounds)
        settings = read_settings(self.settings, self.set_lines)
        warnings = options.not_plausible([first_minutes(reader)], self.robot, self.strict)
        doubted = tuple(warnings.get(self.log.stem, ()))
        out = TrajectoryFile(self.out, self.force, doubted) if self.out else None
        found, health = estimate_file(self.filter, reader, self.robot, learnt, settings, out)
        if self.as_json:
            values = {"log": self.log, "filter": self.filter, "trajectory": self.out}
            why = {"trusted": not health.lost, "why_not": health.sentence(self.filter)}
            options.print_json(values | why | {"metrics": found, "health": health})
        else:
            self._show(found, health, reader.rows)
        if health.lost:
            print(health.sentence(self.filter), file=sys.stderr)
            sys.exit(NOT_TRUSTED)

    def _show(self, found: "Metrics | None", health: "Health", rows: int) -> None:
        from surefoot.scenarios.reporting.tables import metrics_row, to_markdown

        if found is not None:
            print(to_markdown([metrics_row(found)]))
        elif not health.lost:
            print(f"{self.log.stem}: {rows} samples estimated; no reference to compare with")
        if health.sensors:
            print("\n" + to_markdown(health.table()))
        b_a, b_g = health.biases[:3].max(), health.biases[3:].max()
        print(
            f"\nbiases moved by at most {b_a:.1f} (accelerometer) and {b_g:.1f} (gyro) standard "
            "deviations of their prior and random walk"
        )


@options.command
class NoiseCommand:
    """Estimate the sensor noise of a log in which the robot rests, as settings of the filters."""

    log: Annotated[Positional[Path], arg(metavar="LOG")]
    """Log in which the robot rests; the random walks of the biases need a minute or more."""
    out: Path | None = None
    """File for the settings (.toml), which --settings reads; the Allan deviations are plotted in a
    .png file beside it.
    """
    as_json: options.Json = False
    force: options.Force = False

    def run(self) -> None:
        from surefoot.scenarios.noise import noise, noise_text
        from surefoot.sim.log import Log

        log = Log.read(self.log)
        found = noise(log, self.out, self.force)
        options.print_json(found) if self.as_json else print(noise_text(log.name, found))


@options.command
class Compare:
    """Run every filter that the inputs allow on every log: table, figures, report, recordings."""

    logs: options.Logs
    """Logs to compare the filters on; errors are computed for those with a reference."""
    out: Path
    """Folder for table.csv, table.md, report.html, figures and recordings."""
    observer: options.Observers = ()
    bounds: options.BoundsFiles = ()
    robot: options.RobotName = None
    settings: options.SettingsFile = None
    set_lines: options.SettingLines = ()
    strict: options.Strict = False
    as_json: options.Json = False
    force: options.Force = False

    def run(self) -> None:
        from surefoot.scenarios.compare import compare_log, left_out_lines, write_comparison
        from surefoot.scenarios.estimate.run import robot_of
        from surefoot.scenarios.estimate.settings import read_settings
        from surefoot.scenarios.reporting.tables import to_markdown
        from surefoot.sim.common.files import refuse_full, whole_folder

        refuse_full(self.out, self.force)
        learnt = options.learnt_from(self.observer, self.bounds)
        logs = options.read_logs(self.logs)
        names = [log.name for log in logs]
        for path, name in zip(self.logs, names, strict=True):
            if names.count(name) > 1:
                raise SurefootError(f"{path}: another log has the same name; rename one of them")
        settings = read_settings(self.settings, self.set_lines)
        warnings = options.not_plausible(logs, self.robot, self.strict)
        found = [
            compare_log(log, robot_of(log, self.robot), learnt, settings=settings) for log in logs
        ]
        found = [replace(one, warnings=warnings.get(one.log.name, ())) for one in found]
        with whole_folder(self.out, self.force) as folder:
            results = write_comparison(found, folder, "Filters compared")
        if self.as_json:
            left_out = {one.log.name: one.left_out for one in found}
            doubts = {one.log.name: one.doubts for one in found}
            rows = results.to_dict(orient="records")
            options.print_json({"results": rows, "left_out": left_out, "doubts": doubts})
            return
        print("\n" + to_markdown(results))
        for comparison in found:
            for line in left_out_lines(comparison.log.name, comparison.left_out):
                print(line)
            for words in comparison.doubts:
                print(f"{comparison.log.name}: {words}")
        print(f"\nreport: {self.out / 'report.html'}")
