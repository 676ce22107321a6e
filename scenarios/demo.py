"""The whole workflow end to end: walk, learn, calibrate, estimate, compare and trace."""

from dataclasses import replace
from pathlib import Path
from time import perf_counter

import numpy as np
import pandas as pd

from surefoot.models.observer.predict import prediction_errors
from surefoot.models.observer.settings import TrainSettings
from surefoot.scenarios.compare import compare_log, write_comparison
from surefoot.scenarios.datasets.conditions import load_conditions
from surefoot.scenarios.datasets.kept_walks import DrawnWalk
from surefoot.scenarios.estimate.inputs import with_effects
from surefoot.scenarios.estimate.learning import learn
from surefoot.scenarios.estimate.run import Learnt
from surefoot.scenarios.first_use import COMPILATIONS
from surefoot.scenarios.reporting.html import Picture, Section
from surefoot.scenarios.reporting.observer_errors import error_section, mixing_curve
from surefoot.scenarios.reporting.tables import in_terminal
from surefoot.scenarios.settings import WalksSettings
from surefoot.scenarios.stages import percent_bar, processes, submitted
from surefoot.scenarios.trace.report import headline, sections, summary
from surefoot.scenarios.trace.result import Trace
from surefoot.scenarios.trace.run import TraceOptions, trace
from surefoot.scenarios.training.many_walks import SUITE, many_walks
from surefoot.sim.common.errors import check_seed
from surefoot.sim.common.files import check_space, refuse_full, whole_folder
from surefoot.sim.effects import Effect, effect
from surefoot.sim.effects.file import save_effects
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario
from surefoot.sim.walk import walk

DEMO_SPACE = 1e8
"""Bytes that the folder of a demo takes, and a fifth more."""
ROBOT = "spot_class"
LEARNING = WalksSettings(walks=8, robot=ROBOT)
TRAINING = TrainSettings(inputs="tau,gyro,accel,contact,feet", steps=1200)

UNDECLARED: tuple[tuple[str, tuple[str, ...], tuple[float, float]], ...] = (
    ("encoder_offset", ("FL_thigh", "FR_calf", "RL_calf", "RR_thigh"), (0.015, 0.05)),
    ("link_length", ("FL_calf", "FR_thigh", "RL_thigh", "RR_calf"), (0.01, 0.03)),
    ("foot_rolling", ("all",), (0.004, 0.01)),
    ("imu_rotation", ("x", "y", "z"), (0.02, 0.06)),
    ("gyro_scale", ("x", "y", "z"), (0.01, 0.03)),
    ("joint_delay", ("all",), (0.003, 0.01)),
)
"""Possible undeclared effects of the traced walk: effect, targets, and range of the size."""


def demo(out: Path, seed: int = 0, force: bool = False) -> pd.DataFrame:
    """Run everything into `out` and print the table; deterministic for a given seed.

    Raises SurefootError where `out` contains files and `force` is not given.
    """
    started = perf_counter()
    check_seed(seed)
    refuse_full(out, force)
    check_space(out, DEMO_SPACE)
    with whole_folder(out, force) as folder:
        results, found, hidden = _run(folder, seed)
    print("\n" + in_terminal(results))
    print(f"\n{summary(found)}\nThe effect was: {_in_words(hidden)}.")
    print(
        f"\n{perf_counter() - started:.0f} s in all. Report: {out / 'report.html'}\n"
        f"See the walk: surefoot view {out / 'walk.rrd'}"
    )
    return results


def _run(out: Path, seed: int) -> tuple[pd.DataFrame, Trace, Effect]:
    """The table, the trace, and the effect it should have found; all files are in `out`."""
    robot = Robot.load(ROBOT)
    drawn = _as_walked(robot, seed)
    with processes(2) as pool:
        assert pool is not None
        # On a fresh machine this process has the kernels of the walks to compile meanwhile.
        for compiled in COMPILATIONS:
            submitted(pool, (compiled,))
        with percent_bar("walking: walk") as progress:
            log = replace(drawn.simulated(progress), name="walk")
        log.write(out / "logs" / "walk.parquet")
        save_effects(out / "as_walked.toml", drawn.effects)
        hidden = _undeclared(robot, seed, out)
        tracing = submitted(pool, (_trace, robot, seed, out))
        roles = "train", "held_out", "calibrate"
        walks = {role: many_walks(replace(LEARNING, walk_seed=seed), role=role) for role in roles}
        print(
            f"training two observers on {len(walks['train'])} walks: mse, and Gaussian likelihood"
        )
        training = replace(TRAINING, seed=seed)
        held_out = tuple(walks["held_out"])
        learnt = learn(walks["train"], walks["calibrate"], out, training, held_out=held_out)
        print("\nevery filter, on a walk that nothing was trained on")
        log = Log.read(out / "logs" / "walk.parquet")
        comparison = compare_log(log, robot, learnt)
        known = with_effects(replace(log, name="known"), robot, out / "as_walked.toml")
        by_legs = compare_log(known, robot, Learnt(), ("leg", "leg_slip"))
        print("\nwaiting for the trace of a walk with an effect that its log does not declare")
        found = tracing.result()
    extra = [*_observer_sections(log, learnt), _loop_section(found, hidden)]
    title = "surefoot demo: a walk on slippery ground, estimated by proprioception"
    results = write_comparison([comparison, by_legs], out, title, extra)
    return results, found, hidden


def _as_walked(robot: Robot, seed: int) -> DrawnWalk:
    """The walk that is estimated: of robot number `seed`, which deviates from its model."""
    condition = next(one for one in load_conditions(SUITE) if one.walked)
    return condition.walk(Scenario.load("demo/walk"), robot, seed)


def _undeclared(robot: Robot, seed: int, out: Path) -> Effect:
    """Simulate another walk with an effect that its log does not declare; returns the effect."""
    rng = np.random.default_rng([seed, 4])
    name, targets, (low, high) = UNDECLARED[rng.integers(len(UNDECLARED))]
    size = float(rng.choice([-1.0, 1.0]) * np.exp(rng.uniform(np.log(low), np.log(high))))
    hidden = effect(name, str(rng.choice(targets)), abs(size) if name == "joint_delay" else size)
    with percent_bar("walking: undeclared") as progress:
        scenario, walk_seed = Scenario.load("demo/walk"), 4 * seed + 3
        log = walk(scenario, robot, walk_seed, [hidden], declared=False, progress=progress)
    replace(log, name="undeclared").write(out / "logs" / "undeclared.parquet")
    save_effects(out / "truth.toml", [hidden])
    return hidden


def _trace(robot: Robot, seed: int, out: Path) -> Trace:
    """Trace that walk from its log alone."""
    log = Log.read(out / "logs" / "undeclared.parquet")
    return trace([log], robot, out / "trace", TraceOptions(seed))


def _in_words(hidden: Effect) -> str:
    return f"{hidden.name} of {hidden.target}, {hidden.value:.4g} {hidden.unit}"


def _loop_section(found: Trace, hidden: Effect) -> Section:
    """What the trace found, and the picture of what remains."""
    words = (
        "A further walk was recorded with an effect that its log does not declare: "
        f"{_in_words(hidden)}. What was found from the log alone: {headline(found)}. The full "
        "report is trace/report.html."
    )
    return Section("Closing the loop", words, pictures=sections(found)[0].pictures)


def _observer_sections(log: Log, learnt: Learnt) -> list[Section]:
    observer, bounds = learnt.bounded("mse")
    pictures = ()
    if bounds.mixing is not None:
        caption = "Correlation of errors over time: calibration samples are taken K steps apart."
        file = "figures/observer_mixing.png"
        pictures = (Picture(mixing_curve(bounds.mixing), caption, file),)
    learning = Section(
        "The observers and their bounds",
        f"Trained on {LEARNING.walks} drawn walks, stopped by others, and calibrated on "
        f"{LEARNING.walks} more at joint level {bounds.gamma:g}, with errors K steps of 10 ms "
        "apart. Bounds of the mse observer have one size; those of the gml observer are multiples "
        "of the standard deviations that it predicts.",
        pictures=pictures,
    )
    tested = observer.errors, prediction_errors(observer, log)[1]
    return [learning, error_section(*tested, bounds.epsilon, bounds.gamma, "the walk")]
