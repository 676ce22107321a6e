"""Commands that run a whole workflow: the demo, traces, experiments and studies."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, UseAppendAction, arg

from surefoot.scenarios.cli.named import EFFECT_NAMES
from surefoot.scenarios.cli.options import (
    NEEDED,
    BoundsFiles,
    Cluster,
    Declared,
    Force,
    Holdout,
    Json,
    Logs,
    Observers,
    OptionalInt,
    OptionalNamed,
    OptionalPath,
    OptionalSeeds,
    Out,
    RobotName,
    Strict,
    Workers,
    learnt_from,
    not_plausible,
    print_json,
    read_logs,
)
from surefoot.scenarios.experiments.catalog import SUITES, experiment_file
from surefoot.sim.common.errors import SurefootError, did_you_mean


@dataclass(frozen=True)
class Demo:
    """The whole workflow: walk, train, calibrate, compare filters, report, recording, trace."""

    out: Out = Path("out/demo")
    """Folder for all outputs."""
    seed: int = 0
    """Seed of walks and trainings."""
    force: Force = False

    def run(self) -> None:
        from surefoot.scenarios.demo import demo

        demo(self.out, self.seed, self.force)


@dataclass(frozen=True)
class TraceCommand:
    """Find the effect that a model lacks; reports errors before and after it is added."""

    logs: Logs
    """Logs of one robot, traced together."""
    out: Out
    """Folder for trace.json, effects.toml, report.html and trace.rrd."""
    robot: RobotName = None
    declared: Declared = None
    holdout: Holdout = ()
    seed: int = 0
    """Seed of the bootstrap for the intervals."""
    strict: Strict = False
    force: Force = False

    def run(self) -> None:
        from surefoot.scenarios.reporting.progress import percent_bar
        from surefoot.scenarios.trace.long_logs import note_on_blocks, read_in_blocks
        from surefoot.scenarios.trace.run import trace
        from surefoot.scenarios.trace.since import unchanged_beside
        from surefoot.scenarios.trace.words import summary
        from surefoot.sim.effects.file import load_effects
        from surefoot.sim.robot.fixed_base import machine_for_log

        if not self.logs:
            raise SurefootError("give at least one log")
        read = [read_in_blocks(path) for path in self.logs]
        read_holdout = [read_in_blocks(path) for path in self.holdout]
        logs, held_out = ([log for own in runs for log in own] for runs in (read, read_holdout))
        declared = None if self.declared is None else load_effects(self.declared)
        robots = sorted({log.meta.robot for log in [*logs, *held_out] if log.meta.robot})
        if not self.robot and len(robots) > 1:
            raise SurefootError(
                f"the logs are of {' and '.join(robots)}: trace one robot at a time"
            )
        first = [blocks[0] for blocks in (*read, *read_holdout)]
        robot, *_ = [machine_for_log(log, self.robot) for log in first]
        # The first block of a long log is checked, as `estimate` checks its first minutes.
        warnings = not_plausible(first, self.robot, self.strict)
        # A trace must not depend on the names of its logs, so its notes number them.
        notes = tuple(
            f"log {k + 1}: {line}" if len(first) > 1 else line
            for k, log in enumerate(first)
            for line in warnings.get(log.name, ())
        )
        with percent_bar("trace") as progress:
            found = trace(
                logs,
                robot,
                self.out,
                self.seed,
                progress,
                self.force,
                declared=declared,
                holdout=held_out,
                warnings=(*notes, *note_on_blocks([*read, *read_holdout])),
                since=unchanged_beside(self.declared, declared or ()) if self.declared else None,
            )
        print(summary(found))
        print(f"\nreport: {self.out / 'report.html'}")


@dataclass(frozen=True)
class LoopCommand:
    """Trace a log, add the effects found to the simulation, retrain, and estimate the log again."""

    log: Annotated[Positional[Path], arg(metavar="LOG")]
    """A log with IMU, joint angles and reference."""
    out: Out
    """Folder for all outputs; an interrupted run is resumed from it."""
    robot: RobotName = None
    declared: Declared = None
    holdout: Holdout = ()
    seed: int = 0
    """Seed of walks, training and intervals."""
    page: OptionalPath = None
    """Page of results to write as well, such as docs/results/loop.md."""
    force: Force = False

    def run(self) -> None:
        from surefoot.scenarios.reporting.tables import to_markdown
        from surefoot.scenarios.trace.loop import loop
        from surefoot.sim.effects.file import load_effects
        from surefoot.sim.log import Log
        from surefoot.sim.robot import Robot

        log = Log.read(self.log)
        robot = Robot.for_log(log, self.robot)
        declared = None if self.declared is None else load_effects(self.declared)
        held_out = read_logs(self.holdout) if self.holdout else []
        table, _ = loop(
            log,
            robot,
            self.out,
            self.seed,
            self.force,
            declared=declared,
            holdout=held_out,
            page=self.page,
        )
        print("\n" + to_markdown(table))
        print(f"\nreport: {self.out / 'report.html'}")


@dataclass(frozen=True)
class Realism:
    """Compare a measured log with simulated walks in its style, quantity by quantity."""

    log: Annotated[Positional[Path], arg(metavar="LOG")]
    """A log with IMU, joint angles, contacts and reference."""
    out: Out
    """Folder for realism.json, realism.csv, drift.csv, table.md and report.html."""
    robot: RobotName = None
    effects: OptionalPath = None
    """File of effects (TOML) for the simulated robot."""
    as_walked: bool = False
    """Also compare walks with the gait, sensors and effects measured on a real robot; the effects
    are those of --effects if given.
    """
    walker: OptionalNamed = None
    """Another robot to simulate; measured values are scaled to it."""
    seed: int = 0
    """Seed of the walks and the intervals."""
    page: OptionalPath = None
    """Page of results to write as well, such as docs/results/realism.md."""
    force: Force = False

    def run(self) -> None:
        from surefoot.scenarios.experiments.as_walked import load_as_walked
        from surefoot.scenarios.reporting.progress import percent_bar
        from surefoot.scenarios.reporting.tables import to_markdown
        from surefoot.scenarios.trace.realism import card_table, realism
        from surefoot.sim.effects.file import load_effects
        from surefoot.sim.log import Log
        from surefoot.sim.robot import Robot

        log = Log.read(self.log)
        robot = Robot.for_log(log, self.robot)
        effects = load_effects(self.effects) if self.effects else ()
        with percent_bar("walking") as bar:
            found = realism(
                log,
                robot,
                self.out,
                effects,
                load_as_walked() if self.as_walked else None,
                Robot.load(self.walker) if self.walker else None,
                seed=self.seed,
                page=self.page,
                force=self.force,
                progress=bar,
            )
        for one in found:
            print(f"\n{one.words}\n\n{to_markdown(card_table(one.card))}")
            for name, why in one.card.missing.items():
                print(f"missing: {name}: {why}")
        print(f"\nreport: {self.out / 'report.html'}")


@dataclass(frozen=True, kw_only=True)
class GridOptions:
    """Options shared by `experiment` and `suite`."""

    out: Out
    """Folder for tables, report and recordings."""
    workers: Workers = 1
    seeds: OptionalSeeds = None
    """One seed, or a range such as 0:8; by default the file's (three in a suite)."""
    cache: OptionalPath = None
    """Folder of intermediate products, reused by later runs; by default `cache` in the output."""
    recordings: bool = True
    """Whether to write a rerun recording of each sequence."""
    page: OptionalPath = None
    """Page of results to write as well, such as docs/results/suite_spot.md."""
    data: OptionalPath = None
    """Folder of finished rows, one for each walk, which are reused; such as docs/data/spot."""
    force: bool = False
    """Write tables and report again; cached products are reused."""

    def experiment(self, file: str) -> None:
        from surefoot.scenarios.experiments.report import experiment

        experiment(
            file,
            self.out,
            self.workers,
            self.seeds,
            self.cache,
            self.recordings,
            self.force,
            self.page,
            self.data,
        )


@dataclass(frozen=True, kw_only=True)
class ExperimentCommand(GridOptions):
    """A grid over scenarios, robots, conditions, gamma, filters and seeds: one tidy table."""

    file: Annotated[Positional[str], arg(metavar="FILE")]
    """Experiment file (TOML), or the name of a bundled one: spot, vision60."""

    def run(self) -> None:
        experiment_file(self.file)  # before anything heavy is imported
        self.experiment(self.file)


@dataclass(frozen=True, kw_only=True)
class Suite(GridOptions):
    """Reproduce the paper's two tables on the simulated suites, from simulation to table."""

    name: Annotated[Positional[str], arg(metavar=f"{{{','.join(SUITES)}}}")]

    def run(self) -> None:
        if self.name not in SUITES:
            known = f"known: {', '.join(SUITES)}{did_you_mean(self.name, SUITES)}"
            raise SurefootError(f"unknown suite '{self.name}'; {known}")
        self.experiment(self.name)


@dataclass(frozen=True)
class Montecarlo:
    """Reproduce the paper's runtime-accuracy and consistency tables, with further regimes."""

    out: Out
    trials: OptionalInt = None
    """Trials in each regime; by default those of montecarlo.toml."""
    seed: OptionalInt = None
    workers: OptionalInt = None
    """Processes on this machine; by default one for each core."""
    cluster: Cluster = None
    data: OptionalPath = None
    """Folder of finished regimes, which are reused; by default `cases` in the output."""
    page: OptionalPath = None
    """Page of results to write as well, such as docs/results/montecarlo.md."""
    force: Force = False

    def run(self) -> None:
        from surefoot.scenarios.studies.montecarlo.report import montecarlo

        text = montecarlo(
            self.out,
            self.trials,
            self.seed,
            self.force,
            self.workers,
            self.cluster,
            self.data,
            self.page,
        )
        print(text)
        print(f"report: {self.out / 'report.html'}")


@dataclass(frozen=True)
class Walking:
    """Measure how robots walk: falls, tracking, slip, creep and pace on four grounds and courses.

    Without --robot and --course: every known robot, and the courses of both suites.
    """

    out: Out
    robot: UseAppendAction[tuple[str, ...]] = ()
    """Name, MJCF or URDF; it walks on flat ground, a slope, a slippery patch and stairs."""
    course: UseAppendAction[tuple[str, ...]] = ()
    """Scenario (file or bundled name), walked by its own robot with every seed."""
    seeds: int = 5
    """Seeds of each course, from 0."""
    workers: Workers = 1
    data: OptionalPath = None
    """Folder of finished walks, which are reused; by default `walks` in the output."""
    page: OptionalPath = None
    """Page of results to write as well, such as docs/results/walking.md."""
    force: Force = False

    def run(self) -> None:
        from surefoot.scenarios.studies.walking.study import report, walking_study

        print(
            report(
                walking_study(
                    self.out,
                    self.robot,
                    self.course,
                    self.seeds,
                    self.workers,
                    self.data,
                    self.page,
                    self.force,
                )
            )
        )
        print(f"table: {self.out / 'walking.md'}")


@dataclass(frozen=True)
class Tune:
    """Search the parameters of any filter, with one budget; an interrupted run is resumed.

    Writes tuned.toml, which every command reads if $SUREFOOT_TUNED names it.
    """

    logs: Logs
    """Logs with a reference, not used to train observers or calibrate bounds."""
    out: Out
    """Folder for tuned.toml, tuned.md (errors before and after) and finished searches."""
    filter: UseAppendAction[tuple[str, ...]] = ()
    """A filter to tune; may be given several times. By default all that the inputs allow."""
    robot: RobotName = None
    observer: Observers = ()
    bounds: BoundsFiles = ()
    budget: int = 16
    """Runs of each filter over all logs of a robot."""
    longest: float = 120.0
    """Length of each log, from its start, on which filters are evaluated [s]."""
    workers: Workers = 1
    force: Force = False

    def run(self) -> None:
        from surefoot.scenarios.tune import tune

        if not self.logs:
            raise SurefootError("give at least one log")
        text = tune(
            self.logs,
            self.out,
            self.filter,
            self.robot,
            learnt_from(self.observer, self.bounds),
            self.budget,
            self.longest,
            self.workers,
            self.force,
        )
        print(text)
        print(f"parameters: {self.out / 'tuned.toml'}")


@dataclass(frozen=True)
class Bench:
    """Measure run times, each as a ratio to a reference timed in the same run."""

    rounds: int = 12
    """Repetitions of each pair, alternating; the shortest counts."""
    only: UseAppendAction[tuple[str, ...]] = ()
    """Items to run; by default all."""
    page: OptionalPath = None
    """Page of results to write as well, such as docs/results/bench.md."""

    def run(self) -> None:
        from surefoot.scenarios.studies.bench.run import bench

        print(bench(self.rounds, self.only, self.page))


@dataclass(frozen=True)
class PlanCommand:
    """Plan which motion reveals each effect, how long it takes, and which other effect masks it."""

    robot: str
    """Name or file of the robot, a quadruped that walks in simulation."""
    effects: Annotated[
        Positional[tuple[str, ...]],
        arg(
            metavar="EFFECT...",
            help=f"Any of {', '.join(EFFECT_NAMES)}, or your own.",
            help_behavior_hint=NEEDED,
        ),
    ]
    as_json: Json = False

    def run(self) -> None:
        from surefoot.scenarios.motion_plan import (
            motion_table,
            plan_motions,
            plan_text,
            recordings_to_make,
        )
        from surefoot.scenarios.reporting.progress import percent_bar
        from surefoot.sim.robot import Robot

        if not self.effects:
            raise SurefootError("name at least one effect")
        with percent_bar("plan") as bar:
            found = plan_motions(Robot.load(self.robot), self.effects, bar)
        if self.as_json:
            print_json({"effects": motion_table(found), "record": recordings_to_make(found)})
        else:
            print(plan_text(found))
