"""Commands that run a whole workflow: the demo, traces and experiments."""

from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

import surefoot
from surefoot.scenarios import reporting, settings
from surefoot.scenarios.cli import options
from surefoot.scenarios.experiments.catalog import SUITES, experiment_file
from surefoot.sim.common.errors import check_known
from surefoot.sim.effects.catalogue import CATALOGUE


@options.command
class Demo(settings.OutputSettings):
    """Run the whole workflow in minutes: walk, train, calibrate, compare filters, trace."""

    out: Path = Path("out/demo")
    """Folder for all outputs."""
    seed: int = 0
    """Seed of the walks and of the training."""

    def run(self) -> None:
        from surefoot.scenarios.demo import demo

        demo(self.out, self.seed, self.force)


@options.command
class TraceCommand(settings.TraceSettings):
    """Find the effects that a robot's model lacks; reports errors before and after adding them."""

    def run(self) -> None:
        from surefoot.scenarios.trace.run import trace_files

        found = trace_files(self)
        print(surefoot.trace_summary(found))
        print(f"\nreport: {self.out / 'report.html'}")


@options.command
class LoopCommand(settings.LoopSettings, settings.TraceInputs):
    """Trace a log, add the effects found to the simulation, retrain, and estimate the log again."""

    log: Path
    """A log with IMU, joint angles and reference."""

    def run(self) -> None:
        from surefoot.scenarios.estimate.inputs import read_logs
        from surefoot.scenarios.trace.loop import loop
        from surefoot.sim.effects.file import load_effects

        log = surefoot.Log.read(self.log)
        robot = surefoot.Robot.for_log(log, self.robot)
        declared = None if self.declared is None else load_effects(self.declared)
        print("\n" + loop(log, robot, self, declared, read_logs(self.holdout)))
        print(f"report: {self.out / 'report.html'}")


@options.command
class Realism(settings.RealismSettings, settings.RobotSettings):
    """Compare a measured log, quantity by quantity, with simulated walks at its speeds, stride
    period and posture.
    """

    log: Path
    """A log with IMU, joint angles, contacts and reference."""
    effects: Path | None = None
    """File of effects (TOML) for the simulated robot."""
    walker: str | None = None
    """Robot to simulate instead of the log's; measured values are scaled to it."""

    def run(self) -> None:
        from surefoot.scenarios.trace.realism import realism
        from surefoot.sim.effects.file import load_effects

        log = surefoot.Log.read(self.log)
        robot = surefoot.Robot.for_log(log, self.robot)
        effects = load_effects(self.effects) if self.effects else ()
        walker = surefoot.Robot.load(self.walker) if self.walker else None
        with reporting.percent_bar("walking") as bar:
            text = realism(log, robot, self, effects, walker, bar)
        print(f"\n{text}")
        print(f"report: {self.out / 'report.html'}")


@options.command
class ExperimentCommand(settings.GridSettings):
    """Run a grid of scenarios, robots, conditions, gammas, filters and seeds: one tidy table."""

    file: str
    """Experiment file (TOML), or the name of a bundled suite: spot, vision60."""

    def run(self) -> None:
        experiment_file(self.file)  # before anything heavy is imported
        from surefoot.scenarios.experiments.report import experiment

        experiment(self.file, self)


@options.command
class Suite(settings.GridSettings):
    """Reproduce the paper's two tables on the simulated suites, from simulation to table.

    Conditions: as drawn (each robot equals its model), as built (with errors drawn within
    tolerances, unknown to the filters), as walked (in addition with the gait, sensors and effects
    measured on a real robot), shifted (as built, unlike what observers and bounds learn from).
    """

    name: Annotated[Positional[str], arg(metavar=f"{{{','.join(SUITES)}}}")]
    """Suite: spot has ten courses, vision60 seven."""

    def run(self) -> None:
        check_known("suite", self.name, SUITES)
        from surefoot.scenarios.experiments.report import experiment

        experiment(self.name, self)


@options.command
class Tune(settings.TuneSettings, settings.LearntSettings):
    """Search the best parameters of filters, with the same budget for each; an interrupted run is
    resumed.

    Writes tuned.toml, which every command uses if the environment variable SUREFOOT_TUNED is set to
    its path.
    """

    logs: tuple[Path, ...]
    """Logs with a reference, not used to train observers or calibrate bounds."""

    def run(self) -> None:
        from surefoot.scenarios.estimate.inputs import learnt_from
        from surefoot.scenarios.tune import tune

        print(tune(self.logs, self, learnt_from(self.observer, self.bounds)))
        print(f"parameters: {self.out / 'tuned.toml'}")


@options.command
class PlanCommand(options.JsonOption):
    """Plan which motion reveals each effect, how long it takes, and which effect could mask it."""

    robot: str
    """Name of the robot, or its file (MJCF or URDF): a quadruped that walks in simulation."""
    effects: Annotated[
        Positional[tuple[str, ...]],
        arg(
            metavar="EFFECT...",
            help=f"Effects: {', '.join(CATALOGUE.bundled)}, or your own.",
            help_behavior_hint=options.NEEDED,
        ),
    ]

    def run(self) -> None:
        from surefoot.scenarios import motion_plan

        with reporting.percent_bar("plan") as bar:
            found = motion_plan.plan_motions(surefoot.Robot.load(self.robot), self.effects, bar)
        if self.json:
            options.print_json(
                {
                    "effects": motion_plan.motion_table(found),
                    "record": motion_plan.recordings_to_make(found),
                }
            )
        else:
            print(motion_plan.plan_text(found))
