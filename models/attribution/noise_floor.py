"""Noise floor of a trace: the residual of the declared model itself.

The motion of the log is simulated again with the declared robot; the residual of these walks is
what remains when the model lacks nothing.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from surefoot.models.attribution.design import design
from surefoot.models.attribution.evidence import (
    Evidence,
    LogUnderModel,
    all_keys,
    linearise,
    log_under_model,
    table_of,
)
from surefoot.models.attribution.model_error import (
    EXACT,
    ModelError,
    RunEvidence,
    RunSums,
    model_error,
    run_sums,
)
from surefoot.models.attribution.reference_sampling import (
    ReferenceSampling,
    reference_sampling,
    resample_reference,
)
from surefoot.models.attribution.robust_weights import RobustWeights, robust_weights
from surefoot.models.attribution.sensor_noise import apparent_sizes, data_sheet_noise, reading_noise
from surefoot.models.attribution.settings import DEFAULT, TraceSettings
from surefoot.models.residuals.channels import channels
from surefoot.models.residuals.layout import Layout, layout_for
from surefoot.models.residuals.motion import can_dead_reckon, with_dead_reckoning
from surefoot.models.residuals.torques import declared
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.effects import Effect, known_effects
from surefoot.sim.ground.terrain import Ground, Strip
from surefoot.sim.log import Log
from surefoot.sim.robot.limbs import QUADRUPED
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.walk import walk
from surefoot.sim.walking.imitation import PIECE, body_twists

Twists = tuple[tuple[float, float, float], ...]
Groups = tuple[str, ...]


@dataclass(frozen=True)
class FloorWalk:
    """One simulated walk of the declared model.

    Attributes:
        evidence: of the walk.
        robust_weights: of its bins.
        sums: of its residual and all candidates.
    """

    evidence: Evidence
    robust_weights: RobustWeights
    sums: RunSums


@dataclass(frozen=True)
class FloorPlan:
    """Walks to simulate for a noise floor.

    Attributes:
        file: the robot's model.
        courses: commanded velocities, one course for each walk.
        groups: groups of columns that the logs have.
        evenness: standard deviation of the ground's height from a plane [m].
        sampling: sampling and noise of the reference, if measured.
        settings: of the trace.
        ground: effects of the ground, which no model can compensate.
        effects: that the robot has, compensated by its model.
    """

    file: Path
    courses: tuple[Twists, ...]
    groups: Groups
    evenness: float
    sampling: ReferenceSampling | None
    settings: TraceSettings
    ground: tuple[Effect, ...] = ()
    effects: tuple[Effect, ...] = ()


POINT_FEET_SIZES = {
    ("joint_delay", "all"): 0.6e-3,
    ("clock_scale", "joints"): 6e-5,
    ("clock_scale", "feet"): 5e-5,
    ("contact_delay", "touchdown"): 3e-3,
    ("contact_delay", "liftoff"): 6e-3,
}
POINT_FEET_LEVELS = {"leg_velocity": 4.4e-3, "stance_velocity": 2.8e-3, "contact_timing": 11e-3}
"""What rolling and creeping feet leave where a log gives them and they are taken for points.

From 21 simulated walks of seven robots without an effect (spot_class, v60_class, go1, go2, aliengo,
mini_cheetah, b2), each at 0.6, 1 and 1.3 times 0.5 m/s times its leg length over that of
spot_class. Root mean squares of the sizes that effects seem to have; the largest residuals, which
hardly depend on robot or speed, and a tenth more.
"""


@dataclass(frozen=True)
class NoiseFloor:
    """Residual of a robot that matches its model.

    Attributes:
        sigma: noise of each column of the residual table (W,), in its unit.
        walks: the simulated walks.
        source: of the floor, in words.
        error: of the model; that of a machine on a fixed base for means over windows.
        plan: what was simulated.
        readings: the logs, where the noise of their own readings is the floor.
        levels: channel -> upper limit of its residual where no walk of the machine shows it.
    """

    sigma: np.ndarray
    walks: tuple[FloorWalk, ...]
    source: str
    error: ModelError
    plan: FloorPlan | None = None
    readings: tuple[LogUnderModel, ...] = ()
    levels: Mapping[str, float] = field(default_factory=dict)

    @property
    def evenness(self) -> float:
        """Standard deviation of the ground from a plane [m]: of the walks', or by the maps."""
        return self.plan.evenness if self.plan else _evenness(self.readings)


def noise_floor(cases: Sequence[LogUnderModel], ground: Sequence[Effect] = ()) -> NoiseFloor:
    """Simulate the motion of the logs with the declared robot.

    Each of a few short walks follows a section of the reference's body velocities. Seeds are fixed,
    so the floor is a function of the logs. A section on which the robot falls is repeated at lower
    speed. For a robot that cannot walk at all the floor is the sensors' noise by their data sheets,
    for a machine on a fixed base the noise of its readings, and for one that is known by its feet
    alone that noise and `POINT_FEET`.

    Args:
        cases: the logs under the declared model.
        ground: effects of the ground that every walk has and no model compensates.
    """
    first = cases[0]
    if first.fixed:
        return _floor_of_readings(cases, (), "the differences between successive readings")
    if first.by_feet:
        return _floor_of_readings(
            cases,
            (),
            "the noise of the readings, and what point feet leave on simulated walks of other "
            "robots, since there is no model of this one",
        )
    known = ("imu", "q", "dq", "tau", "contact", "reference", "ref_v")
    walks = first.robot.limbs == QUADRUPED
    evenness = _evenness(cases)
    plan = FloorPlan(
        file=first.robot.file,
        courses=tuple(courses([_with_reference(c) for c in cases], first.settings))
        if walks
        else (),
        groups=tuple(g for g in known if all(case.log.has(g) for case in cases)),
        evenness=evenness,
        sampling=reference_sampling(first.log, first.settings),
        settings=first.settings,
        ground=tuple(ground),
    )
    if (floor := _floor(plan)) is not None:
        return floor
    layout = layout_for(first.robot.limbs)
    sigma = data_sheet_noise(first.log.rate, layout, evenness)
    return NoiseFloor(sigma, (), "data sheets of the declared sensors", _no_error(sigma, layout))


def noise_floor_with(
    floor: NoiseFloor, effects: Sequence[Effect], near: NoiseFloor | None = None
) -> NoiseFloor:
    """The noise floor of a robot with these effects, compensated by its model.

    An effect on the body changes how the feet land, and compensating some effects loses
    information; either changes the residual. The floor is unchanged for all other effects, and
    where the robot falls. On a fixed base the floor is the noise of the readings as the
    compensation propagates it.

    Args:
        floor: of the declared model.
        effects: that the robot has.
        near: a floor of the same effects, which is kept where their sizes are about the same.
    """
    if floor.readings:
        return _floor_of_readings(floor.readings, effects, floor.source)
    limbs = floor.walks[0].evidence.layout.limbs if floor.walks else None
    bounds = [type(e).interior_bounds(e.target, limbs) for e in effects]
    telling = tuple(
        replace(e, value=float(np.clip(float(f"{e.value:.1e}"), *within)))
        for e, within in zip(effects, bounds, strict=True)
        if is_compensated_approximately(e)
    )
    if not telling or floor.plan is None or not floor.walks:
        return floor
    if near is not None and near.plan is not None and _about_same(near.plan.effects, telling):
        return near
    return _floor(replace(floor.plan, effects=telling)) or floor


def _about_same(known: Sequence[Effect], effects: Sequence[Effect]) -> bool:
    """Whether these effects are the known ones, each within a fifth of its size."""
    sizes = {(one.name, one.target): one.value for one in known}
    return len(known) == len(effects) and all(
        abs(one.value - sizes.get((one.name, one.target), np.inf)) < 0.2 * abs(one.value)
        for one in effects
    )


def is_compensated_approximately(one: Effect) -> bool:
    """Whether an effect changes the robot's motion, or compensating it loses information.

    In either case the residual differs from that of a robot without the effect even if it is
    compensated exactly.
    """
    kind = type(one)
    on_body = kind.edit_spec is not Effect.edit_spec
    return on_body or kind.alter_ground is not Effect.alter_ground or kind.is_lossy(one.target)


@lru_cache(maxsize=16)
def _floor(plan: FloorPlan) -> NoiseFloor | None:
    """The floor by simulated walks; None where the robot completes none."""
    known = tuple(known_effects())
    seed, friction = plan.settings.floor_seed, plan.settings.floor_friction
    # Without the other courses, so that a walk is cached once for all logs that contain it.
    alone = replace(plan, courses=())
    walks = [
        _floor_walk(alone, one, seed + i, friction[i % len(friction)], known)
        for i, one in enumerate(plan.courses)
    ]
    completed = tuple(one for one in walks if one is not None)
    if not completed:
        return None
    layout = completed[0].evidence.layout
    sigma = np.sqrt(np.mean([one.robust_weights.sigma**2 for one in completed], axis=0))
    sigma = np.maximum(sigma, _least_noise(layout))
    source = f"{len(completed)} simulated walks of the declared model along the log's own course"
    if plan.sampling:
        source += ", with a reference as coarse as the log's"
    error = model_error([one.sums for one in completed], layout.limbs) or _no_error(sigma, layout)
    return NoiseFloor(sigma, completed, source, error, plan)


def _no_error(sigma: np.ndarray, layout: Layout) -> ModelError:
    """A model without errors beyond noise sigma (W,) of the columns."""
    noise = {}
    for name, columns in layout.channels.items():
        for c in range(columns.start, columns.stop):
            noise[name, layout.columns[c].kind] = float(sigma[c])
    return ModelError(0, (), np.zeros(0), np.zeros((0, 0)), noise, {})


def _floor_of_readings(
    cases: Sequence[LogUnderModel], effects: Sequence[Effect], source: str
) -> NoiseFloor:
    """The floor by the noise of the readings, with the effects compensated."""
    layout = layout_for(cases[0].robot.limbs)
    sigma = _of_readings(cases, effects)
    if cases[0].by_feet:
        sizes = np.array([*POINT_FEET_SIZES.values()])
        error = _no_error(sigma, layout)
        error = replace(
            error, keys=tuple(POINT_FEET_SIZES), mean=0.0 * sizes, covariance=np.diag(sizes**2)
        )
        return NoiseFloor(sigma, (), source, error, readings=tuple(cases), levels=POINT_FEET_LEVELS)
    error = _no_error(sigma, layout)
    known = apparent_sizes(cases, sigma)
    seen = {key: size for key, size in known.items() if size}
    sizes = np.array([*seen.values()])
    doubt = cases[0].settings.apparent_size_uncertainty
    error = replace(error, keys=tuple(seen), mean=sizes, covariance=np.diag((doubt * sizes) ** 2))
    return NoiseFloor(sigma, (), source, error, readings=tuple(cases))


def _of_readings(cases: Sequence[LogUnderModel], effects: Sequence[Effect]) -> np.ndarray:
    """Noise (W,) of a bin from that of the readings, with the effects compensated, and from uneven
    ground.
    """
    layout = layout_for(cases[0].robot.limbs)
    sigma = np.maximum(reading_noise(cases, effects), _least_noise(layout))
    heights = layout.of("foot_height")
    sigma[heights] = np.hypot(sigma[heights], _evenness(cases))
    return sigma


def _evenness(cases: Sequence[LogUnderModel]) -> float:
    """Largest standard deviation of the ground from a plane [m] that the logs' maps state."""
    return max((float(c.log.meta.model.get("ground_evenness", 0.0)) for c in cases), default=0.0)


def _least_noise(layout: Layout) -> np.ndarray:
    """Smallest noise (W,) that columns may have."""
    least = np.zeros(layout.width)
    for name, columns in layout.channels.items():
        least[columns] = channels()[name].least_noise
    return least


def _with_reference(case: LogUnderModel) -> Log:
    """The log, with a reference reckoned from IMU and legs where it has none.

    That is accurate enough for the course of a simulated walk.
    """
    log, feet = case.log, case.robot.feet
    if log.has("reference") or feet is None or feet.roll_unknown or not can_dead_reckon(log):
        return log
    return with_dead_reckoning(log, feet)


def courses(logs: Sequence[Log], settings: TraceSettings = DEFAULT) -> list[Twists]:
    """Commanded forward and lateral velocity [m/s] and yaw rate [rad/s] in steps of 1 s, for each
    walk; empty where the robot stands on all feet throughout.
    """
    if all(log.has("contact") and np.mean(log.contact) > settings.standing_share for log in logs):
        return [()] * settings.floor_walks
    # Rounded to two decimals, so that nearly equal courses share one simulated walk.
    motion = [
        (round(float(forward), 2), round(float(lateral), 2), round(float(turn), 2))
        for log in logs
        if log.has("reference")
        for forward, lateral, turn in body_twists(log)
    ]
    length = max(1, min(round(settings.floor_seconds / PIECE), len(motion)))
    starts = np.linspace(0, len(motion) - length, settings.floor_walks).round().astype(int)
    return [tuple(motion[start : start + length]) for start in starts] if motion else []


@lru_cache(maxsize=16)
def _floor_walk(
    plan: FloorPlan, course: Twists, seed: int, friction: float, known: tuple[str, ...]
) -> FloorWalk | None:
    """One walk, fitted with the `known` effects; None where the robot falls at every speed.

    Args:
        plan: robot file, groups of columns, effects and settings.
        course: (forward, lateral, yaw rate) of each segment [m/s, m/s, rad/s]; empty for standing.
        seed: of the walk.
        friction: coefficient of friction of the ground.
        known: names of the effects that the fit may use.
    """
    robot, s = declared(plan.file), plan.settings
    for slower in (1.0, 0.6, 0.3) if course else (1.0,):
        segments = tuple(
            Segment(PIECE, forward * slower, lateral * slower, turn * slower)
            for forward, lateral, turn in course or ((0.0, 0.0, 0.0),)
        )
        stand = s.floor_stand if course else s.floor_seconds
        scenario = Scenario(
            "floor", segments, ground_of(segments, plan.evenness, friction), stand=stand
        )
        try:
            log = walk(scenario, robot, seed, (*plan.ground, *plan.effects), declared=False)
        except SurefootError:  # fallen, or a size that leaves it no foot
            continue
        if not course:
            log = replace(log, frame=log.frame[log.t - log.t[0] < s.floor_seconds - s.floor_stand])
        log = _with_groups(log, plan.groups)
        if plan.sampling:
            log = resample_reference(log, plan.sampling, np.random.default_rng(seed))
        case = log_under_model(log, robot, s)
        known_of_it = linearise([case], plan.effects, all_keys(case), evaluation_channels=False)
        known_of_it = replace(known_of_it, table=table_of(case, plan.effects))
        # The same minimum noise as for the log, so that channels have the same relative weight.
        weights = robust_weights(design(known_of_it), _least_noise(known_of_it.layout))
        sums = run_sums(RunEvidence(case, known_of_it, weights.weight, {}), frozenset(), EXACT)
        # The candidates' regressors are no longer needed.
        return FloorWalk(known_of_it.only(()), weights, sums)
    return None


def ground_of(segments: Sequence[Segment], evenness: float, friction: float) -> Ground:
    """Ground whose height deviates from a plane by `evenness` [m, standard deviation].

    The bumps of a rough strip have a standard deviation of a quarter of their height.
    """
    if not evenness:
        return Ground(friction)
    far = float(np.ceil(2 + sum(s.duration * np.hypot(s.forward, s.lateral) for s in segments)))
    bumps = Strip((-far, 0.0), (far, 0.0), 2 * far, rough=4 * evenness)
    return Ground(friction, strips=(bumps,))


def _with_groups(log: Log, groups: Groups) -> Log:
    """Drop the groups of columns that the measured log does not have."""
    every = ("imu", "q", "dq", "tau", "contact", "reference", "ref_v")
    drop = [g for g in every if g not in groups]
    prefixes = {"imu": ("gyro_", "accel_"), "reference": ("ref_",), "ref_v": ("ref_v_",)}
    gone = tuple(p for g in drop for p in prefixes.get(g, (f"{g}_",)))
    names = [n for n in log.frame if gone and str(n).startswith(gone)]
    return Log(log.frame.drop(columns=names), log.meta, log.name)
