"""Simulated walks in the style of a measured one, to train and calibrate observers.

Sizes found on a measured log have confidence intervals. Each walk is simulated with sizes drawn
from them, and compensated by the sizes found, like the measured log. Observers and bounds thus
include the influence of errors of the sizes.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from surefoot.models.observer.samples import DQ_CAUSAL
from surefoot.models.observer.settings import TRAIN_DEFAULT, TrainSettings
from surefoot.scenarios.datasets.kept_walks import DrawnWalk, kept_walks
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.quaternion import quaternion_from_matrix
from surefoot.sim.effects import Effect, compensate_all, effect
from surefoot.sim.gait.options import PLAIN_GAIT, GaitOptions
from surefoot.sim.log import Log, joint_velocity
from surefoot.sim.robot import Robot
from surefoot.sim.walking.imitation import WalkingStyle, imitation, slower, towards_plain

PACES = (1.0, 0.8, 0.6, 0.4)
"""Factors on the measured velocities, tried in turn until the simulated robot does not fall."""
WALKS_DRAWN = 3
"""Courses, sizes and noise that are drawn at each pace before the next one is tried, since a robot
that walks at a pace for minutes may fall by chance.
"""


NEAREST = 0.125
"""Largest difference of the share of a style from one with which a robot falls."""


class FallsError(SurefootError):
    """A robot that falls at every pace."""


@dataclass(frozen=True)
class TrainingPlan:
    """Amount of simulated training data."""

    walks: int = 8
    seconds: float = 30.0  # of each walk to train on
    calibration: float = 150.0  # s of the one to calibrate on
    training: TrainSettings = TRAIN_DEFAULT


DEFAULT_PLAN = TrainingPlan()


def simulated_robot(robot: Robot) -> Robot:
    """The robot for simulation: body and feet of its file, IMU mounted as declared."""
    return replace(Robot.load(robot.file), name=robot.name, p_BI=robot.p_BI, R_BI=robot.R_BI)


def beyond_simulated(
    effects: Sequence[Effect], robot: Robot, simulated: Robot
) -> tuple[Effect, ...]:
    """Effects found with the declared `robot`, less what `simulated` already has.

    Only `foot_rolling` differs: a declared model may have point feet, so that the size found is the
    whole radius, while the simulated feet have that of their file.
    """
    difference = float(np.mean(robot.foot_radius - simulated.foot_radius))
    if abs(difference) < 1e-9:
        return tuple(effects)
    return tuple(
        effect(e.name, e.target, e.value + difference) if e.name == "foot_rolling" else e
        for e in effects
    )


@dataclass(frozen=True)
class TrainingWalks:
    """Walks to simulate in the style of a measured one.

    Attributes:
        style: of the measured walk.
        robot: as declared.
        effects: of the simulated robot.
        gait: of the walks.
        spread: standard deviation of an effect's size, in its unit, by name and target; others are
            as they are.
    """

    style: WalkingStyle
    robot: Robot
    effects: Sequence[Effect] = ()
    gait: GaitOptions = PLAIN_GAIT
    spread: Mapping[tuple[str, str], float] = field(default_factory=dict)


def simulate_training(
    walks: TrainingWalks,
    seed: int,
    plan: TrainingPlan = DEFAULT_PLAN,
    progress: Callable[[float], None] | None = None,
) -> tuple[list[Log], Log]:
    """Logs to train on, and one to calibrate on, of a robot with the effects.

    The effects are compensated in the logs, as they are for the filters afterwards. Raises
    FallsError if the robot falls at all of PACES.

    Args:
        walks: robot, effects and gait.
        seed: of the walks.
        plan: number and length of the walks.
        progress: called with the share done, 0 to 1.
    """
    simulated = simulated_robot(walks.robot)
    added = beyond_simulated(walks.effects, walks.robot, simulated)

    def drawn(k: int, attempt: int) -> DrawnWalk:
        pace, draw = PACES[attempt // WALKS_DRAWN], attempt % WALKS_DRAWN
        rng = np.random.default_rng([seed, k, draw])
        seconds = plan.seconds if k < plan.walks else plan.calibration
        scenario, poised = imitation(walks.style, simulated, f"imitation_{k}", seconds, rng)
        own = drawn_sizes(added, walks.spread, rng)
        scenario = replace(slower(scenario, pace), gait=walks.gait)
        return DrawnWalk(scenario, poised, seed + k + draw * (plan.walks + 1), own)

    attempts, name = len(PACES) * WALKS_DRAWN, "imitation"
    made = kept_walks(drawn, plan.walks + 1, attempts, name, progress)
    if len(made) <= plan.walks:
        raise FallsError(
            f"loop: in simulation {simulated.name} falls with the stride and posture of the log, "
            f"even at {100 * PACES[-1]:.0f} % of its speed"
        )
    logs = [_compensated(log, added, simulated) for log in made]
    return logs[:-1], logs[-1]


@dataclass(frozen=True)
class WalkedStyle:
    """The share of a measured style with which a robot walks (`towards_plain`), and the names of
    walks in which it falls with any.
    """

    share: float = 1.0
    fallen: tuple[str, ...] = ()

    @property
    def words(self) -> str:
        """What differs from the measured style; "" if nothing does."""
        said = ""
        if self.share < 1.0:
            said = (
                "With the stride and posture of the log the simulated robot falls. The nearest "
                f"with which it walks are taken: {100 * self.share:.0f} % of the log's, "
                f"{100 - 100 * self.share:.0f} % of its own."
            )
        untrained = f"No observers for {', '.join(self.fallen)}: the robot falls with any style."
        return f"{said} {untrained}".strip() if self.fallen else said


def style_that_walks(
    walks: Mapping[str, TrainingWalks],
    seed: int,
    plan: TrainingPlan = DEFAULT_PLAN,
    progress: Callable[[float], None] | None = None,
) -> WalkedStyle:
    """The style nearest to the measured one, to NEAREST, with which the robot falls in none of
    these walks, by bisection; walks are those of `simulate_training`, and kept.

    In its own style if it falls in all of them.

    Args:
        walks: by name.
        seed: of the walks.
        plan: number and length of the walks.
        progress: called with the share done of one of the walks, 0 to 1.
    """

    def falls(share: float, names: Iterable[str]) -> list[str]:
        fallen = []
        for name in names:
            try:
                simulate_training(with_style_share(walks[name], share), seed, plan, progress)
            except FallsError:
                fallen.append(name)
        return fallen

    if not falls(1.0, walks):
        return WalkedStyle()
    fallen = falls(0.0, walks)
    names = [name for name in walks if name not in fallen]
    low, high = 0.0, 1.0
    if not falls(high, names):
        low = high
    while high - low > NEAREST:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if falls(middle, names) else (middle, high)
    return WalkedStyle(low, tuple(fallen))


def with_style_share(walks: TrainingWalks, share: float) -> TrainingWalks:
    """The walks with a share of the measured style."""
    if share == 1.0:
        return walks
    simulated = simulated_robot(walks.robot)
    return replace(walks, style=towards_plain(walks.style, simulated, share))


def drawn_sizes(
    effects: Sequence[Effect], spread: Mapping[tuple[str, str], float], rng: np.random.Generator
) -> tuple[Effect, ...]:
    """The effects with sizes from normal distributions about theirs, within their bounds.

    Args:
        effects: found.
        spread: standard deviations, as in `TrainingWalks`.
        rng: random generator, advanced by one draw for each of `spread`.
    """
    drawn = []
    for one in effects:
        if (one.name, one.target) in spread:
            size = rng.normal(one.value, spread[one.name, one.target])
            one = replace(one, value=float(np.clip(size, *one.bounds)))
        drawn.append(one)
    return tuple(drawn)


def rates_as_of(log: Log, measured: Log) -> Log:
    """Give a simulated log joint rates of the same origin as the measured log's.

    If that logs none, filters derive them from past angles, and so does this function.
    """
    if measured.has("dq"):
        return log
    kept = log.frame[[c for c in log.frame if not str(c).startswith("dq_")]]
    rates = joint_velocity(replace(log, frame=kept), causal=True)
    columns = {f"dq_{joint}": rates[:, i] for i, joint in enumerate(log.joints)}
    meta = replace(log.meta, derived=(*log.meta.derived, DQ_CAUSAL))
    return replace(log, frame=kept.assign(**columns), meta=meta)


def _compensated(walked: Log, effects: Sequence[Effect], simulated: Robot) -> Log:
    """Compensate effects in a simulated log.

    Its metadata names the resulting mounting of the IMU and radius of the feet, since an observer
    stores the mounting that it was trained with.
    """
    log, model = compensate_all(effects, walked, simulated)
    corrected = {
        "p_BI": model.p_BI.tolist(),
        "q_BI": quaternion_from_matrix(model.R_BI).tolist(),
        "foot_radius": model.foot_radius.tolist(),
    }
    declared = tuple(one.as_dict() for one in effects)
    return replace(log, meta=replace(log.meta, effects=declared, model=log.meta.model | corrected))
