"""Commands that run a whole workflow: the demo, traces and experiments."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, UseAppendAction, arg

from surefoot.scenarios.cli.named import EFFECT_NAMES
from surefoot.scenarios.cli.options import (
    NEEDED,
    BoundsFiles,
    Declared,
    Flag,
    Force,
    Holdout,
    Json,
    Logs,
    Observers,
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
    """Run the whole workflow in minutes: walk, train, calibrate, compare filters, trace."""

    out: Out = Path("out/demo")
    """Folder for all outputs."""
    seed: int = 0
    """Seed of the walks and of the training."""
    force: Force = False

    def run(self) -> None:
        from surefoot.scenarios.demo import demo

        demo(self.out, self.seed, self.force)


@dataclass(frozen=True)
class TraceCommand:
    """Find the effects that a robot's model lacks; reports errors before and after adding them."""

    logs: Logs
    """Logs of one robot, traced together."""
    out: Out
    """Folder for trace.json, effects.toml, report.html and the recording trace.rrd."""
    robot: RobotName = None
    declared: Declared = None
    holdout: Holdout = ()
    seed: int = 0
    """Seed of the bootstrap from which the intervals are computed."""
    strict: Strict = False
    force: Force = False

    def run(self) -> None:
        from surefoot.scenarios.reporting.progress import percent_bar
        from surefoot.scenarios.trace.long_logs import note_on_blocks, read_in_blocks
        from surefoot.scenarios.trace.run import trace, unchanged_beside
        from surefoot.scenarios.trace.words import summary
        from surefoot.sim.effects.file import load_effects
        from surefoot.sim.robot.machine import machine_for_log

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
    """Seed of the walks, the training and the intervals."""
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
    """Compare a measured log, quantity by quantity, with simulated walks at its speeds, stride
    period and posture.
    """

    log: Annotated[Positional[Path], arg(metavar="LOG")]
    """A log with IMU, joint angles, contacts and reference."""
    out: Out
    """Folder for realism.json, realism.csv, drift.csv, table.md and report.html."""
    robot: RobotName = None
    effects: OptionalPath = None
    """File of effects (TOML) for the simulated robot."""
    as_walked: Flag = False
    """Also compare walks with the gait, sensors and effects measured on a real robot. Effects given
    with --effects replace the measured ones.
    """
    walker: OptionalNamed = None
    """Robot to simulate instead of the log's; measured values are scaled to it."""
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
    """Folder for tables, report.html and recordings."""
    workers: Workers = 1
    seeds: OptionalSeeds = None
    """One seed, or a range such as 0:8, which is 0 to 7; by default the file's (0 to 2 in a
    suite).
    """
    cache: OptionalPath = None
    """Folder of walks, observers, bounds and estimates, which later runs reuse; by default `cache`
    in the output.
    """
    recordings: Flag = True
    """Write no rerun recordings of the sequences; by default there is one of each."""
    page: OptionalPath = None
    """Page of results to write as well, such as docs/results/suite_spot.md."""
    data: OptionalPath = None
    """Folder of finished rows, one for each walk, which later runs reuse, such as
    docs/data/suite_spot; by default none are stored.
    """
    force: Flag = False
    """Write tables and report again; what is in the cache is reused."""

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
    """Run a grid of scenarios, robots, conditions, gammas, filters and seeds: one tidy table."""

    file: Annotated[Positional[str], arg(metavar="FILE")]
    """Experiment file (TOML), or the name of a bundled suite: spot, vision60."""

    def run(self) -> None:
        experiment_file(self.file)  # before anything heavy is imported
        self.experiment(self.file)


@dataclass(frozen=True, kw_only=True)
class Suite(GridOptions):
    """Reproduce the paper's two tables on the simulated suites, from simulation to table.

    Conditions: as drawn (each robot equals its model), as built (with errors drawn within
    tolerances, unknown to the filters), as walked (in addition with the gait, sensors and effects
    measured on a real robot).
    """

    name: Annotated[Positional[str], arg(metavar=f"{{{','.join(SUITES)}}}")]
    """Suite: spot has ten courses, vision60 seven."""

    def run(self) -> None:
        if self.name not in SUITES:
            known = f"known: {', '.join(SUITES)}{did_you_mean(self.name, SUITES)}"
            raise SurefootError(f"unknown suite '{self.name}'; {known}")
        self.experiment(self.name)


@dataclass(frozen=True)
class Tune:
    """Search the best parameters of filters, with the same budget for each; an interrupted run is
    resumed.

    Writes tuned.toml, which every command uses if the environment variable SUREFOOT_TUNED is set to
    its path.
    """

    logs: Logs
    """Logs with a reference, not used to train observers or calibrate bounds."""
    out: Out
    """Folder for tuned.toml, tuned.md (errors before and after) and finished searches."""
    filter: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="NAME")] = ()
    """Filter to tune; by default all that the inputs allow."""
    robot: RobotName = None
    observer: Observers = ()
    bounds: BoundsFiles = ()
    budget: int = 16
    """Number of runs of each filter over all logs of a robot."""
    longest: float = 120.0
    """Part of each log, from its start, on which filters are evaluated [s]."""
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
class PlanCommand:
    """Plan which motion reveals each effect, how long it takes, and which effect could mask it."""

    robot: Annotated[str, arg(metavar="NAME|FILE")]
    """Name of the robot, or its file (MJCF or URDF): a quadruped that walks in simulation."""
    effects: Annotated[
        Positional[tuple[str, ...]],
        arg(
            metavar="EFFECT...",
            help=f"Effects: {', '.join(EFFECT_NAMES)}, or your own.",
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
