"""Commands that train, calibrate and run estimators."""

import sys
from contextlib import nullcontext
from dataclasses import replace
from itertools import chain
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, arg

from surefoot.models.calibration.settings import CalibrateSettings
from surefoot.models.observer.settings import TrainSettings
from surefoot.models.registry import ARCHITECTURES, CALIBRATORS, LOSSES
from surefoot.scenarios.cli import options
from surefoot.scenarios.estimate.estimators import ESTIMATORS
from surefoot.scenarios.settings import (
    CheckedSettings,
    CompareSettings,
    EstimateSettings,
    OutputSettings,
    ScoreSettings,
    WalksSettings,
)
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.plugins import next_command

if TYPE_CHECKING:
    from surefoot.estimator.evaluation.health import Health
    from surefoot.estimator.metrics import Metrics

NOT_TRUSTED = 3
"""Exit code for an estimate that is not to be trusted; 1 is bad input, 2 bad options."""


def _labels(default: str) -> str:
    """Labels of the calibration methods, which are imported when help is printed."""
    methods = CALIBRATORS.usable()[0].items()
    return "; ".join(f"{name}: {kind.label}" for name, kind in methods) + f". (default: {default})"


Method = Annotated[options.one_of(CALIBRATORS), arg(help_behavior_hint=_labels)]


@options.command
class Train(TrainSettings, WalksSettings, CheckedSettings, OutputSettings, options.JsonOption):
    """Train a velocity observer on logs, or on many simulated walks; an interrupted training is
    resumed.
    """

    sources: Annotated[
        Positional[tuple[str, ...]],
        arg(metavar="LOG|SCENARIO...", help_behavior_hint=options.OPTIONAL),
    ] = ()
    """Logs with a reference, of at least ten seconds each; with --walks scenarios, files (TOML) or
    bundled names.
    """
    out: Path
    """File for the observer (.safetensors)."""
    loss: options.one_of(LOSSES) = "mse"  # pyright: ignore[reportInvalidTypeForm]
    inputs: Annotated[str, arg(metavar="INPUTS")] = "q,dq,tau"
    model: options.one_of(ARCHITECTURES) = "gru"  # pyright: ignore[reportInvalidTypeForm]
    start: Annotated[
        Path | None, arg(name="from", metavar="PATH", help_behavior_hint=options.OPTIONAL)
    ] = None
    """Observer to be tuned, such as one from simulated walks on ten seconds of a real one; its
    network, inputs and loss are kept.
    """
    report: Path | None = None
    """Folder for a report: error on unseen walks against the number of walks, up to --walks."""

    def run(self) -> None:
        from msgspec import structs

        from surefoot.models.calibration.regions import walk_enough
        from surefoot.models.observer.observer import Observer
        from surefoot.models.observer.training import partial_path, torch_device, train
        from surefoot.scenarios.estimate.inputs import as_declared, not_plausible, read_logs
        from surefoot.scenarios.training.many_walks import many_walks, write_error_by_walks
        from surefoot.sim.common.files import refuse_full, refuse_overwrite

        refuse_overwrite(self.out, self.force)
        torch_device(self.device)  # before the logs are read
        if not (self.walks or self.sources):
            raise SurefootError("give at least one log, or --walks and a robot or scenarios")
        if self.report and not self.walks:
            raise SurefootError("--report: needs --walks")
        if self.report:
            refuse_full(self.report, self.force)
        partial = partial_path(self.out)
        start = Observer.load(self.start) if self.start else None
        if self.walks:
            logs = many_walks(self, self.sources)
            held_out = list(many_walks(self, self.sources, "held_out"))
            observer = train(logs, None, self, True, partial, held_out, start)
        else:
            recorded = read_logs([Path(one) for one in self.sources], self.robot)
            warnings = not_plausible(recorded, strict=self.strict)
            logs, held_out = None, ()
            observer = train(as_declared(recorded), None, self, True, partial, (), start)
            earlier, given = observer.logs[: -len(recorded)], observer.logs[-len(recorded) :]
            pairs = zip(given, warnings, strict=True)
            given = [structs.replace(one, warnings=lines) for one, lines in pairs]
            observer = replace(observer, logs=(*earlier, *given))
        observer.save(self.out, self.force)
        partial.unlink(missing_ok=True)
        if logs and self.report:
            tests = list(many_walks(self, self.sources, "test"))
            write_error_by_walks(self.report, observer, logs, held_out, tests, self, self.force)
        x, y, z = observer.rmse
        if self.json:
            options.print_json({"observer": self.out, "hash": observer.hash, "rmse": observer.rmse})
            return
        on = f" on {len(held_out)} walks held out" if held_out else ""
        drawn_as = [*self.sources] if self.walks else []
        drawn_as += ["--robot", self.robot] if self.robot else []
        print(
            f"{self.out}: validation RMSE {x:.4f}, {y:.4f}, {z:.4f} m/s "
            f"(forward, lateral, vertical){on}\n"
            f"next: {next_command('calibrate', self.out)} LOG... -o BOUNDS.json; LOG are walks "
            f"that the observer has not seen, of which {walk_enough():g} s with a reference "
            f"suffice; or {' '.join([*drawn_as, '--walks 16'])}"
        )
        if self.report:
            print(f"report: {self.report / 'report.html'}")


@options.command
class Calibrate(
    CalibrateSettings, WalksSettings, CheckedSettings, OutputSettings, options.JsonOption
):
    """Calibrate bounds on an observer's velocity errors, from logs it has not seen."""

    observer: Path
    """Observer, a file from `train`."""
    sources: Annotated[
        Positional[tuple[str, ...]],
        arg(metavar="LOG|SCENARIO...", help_behavior_hint=options.OPTIONAL),
    ] = ()
    """Logs with a reference that the observer was not trained on; errors of several are pooled.
    With --walks, scenarios as in `train`.
    """
    walks: int = 0
    """Number of walks to simulate and calibrate on, instead of logs, drawn like those of `train
    --walks`.
    """
    out: Path
    """File for the bounds (JSON)."""
    method: Method = "conformal"  # pyright: ignore[reportInvalidTypeForm]
    report: Path | None = None
    """Folder for a report: decay of dependence, methods, and coverage on the walks of --on."""
    on: tuple[Path, ...] = ()
    """Logs on which the report evaluates the bounds; needs --report."""
    page: Path | None = None
    """Page of results to write as well, such as docs/results/bounds.md, with its further tables as
    CSV files in docs/data/bounds; needs --report.
    """

    def run(self) -> None:
        from surefoot.models.calibration.calibrate import (
            bounds_on,
            left_out_coverage,
            unseen_errors,
        )
        from surefoot.models.calibration.regions import calibrator
        from surefoot.models.observer.observer import Observer
        from surefoot.scenarios.estimate.inputs import as_declared, not_plausible, read_logs
        from surefoot.scenarios.reporting.calibration_report import write_calibration_report
        from surefoot.scenarios.training.many_walks import many_walks
        from surefoot.sim.common.files import refuse_full, refuse_overwrite, whole_folder

        refuse_overwrite(self.out, self.force)
        for name in ("on", "page"):
            if getattr(self, name) and not self.report:
                raise SurefootError(f"--{name}: needs --report DIR")
        if not (self.walks or self.sources):
            raise SurefootError("give logs, or --walks")
        calibrator(self.method, self.gamma, self.confidence)  # before the work, for a bad level
        paths = () if self.walks else tuple(map(Path, self.sources))
        given, others = (read_logs(each, self.robot) for each in (paths, self.on))
        if self.report:
            refuse_full(self.report, self.force)
        observer = Observer.load(self.observer)
        drawn = replace(self, robot=self.robot or observer.robot)
        recorded = many_walks(drawn, self.sources, "calibrate") if self.walks else given
        warnings = not_plausible(given, strict=self.strict)
        unseen = unseen_errors(observer, as_declared(recorded))
        bounds = bounds_on(observer, unseen, self)
        bounds = replace(bounds, warnings=tuple(chain.from_iterable(warnings)))
        with whole_folder(self.report, self.force) if self.report else nullcontext() as folder:
            if folder:
                write_calibration_report(folder, observer, bounds, recorded, others, self.page)
            bounds.save(self.out, self.force)
        if self.json:
            print(self.out.read_text(encoding="utf-8"))
            return
        print(
            f"{self.out}: {bounds.words}, "
            f"jointly at gamma {bounds.gamma:g} ({bounds.method}, quantile "
            f"{bounds.level_per_axis:.4f}), from {bounds.n} errors {bounds.K} steps of 10 ms apart"
        )
        if len(recorded) > 1:
            shares = left_out_coverage(unseen.relative, self, bounds.K)
            held = dict(zip(unseen.names, shares, strict=True))
            worst = min(held, key=lambda name: held[name])
            print(
                f"on each walk by bounds from the others: {100 * fmean(held.values()):.0f} "
                f"% of its errors on average, at least {100 * held[worst]:.0f} % ({worst})"
            )
        if bounds.mixing is not None and not bounds.mixing.mixed:
            print(
                "note: the errors stay correlated over the longest lag examined; the bounds rest "
                "on fewer independent samples than they count; more walks mend that"
            )
        if self.report:
            print(f"report: {self.report / 'report.html'}")


@options.command
class Estimate(EstimateSettings, options.TableOption):
    """Run one filter over a log; prints metrics if the log has a reference.

    Exit code 3: the trajectory is written, but is not to be trusted; the last line says why.
    """

    filter: Annotated[str, arg(metavar="NAME", help=f"One of {', '.join(ESTIMATORS)}.")]

    def run(self) -> None:
        from surefoot.scenarios.estimate.file import estimate_file

        found, health, advice = estimate_file(self)
        if self.json:
            values = {"log": self.log, "filter": self.filter, "trajectory": self.out}
            why = {"trusted": not health.lost, "why_not": health.sentence(self.filter)}
            options.print_json(
                values | why | {"advice": advice, "metrics": found, "health": health}
            )
        else:
            self._show(found, health)
            tum = "" if self.out is None else self.out.with_suffix(".tum")
            print(
                f"trajectory: {self.out}, {tum}" if tum else "no trajectory is kept: give -o FILE"
            )
        if advice:
            print(f"advice: {advice}", file=sys.stderr)
        if health.lost:
            print(health.sentence(self.filter), file=sys.stderr)
            sys.exit(NOT_TRUSTED)

    def _show(self, found: "Metrics | None", health: "Health") -> None:
        from surefoot.scenarios.reporting.tables import in_terminal, metrics_row
        from surefoot.sim.log import LogReader

        if found is not None:
            print(in_terminal([metrics_row(found)], self.wide))
        elif not health.lost:
            rows = LogReader(self.log).rows
            print(f"{self.log.stem}: {rows} samples estimated; no reference to compare with")
        if health.sensors:
            print("\n" + in_terminal(health.table(), self.wide))
        b_a, b_g = health.biases[:3].max(), health.biases[3:].max()
        print(
            f"\nbiases moved by at most {b_a:.1f} (accelerometer) and {b_g:.1f} (gyro) standard "
            "deviations of their prior and random walk"
        )


@options.command
class NoiseCommand(OutputSettings, options.JsonOption):
    """Estimate the sensor noise of a log in which the robot rests, as settings of the filters."""

    log: Path
    """Log in which the robot rests; the random walks of the biases need a minute or more."""
    out: Path | None = None
    """File for the settings (.toml), which --settings reads; the Allan deviations are plotted in a
    .png file beside it.
    """

    def run(self) -> None:
        from surefoot.scenarios.noise import noise, noise_text
        from surefoot.sim.log import Log

        log = Log.read(self.log)
        found = noise(log, self.out, self.force)
        options.print_json(found) if self.json else print(noise_text(log.name, found))


@options.command
class Compare(CompareSettings, options.TableOption):
    """Run every filter that the inputs allow on every log: table, figures, report, recordings.

    The table on the terminal has the columns that fit; table.md and table.csv have all.
    """

    def run(self) -> None:
        from surefoot.scenarios.compare import compare_files, left_out_lines
        from surefoot.scenarios.reporting.tables import in_terminal

        results, found = compare_files(self)
        if self.json:
            each = {
                name: {one.log.name: getattr(one, name) for one in found}
                for name in ("left_out", "doubts", "notes")
            }
            options.print_json({"results": results.to_dict(orient="records"), **each})
            return
        print("\n" + in_terminal(results, self.wide))
        for line in left_out_lines(found):
            print(line)
        for comparison in found:
            for words in (*comparison.notes, *comparison.doubts):
                print(f"{comparison.log.name}: {words}")
        if any(comparison.doubts for comparison in found):
            print("surefoot estimate LOG --filter NAME tries what would mend a filter")
        print(f"\nreport: {self.out / 'report.html'}")


@options.command
class Score(ScoreSettings, options.TableOption):
    """Evaluate anyone's estimates of a log: errors, consistency and coverage, on one page."""

    log: Annotated[Path, arg(metavar="LOG")]
    """Log with the reference."""

    def run(self) -> None:
        from surefoot.scenarios.reporting.tables import in_terminal
        from surefoot.scenarios.score import score

        found = score(self)
        if self.json:
            options.print_json(found.to_dict(orient="records"))
            return
        print(in_terminal(found, self.wide))
        print(f"\nreport: {self.out / 'report.html'}")
