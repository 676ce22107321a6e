"""The command line: `surefoot COMMAND`. Each command is a dataclass; its fields are its options."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, Union

import tyro
from tyro.conf import (
    FlagCreatePairsOff,
    OmitArgPrefixes,
    Positional,
    UseAppendAction,
    arg,
    subcommand,
)

from sim.errors import SurefootError

FilterName = Literal["coverage", "coverage_gml", "velocity", "leg", "leg_slip", "imu"]
Out = Annotated[Path, arg(aliases=["-o"])]


@dataclass(frozen=True)
class Demo:
    """The main job end to end: walk, learn, calibrate, three filters, report, .rrd, trace."""

    out: Out = Path("out/demo")
    """Folder for everything it makes."""
    seed: int = 0
    force: bool = False
    """Overwrite what is in the folder."""

    def run(self) -> None:
        from scenarios.demo import demo

        demo(self.out, self.seed, self.force)


@dataclass(frozen=True)
class Simulate:
    """Walk scenarios, a log for each seed, and an index of them; goes on where it was killed."""

    scenarios: Positional[tuple[Path, ...]]
    """Scenario files (TOML)."""
    out: Out
    """Folder for the logs."""
    robot: str | None = None
    """Robot to walk; the scenario's own where left out."""
    seeds: str = "0"
    """One seed, or a range such as 0:8."""
    effects: Path | None = None
    """File of effects (TOML) to put into the walk."""
    undeclared: bool = False
    """Say nothing of the effects in the logs; truth.toml beside them keeps the answer."""
    workers: int = 1
    """Walks at once on this machine, each on a thread."""
    cluster: str | None = None
    """Address of a Dask scheduler to walk on instead, such as tcp://127.0.0.1:8786."""
    force: bool = False

    def run(self) -> None:
        from scenarios.simulate import simulate_all

        simulate_all(
            self.scenarios,
            self.out,
            self.robot,
            self.seeds,
            self.effects,
            self.undeclared,
            self.force,
            self.workers,
            self.cluster,
        )


@dataclass(frozen=True)
class Train:
    """Train a velocity observer on one or more logs."""

    logs: Positional[tuple[Path, ...]]
    out: Out
    """File for the observer."""
    loss: Literal["mse", "gml"] = "mse"
    """Mean squared error, or Gaussian likelihood, which predicts a covariance too."""
    inputs: Literal["q", "q,dq", "q,dq,tau"] = "q,dq,tau"
    model: Literal["gru"] = "gru"
    seed: int = 0
    force: bool = False

    def run(self) -> None:
        from models.training import train
        from sim.files import refuse_overwrite

        refuse_overwrite(self.out, self.force)
        observer = train(
            _logs(self.logs), inputs=self.inputs, loss=self.loss, seed=self.seed, progress=True
        )
        observer.save(self.out, self.force)
        x, y, z = observer.rmse
        print(
            f"{self.out}: held-out RMSE {x:.4f}, {y:.4f}, {z:.4f} m/s (forward, lateral, vertical)"
        )


@dataclass(frozen=True)
class Calibrate:
    """Bounds on an observer's velocity errors, from a log it has not seen."""

    observer: Positional[Path]
    log: Positional[Path]
    out: Out
    """File for the bounds (JSON)."""
    gamma: float = 0.8
    """Joint level."""
    method: Literal["conformal"] = "conformal"
    force: bool = False

    def run(self) -> None:
        from models.calibration import calibrate
        from models.observer import Observer
        from sim.log import Log

        bounds = calibrate(
            Observer.load(self.observer), Log.read(self.log), self.gamma, self.method
        )
        bounds.save(self.out, self.force)
        x, y, z = bounds.epsilon
        print(
            f"{self.out}: |error| <= {x:.4f}, {y:.4f}, {z:.4f} m/s jointly at gamma "
            f"{bounds.gamma:g} (each axis {bounds.level_per_axis:.4f}), from {bounds.n} errors "
            f"{bounds.K} steps apart"
        )
        if bounds.mixing is not None and not bounds.mixing.mixed:
            print(
                "note: the errors never forget within the longest lag looked at; the bounds rest "
                "on fewer independent samples than they count"
            )


@dataclass(frozen=True)
class Estimate:
    """Run one filter over a log; metrics are printed where the log has a reference."""

    log: Positional[Path]
    filter: FilterName
    robot: str | None = None
    """Name or MJCF file; the log's own where left out."""
    observer: UseAppendAction[tuple[Path, ...]] = ()
    """An observer; may be given twice, once trained with mse and once with gml."""
    bounds: UseAppendAction[tuple[Path, ...]] = ()
    """Bounds; each belongs to one observer."""
    out: Annotated[Path | None, arg(aliases=["-o"])] = None
    """Trajectory with covariances (.parquet); a .tum file is written beside it."""
    force: bool = False

    def run(self) -> None:
        from scenarios.filters import run_filter
        from scenarios.tables import to_markdown
        from sim.files import refuse_overwrite
        from sim.log import Log
        from sim.robot import Robot

        log = Log.read(self.log)
        if self.out:
            if self.out.suffix == ".tum":
                raise SurefootError(f"-o {self.out}: name the .parquet; the .tum goes beside it")
            refuse_overwrite(self.out, self.force)
            refuse_overwrite(self.out.with_suffix(".tum"), self.force)
        robot = Robot.for_log(log, self.robot)
        result = run_filter(self.filter, log, robot, _learnt(self.observer, self.bounds))
        if self.out:
            result.trajectory.write(self.out, self.force)
            result.trajectory.write_tum(self.out.with_suffix(".tum"), self.force)
        if result.metrics is None:
            print(f"{log.name}: {len(log.t)} samples estimated; no reference to judge them by")
        else:
            print(to_markdown([metrics_row(result.metrics)]))


@dataclass(frozen=True)
class Compare:
    """Every filter that the inputs allow on every log: table, figures, report, recordings."""

    logs: Positional[tuple[Path, ...]]
    out: Out
    observer: UseAppendAction[tuple[Path, ...]] = ()
    """An observer; may be given twice, once trained with mse and once with gml."""
    bounds: UseAppendAction[tuple[Path, ...]] = ()
    """Bounds; each belongs to one observer."""
    robot: str | None = None
    force: bool = False

    def run(self) -> None:
        from scenarios.compare import compare_log, prepare_folder, write_comparison
        from scenarios.tables import to_markdown
        from sim.robot import Robot

        learnt = _learnt(self.observer, self.bounds)
        logs = _logs(self.logs)
        names = [log.name for log in logs]
        for path, name in zip(self.logs, names, strict=True):
            if names.count(name) > 1:
                raise SurefootError(f"{path}: another log has its name; give each its own")
        prepare_folder(self.out, self.force)
        found = [compare_log(log, Robot.for_log(log, self.robot), learnt) for log in logs]
        results = write_comparison(found, self.out, "Filters compared", force=self.force)
        print("\n" + to_markdown(results))
        for comparison in found:
            for name, why in comparison.left_out.items():
                print(f"left out on {comparison.log.name}: {name} ({why})")
        print(f"\nreport: {self.out / 'report.html'}")


@dataclass(frozen=True)
class TraceCommand:
    """Find the effect that the model lacks, and report before and after it is added."""

    logs: Positional[tuple[Path, ...]]
    out: Out
    robot: str | None = None
    """Name or MJCF file; the log's own where left out."""
    seed: int = 0
    force: bool = False

    def run(self) -> None:
        from scenarios.progress import percent_bar
        from scenarios.trace import trace
        from scenarios.trace_words import summary
        from sim.robot import Robot

        logs = _logs(self.logs)
        others = sorted({log.meta.robot for log in logs if log.meta.robot})
        if not self.robot and len(others) > 1:
            raise SurefootError(
                f"the logs are of {' and '.join(others)}: trace one robot at a time"
            )
        robot = Robot.for_log(logs[0], self.robot)
        with percent_bar("trace") as tell:
            found = trace(logs, robot, self.out, self.seed, tell, self.force)
        print(summary(found))
        print(f"\nreport: {self.out / 'report.html'}")


@dataclass(frozen=True)
class Montecarlo:
    """The paper's runtime-accuracy and consistency tables, and regimes beyond them."""

    out: Out
    trials: int | None = None
    """Trials in each regime; those of montecarlo.toml where left out."""
    seed: int | None = None
    force: bool = False

    def run(self) -> None:
        from scenarios.montecarlo_report import montecarlo

        montecarlo(self.out, self.trials, self.seed, self.force)
        print((self.out / "table.md").read_text(encoding="utf-8"))
        print(f"report: {self.out / 'report.html'}")


@dataclass(frozen=True)
class Import:
    """A measured log, by a map that says which column is what."""

    kind: Positional[Literal["csv"]]
    file: Positional[Path]
    """The CSV file, or the folder that holds it."""
    map: str
    """Map file (TOML), or the name of one that surefoot ships."""
    out: Out
    """File for the log (.parquet)."""
    force: bool = False

    def run(self) -> None:
        from sim.importer import import_csv

        log = import_csv(self.file, self.map)
        log.write(self.out, self.force)
        groups = [g for g in ("imu", "q", "dq", "tau", "contact", "reference") if log.has(g)]
        print(
            f"{self.out}: {len(log.t)} samples, {log.t[-1] - log.t[0]:.1f} s at {log.rate:.0f} Hz; "
            f"{', '.join(groups)}"
        )


@dataclass(frozen=True)
class View:
    """Open a recording in the rerun viewer."""

    file: Positional[Path]
    web: bool = False
    """Serve it to a browser of this machine, on 127.0.0.1."""

    def run(self) -> None:
        from scenarios.view import view

        view(self.file, self.web)


@dataclass(frozen=True)
class Robots:
    """List the robots that are known by name."""

    def run(self) -> None:
        from scenarios.tables import to_markdown
        from sim.robot import Robot
        from sim.robot_files import known_robots

        rows = []
        for name in known_robots():
            robot = Robot.load(name)
            rows.append(
                {
                    "robot": name,
                    "mass [kg]": robot.mass,
                    "leg [m]": robot.leg_length,
                    "foot radius [m]": robot.foot_radius.mean(),
                    "largest torque [N m]": robot.torque_limit.max(),
                }
            )
        print(to_markdown(rows))


@dataclass(frozen=True)
class Bench:
    """What things cost against what they are measured by, as ratios of one run."""

    rounds: int = 5
    """Times that each pair runs in turn; the smallest counts."""
    only: UseAppendAction[tuple[str, ...]] = ()
    """Items to run; all where left out."""

    def run(self) -> None:
        from scenarios.bench import ITEMS
        from scenarios.progress import percent_bar
        from scenarios.tables import to_markdown

        for name in self.only:
            if name not in ITEMS:
                raise SurefootError(f"--only {name}: known are {', '.join(ITEMS)}")
        if self.rounds < 1:
            raise SurefootError(f"--rounds {self.rounds}: at least 1")
        rows = []
        for name in self.only or ITEMS:
            with percent_bar(name) as tell:
                rows.append(ITEMS[name](self.rounds, tell).as_row())
        print(to_markdown(rows))


COMMANDS: dict[str, type] = {
    "demo": Demo,
    "simulate": Simulate,
    "train": Train,
    "calibrate": Calibrate,
    "estimate": Estimate,
    "compare": Compare,
    "trace": TraceCommand,
    "montecarlo": Montecarlo,
    "import": Import,
    "view": View,
    "robots": Robots,
    "bench": Bench,
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Run one command; bad input is one line on stderr and exit code 1, bad options exit code 2."""
    try:
        choices = tuple(Annotated[c, subcommand(n, prefix_name=False)] for n, c in COMMANDS.items())
        command = tyro.cli(
            Union[choices],  # noqa: UP007  a union made at run time  # pyright: ignore
            prog="surefoot",
            args=arguments,
            config=(FlagCreatePairsOff, OmitArgPrefixes),
        )
        command.run()
    except SurefootError as error:
        sys.exit(f"surefoot: {error}")
    except KeyboardInterrupt:
        sys.exit("surefoot: interrupted")


def metrics_row(m) -> dict[str, float]:
    """The columns of a table row for one trajectory's Metrics."""
    return {
        "APE_trans [m]": m.ape_trans,
        "APE_rot [deg]": m.ape_rot,
        "RPE_trans [m]": m.rpe_trans,
        "RPE_rot [deg/m]": m.rpe_rot,
        "pi<gamma [%]": m.pi_below_gamma,
        "NEES_pos": m.nees_position,
        "NEES_vel": m.nees_velocity,
        "NEES_att": m.nees_attitude,
    }


def _logs(paths: tuple[Path, ...]) -> list:
    from sim.log import Log

    if not paths:
        raise SurefootError("give at least one log")
    return [Log.read(path) for path in paths]


def _learnt(observers: tuple[Path, ...], bounds: tuple[Path, ...]):
    from models.bounds import Bounds
    from models.observer import Observer
    from scenarios.filters import Learnt

    return Learnt(
        tuple(Observer.load(path) for path in observers),
        tuple(Bounds.load(path) for path in bounds),
    )
