"""Noise floor of a trace: the residual of the declared model itself.

The motion of the log is simulated again with the declared robot; the residual of these walks is
what remains when the model lacks nothing.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
from scipy.stats import chi2

from surefoot.models.attribution.design import (
    design,
    nuisance_precision,
    scaled_inverse,
    without_nuisance,
)
from surefoot.models.attribution.effect_sizes import with_clipped_size
from surefoot.models.attribution.evidence import (
    Key,
    LogUnderModel,
    all_keys,
    linearise,
    log_under_model,
)
from surefoot.models.attribution.metric import noise_of
from surefoot.models.attribution.model_error import ModelError, RunSums, model_error, sums_of
from surefoot.models.attribution.sensor_noise import (
    ReferenceSampling,
    apparent_sizes,
    reading_noise,
    reference_sampling,
    resample_reference,
)
from surefoot.models.attribution.weights import RobustWeights, robust_weights
from surefoot.models.residuals.binning import bin_mean, inner_bins
from surefoot.models.residuals.layout import Layout, layout_for
from surefoot.models.residuals.motion import with_dead_reckoning
from surefoot.models.residuals.torques import declared
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.effects import Effect, known_effects
from surefoot.sim.gait.options import MEASURED_GAIT, PLAIN_GAIT, GaitOptions
from surefoot.sim.ground.terrain import Ground, Patch, Strip
from surefoot.sim.log import Log
from surefoot.sim.log.schema import group_columns
from surefoot.sim.physics.scene import TIMESTEP
from surefoot.sim.robot.limbs import QUADRUPED
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.sensors.streams import SLOWEST, Sensors
from surefoot.sim.walk import walk
from surefoot.sim.walking.imitation import PIECE, body_twists

Twists = tuple[tuple[float, ...], ...]
"""Forward and lateral velocity [m/s] and yaw rate [rad/s] of a course, in steps of 1 s."""
_GROUPS = ("imu", "q", "dq", "tau", "contact", "reference", "ref_v")
"""Groups of a walk's columns that a measured log may lack."""
FRICTIONS = (0.5, 0.7, 0.9, 1.1)
"""Coefficients of friction of the ground of each walk: feet creep more where it is low."""
SEEN_UNEVENNESS = 0.6
"""Deviation of footholds from the planes through their neighbours, as a share of that of rough
ground: 0.52 to 0.71 on walks of the models of five robots.
"""
_SECONDS = 12.0
"""Length of each walk [s]."""
SMALLER, OF_SMALLER = 0.8, 70.0 * 0.438
"""Share of the fourth differences of readings, the smaller ones, by which noise is judged, and the
mean square of these for normal noise of size one.
"""
STAND = 0.5
"""Time that the robot stands before each walk [s]."""
STANDS = 0.999
"""Share of rows with ground contact from which a log is one of standing."""
SPEEDS = (1.0, 0.6, 0.3)
"""Shares of the log's velocities at which a walk is tried until the robot does not fall."""
SETTLING = 4.0
"""Beginning of a walk whose residual does not count [s], unless it is short: dry friction holds a
part of the load of a robot that stands, and feet are steadier in the first steps after it.
"""
_SEED = 20_011
"""Seed of the first walk, fixed so that the floor depends on the logs alone."""
ROUGHER = 2.0
"""Ratio of the roughness of a log to that of walks in the plain gait from which walks are simulated
in the measured one: 4 to 10 for two robots in that gait and for a real Go1, 1 to 1.6 in the plain
gait.
"""
APPARENT_SIZE_DOUBT = 0.7
"""Relative uncertainty of sizes that effects seem to have: on slippery ground, the contacts
imitated a delay of the joints four times as long as on the floor's.
"""
POINT_FEET_SIZES = {
    ("joint_delay", "all"): 0.6e-3,
    ("clock_scale", "joints"): 6e-5,
    ("clock_scale", "feet"): 5e-5,
    ("contact_delay", "touchdown"): 3e-3,
    ("contact_delay", "liftoff"): 6e-3,
}
POINT_FEET_LEVELS = {"leg_velocity": 4.4e-3, "stance_velocity": 2.8e-3, "contact_timing": 9e-3}
"""What rolling and creeping feet leave where a log gives them and they are taken for points.

From 21 simulated walks of seven robots without an effect (spot_class, v60_class, go1, go2, aliengo,
mini_cheetah, b2), each at 0.6, 1 and 1.3 times 0.5 m/s times its leg length over that of
spot_class. Root mean squares of the sizes that effects seem to have; the largest residuals, which
hardly depend on robot or speed, and a tenth more.
"""


@dataclass(frozen=True, eq=False)
class FloorWalk:
    """One simulated walk of the declared model, with effects that it has compensated.

    Attributes:
        case: the walk.
        effects: that it has.
        left: its residual without nuisance parameters and first steps (M, W); NaN where masked.
        weights: of its entries, and the noise of its columns.
    """

    case: LogUnderModel
    effects: tuple[Effect, ...]
    left: np.ndarray
    weights: RobustWeights

    def sums(self) -> RunSums:
        """Sums of the residual and of all candidates."""
        keys = all_keys(self.case)
        known = linearise([self.case], self.effects, keys, evaluation_channels=False)
        weights = robust_weights(known, known.layout.least_noise)
        weight = weights.weight * inner_bins(known.t)[:, None]
        return sums_of(self.case, known, weight, {}, simulated=True)

    def apparent_sizes(
        self, keys: Sequence[Key], sigma: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Sizes (k,) that candidates seem to have beyond those it has, and variances (k,) of their
        noise, for noise sigma (W,) of the columns, NaN where it is not known.
        """
        known = linearise([self.case], self.effects, keys, evaluation_channels=False)
        data, fitted = design(known), known.layout.fitted
        root = np.sqrt(self.weights.weight) / sigma
        root[~inner_bins(known.t)] = 0.0
        used, every = fitted[np.isfinite(sigma[fitted])], np.zeros(len(root), int)
        G = data.grams(data.y, root, used, every)[0]
        of_nuisance = np.diag(np.append(np.zeros(len(keys)), nuisance_precision(known)))
        covariance = scaled_inverse(G[1:, 1:] + of_nuisance)
        sizes = covariance @ G[1:, 0]
        return sizes[: len(keys)], np.diag(covariance)[: len(keys)]


@dataclass(frozen=True)
class FloorPlan:
    """Walks to simulate for a noise floor.

    Attributes:
        file: the robot's model.
        courses: commanded velocities, one course for each walk.
        groups: groups of columns that the logs have.
        level: whether the ground of any log counts as level.
        evenness: standard deviation of the ground's height from a plane [m].
        slippery: friction of places in which feet slide; None where there are none.
        gait: of the walks.
        sensors: their noise.
        sampling: sampling and noise of the reference, if measured.
        ground: effects of the ground, which no model can compensate.
        effects: that the robot has, compensated by its model.
        catalogue: names of all effects, which every walk is fitted with.
    """

    file: Path
    courses: tuple[Twists, ...]
    groups: tuple[str, ...]
    level: bool
    evenness: float
    slippery: float | None
    gait: GaitOptions
    sensors: Sensors
    sampling: ReferenceSampling | None
    ground: tuple[Effect, ...]
    effects: tuple[Effect, ...]
    catalogue: tuple[str, ...]


@dataclass(frozen=True)
class NoiseFloor:
    """Residual of a robot that matches its model.

    Attributes:
        sigma: noise of each column of the residual table (W,), in its unit.
        walks: the simulated walks.
        source: of the floor, in words.
        error: of the declared model; that of a machine on a fixed base for means over windows.
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

    def apparent_variances(self, keys: Sequence[Key]) -> np.ndarray:
        """Variances (k,) of the sizes that candidates seem to have in the walks beyond those which
        these have, as far as noise hardly explains them; zeros without walks.
        """
        known = self._variances.get(tuple(keys))
        if known is not None:
            return known
        if not self.walks or not keys:
            return np.zeros(len(keys))
        sigma = noise_of(self.error, layout_for(self.walks[0].case.robot.limbs))
        sizes, noise = zip(*(one.apparent_sizes(keys, sigma) for one in self.walks), strict=True)
        n = len(self.walks)
        by_chance = chi2.ppf(0.95, n) / n * np.mean(noise, axis=0)
        found = np.maximum(np.mean(np.square(sizes), axis=0) - by_chance, 0.0)
        return self._variances.setdefault(tuple(keys), found)

    @cached_property
    def _variances(self) -> dict[tuple[Key, ...], np.ndarray]:
        """Results of `apparent_variances`, which a search asks for again and again."""
        return {}


def left_deviations(plain: NoiseFloor, floor: NoiseFloor, keys: Sequence[Key]) -> np.ndarray:
    """Standard deviations (k,) of the sizes that candidates seem to have in what effects leave once
    they are compensated, beyond those that they seem to have without.

    Args:
        plain: floor of the declared model.
        floor: the same of the model with the effects.
        keys: of the candidates.
    """
    if floor is plain:
        return np.zeros(len(keys))
    more = floor.apparent_variances(keys) - plain.apparent_variances(keys)
    return np.sqrt(np.maximum(more, 0.0))


def noise_floor(
    cases: Sequence[LogUnderModel],
    ground: Sequence[Effect] = (),
    slippery: float | None = None,
) -> NoiseFloor:
    """Simulate the motion of the logs with the declared robot.

    Each of a few short walks follows a section of the reference's body velocities, on ground as
    uneven as that of the logs, and one over slippery places. Where torques are logged, the gait is
    about as rough as the logs'. Joints are as noisy, and there are as many rows a second, up to
    those of the simulation. Seeds are fixed, so the floor is a function of the logs. A section on
    which the robot falls is repeated at lower speed. For a robot that cannot walk at all the floor
    is the sensors' noise by their data sheets and that of the reference, for a machine on a fixed
    base the noise of its readings, and for one that is known by its feet alone that noise and
    POINT_FEET_LEVELS.

    Args:
        cases: the logs under the declared model.
        ground: effects of the ground that every walk has and no model compensates.
        slippery: friction of places in which feet slide; None where there are none.
    """
    first = cases[0]
    if first.fixed or first.by_feet:
        return _floor_of_readings(cases, ())
    plan = FloorPlan(
        file=first.robot.file,
        courses=tuple(_courses(cases)) if first.robot.limbs == QUADRUPED else (),
        groups=tuple(g for g in _GROUPS if all(case.log.has(g) for case in cases)),
        level=any(case.motion.level for case in cases),
        evenness=max(ground_evenness(cases), _seen_evenness(cases)),
        slippery=slippery,
        gait=PLAIN_GAIT,
        sensors=_sensors_at(min(case.log.rate for case in cases)),
        sampling=reference_sampling(first.log),
        ground=tuple(ground),
        effects=(),
        catalogue=tuple(known_effects()),
    )
    layout = layout_for(first.robot.limbs)
    walks = _floor_walks(plan)
    # Only torques hang on accelerations.
    if walks and "tau" in plan.groups:
        rough = replace(plan, gait=MEASURED_GAIT)
        rougher = _roughness(cases) > ROUGHER * _roughness([one.case for one in walks])
        if rougher and (in_measured_gait := _floor_walks(rough)):
            plan, walks = rough, in_measured_gait
    if walks:
        plan = replace(plan, sensors=_sensors_of(cases, walks, plan.sensors))
        walks = _floor_walks(plan)
    if walks:
        error = _error_of(plan) or _no_error(_noise_of(walks), layout)
        return _floor_of_walks(walks, error, plan)
    sigma = np.maximum(layout.noise(first.log.rate, plan.evenness), reading_noise(cases))
    source = "data sheets of the declared sensors, and the noise of the reference"
    return NoiseFloor(sigma, (), source, _error_of_readings(cases, sigma, layout))


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
        return _floor_of_readings(floor.readings, effects)
    if floor.plan is None:
        return floor
    robot = declared(floor.plan.file)
    telling = tuple(
        with_clipped_size(e, float(f"{e.value:.1e}"), robot)
        for e in effects
        if is_compensated_approximately(e)
    )
    if not telling:
        return floor
    if near is not None and near.plan is not None and _about_same(near.plan.effects, telling):
        return near
    plan = replace(floor.plan, effects=telling)
    walks = _floor_walks(plan)
    return _floor_of_walks(walks, floor.error, plan) if walks else floor


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
    on_ground = kind.alter_ground is not Effect.alter_ground
    return on_body or on_ground or kind.traced_at(one.target).lossy


def _floor_walks(plan: FloorPlan) -> tuple[FloorWalk, ...]:
    """The walks of a plan that the robot completes."""
    # Without the other courses, so that a walk is cached once for all logs that contain it.
    alone = replace(plan, courses=())
    walks = [_floor_walk(alone, course, number) for number, course in enumerate(plan.courses)]
    return tuple(one for one in walks if one is not None)


def _floor_of_walks(walks: tuple[FloorWalk, ...], error: ModelError, plan: FloorPlan) -> NoiseFloor:
    source = f"{len(walks)} simulated walks of the declared model along the log's own course"
    if plan.sampling:
        source += ", with a reference as coarse as the log's"
    return NoiseFloor(_noise_of(walks), walks, source, error, plan)


def _noise_of(walks: Sequence[FloorWalk]) -> np.ndarray:
    """Noise (W,) of the columns in walks of the declared model."""
    sigma = np.sqrt(np.mean([one.weights.sigma**2 for one in walks], axis=0))
    return np.maximum(sigma, layout_for(walks[0].case.robot.limbs).least_noise)


@lru_cache(maxsize=16)
def _error_of(plan: FloorPlan) -> ModelError | None:
    """Error of the declared model, as the walks of a plan show it; None if they are too few."""
    walks = _floor_walks(plan)
    return model_error([one.sums() for one in walks], walks[0].case.robot.limbs)


def _no_error(sigma: np.ndarray, layout: Layout) -> ModelError:
    """A model without errors beyond noise sigma (W,) of the columns."""
    noise = dict(zip(layout.kinds, sigma.tolist(), strict=True))
    return ModelError(0, (), np.zeros(0), np.zeros((0, 0)), noise, {})


def _error_of_readings(
    cases: Sequence[LogUnderModel], sigma: np.ndarray, layout: Layout
) -> ModelError:
    """A model with the sizes that the noise of readings alone gives effects, for noise sigma (W,)
    of the columns.
    """
    seen = apparent_sizes(cases, sigma)
    mean = np.array([*seen.values()])
    covariance = np.diag((APPARENT_SIZE_DOUBT * mean) ** 2)
    return replace(_no_error(sigma, layout), keys=tuple(seen), mean=mean, covariance=covariance)


def _floor_of_readings(cases: Sequence[LogUnderModel], effects: Sequence[Effect]) -> NoiseFloor:
    """The floor by the noise of the readings, with the effects compensated."""
    layout = layout_for(cases[0].robot.limbs)
    sigma = np.maximum(reading_noise(cases, effects), layout.least_noise)
    heights = layout.of("foot_height")
    sigma[heights] = np.hypot(sigma[heights], ground_evenness(cases))
    read = tuple(cases)
    if cases[0].by_feet:
        error = _no_error(sigma, layout)
        source = (
            "the noise of the readings, and what point feet leave on simulated walks of other "
            "robots, since there is no model of this one"
        )
        return NoiseFloor(sigma, (), source, error, readings=read, levels=POINT_FEET_LEVELS)
    error = _error_of_readings(cases, sigma, layout)
    source = "the differences between successive readings"
    return NoiseFloor(sigma, (), source, error, readings=read)


def ground_evenness(cases: Sequence[LogUnderModel]) -> float:
    """Largest standard deviation of the ground from a plane [m] that the logs' maps state."""
    return max(float(case.log.meta.model.get("ground_evenness", 0.0)) for case in cases)


def _seen_evenness(cases: Sequence[LogUnderModel]) -> float:
    """Largest standard deviation of the ground from a plane [m] that footholds show, to a
    millimetre.
    """
    return round(max(case.motion.unevenness for case in cases) / SEEN_UNEVENNESS, 3)


def _roughness(cases: Sequence[LogUnderModel]) -> float:
    """Root mean square of the second difference of the gyro's bin means [rad/s]; zero where a log
    has no IMU. What a bin's mean acceleration misses grows with it.
    """
    if not all(case.log.has("imu") for case in cases):
        return 0.0
    bends = [np.diff(bin_mean(case.motion)(case.log.gyro), n=2, axis=0) for case in cases]
    return float(np.sqrt(np.mean(np.concatenate(bends) ** 2)))


def _sensors_at(rate: float) -> Sensors:
    """Sensors of a log at this rate [Hz], or with a row in each step of the simulation."""
    rows = max(float(round(rate)), SLOWEST)
    return Sensors(rate=rows if rows < 1.0 / TIMESTEP else 0.0)


def _sensors_of(
    cases: Sequence[LogUnderModel], walks: Sequence[FloorWalk], usual: Sensors
) -> Sensors:
    """Sensors by which the joints' readings in walks are as noisy as those in the logs. What is
    added to the usual ones is a whole multiple of the data sheet's noise or, of angles, of the
    encoder's steps.

    Noise is judged by the smaller fourth differences, on which impacts and motion have little
    influence, of rows as far apart in walks as in logs.
    """
    logs = [case.log for case in cases], [one.case.log for one in walks]
    slowest = min(log.rate for log in (*logs[0], *logs[1]))
    finer = logs[1][0].rate / min(log.rate for log in logs[0])

    def square(log: Log, group: str) -> float:
        bends = np.diff(getattr(log, group)[:: round(log.rate / slowest)], n=4, axis=0)
        smaller = np.sort(np.abs(bends), axis=0)[: round(SMALLER * len(bends))]
        return float(np.mean(smaller**2)) / OF_SMALLER

    found = {}
    for group, name, unit in (
        ("q", "encoder_noise", usual.encoder_step),
        ("dq", "velocity_noise", usual.velocity_noise),
        ("tau", "torque_noise", usual.torque_noise),
    ):
        if all(log.has(group) for one in logs for log in one):
            measured, simulated = (np.mean([square(log, group) for log in one]) for one in logs)
            more = unit * round(float(np.sqrt(max(measured - simulated, 0.0) * finer)) / unit)
            found[name] = float(np.hypot(getattr(usual, name), more))
    return replace(usual, **found)


def _courses(cases: Sequence[LogUnderModel]) -> list[Twists]:
    """The course of each walk, as the logs went; empty where the robot stands on all feet."""
    if all(c.log.has("contact") and np.mean(c.log.contact) > STANDS for c in cases):
        return [()] * len(FRICTIONS)
    motion = []
    for case in cases:
        # Dead reckoning is accurate enough.
        log = case.log
        log = log if log.has("reference") else with_dead_reckoning(log, case.robot.feet)
        if log is not None:
            # Rounded to two decimals, so that nearly equal courses share one simulated walk.
            motion += [tuple(round(float(x), 2) for x in twist) for twist in body_twists(log)]
    length = max(1, min(round(_SECONDS / PIECE), len(motion)))
    starts = np.linspace(0, len(motion) - length, len(FRICTIONS)).round().astype(int)
    return [tuple(motion[start : start + length]) for start in starts] if motion else []


@lru_cache(maxsize=16)
def _floor_walk(plan: FloorPlan, course: Twists, number: int) -> FloorWalk | None:
    """One walk, fitted with all effects; None where the robot falls at every speed.

    Args:
        plan: robot file, groups of columns and effects.
        course: of the walk; empty for standing.
        number: of the walk, from 0.
    """
    robot, seed = declared(plan.file), _SEED + number
    for slower in SPEEDS if course else (1.0,):
        segments = tuple(
            Segment(PIECE, *(slower * x for x in twist)) for twist in course or ((0.0, 0.0, 0.0),)
        )
        last = number == len(FRICTIONS) - 1
        ground = ground_of(
            segments, plan.evenness, FRICTIONS[number], plan.slippery if last else None
        )
        stand = STAND if course else _SECONDS
        scenario = Scenario(
            "floor", segments, ground, sensors=plan.sensors, stand=stand, gait=plan.gait
        )
        try:
            log = walk(scenario, robot, seed, (*plan.ground, *plan.effects), declared=False)
        except SurefootError:  # fallen, or a size that leaves it no foot
            continue
        if not course:
            log = replace(log, frame=log.frame[log.t - log.t[0] < _SECONDS - STAND])
        # Without the columns that the measured logs do not have.
        lacking = [g for g in _GROUPS if g not in plan.groups]
        gone = [n for g in lacking for n in group_columns(g, log.joints, log.legs)]
        log = replace(log, frame=log.frame.drop(columns=gone))
        if plan.sampling:
            log = resample_reference(log, plan.sampling, np.random.default_rng(seed))
        case = log_under_model(log, robot)
        case = replace(case, motion=replace(case.motion, level=plan.level))
        known = linearise([case], plan.effects, ())
        # The same minimum noise as for the log, so that channels have the same relative weight.
        weights = robust_weights(known, known.layout.least_noise)
        left = without_nuisance(known, weights.sigma, weights.weight, inner_bins(known.t))
        return FloorWalk(case, plan.effects, left[settled_bins(known.t)], weights)
    return None


def settled_bins(t: np.ndarray) -> np.ndarray:
    """Mask (M,) of the bins of a walk, at times t (M,) [s], whose residual the floor is of: those
    that are neither at its ends nor in its first steps.
    """
    first = SETTLING if t[-1] - t[0] > 2.0 * SETTLING else 0.0
    return inner_bins(t) & (t > t[0] + first)


def ground_of(
    segments: Sequence[Segment], evenness: float, friction: float, slippery: float | None = None
) -> Ground:
    """Ground whose height deviates from a plane by `evenness` [m, standard deviation].

    The bumps of a rough strip have a standard deviation of a quarter of their height.

    Args:
        segments: of the course.
        evenness: [m].
        friction: its coefficient.
        slippery: coefficient of friction on a metre of every three ahead and behind; None for none.
    """
    far = float(np.ceil(2 + sum(s.duration * np.hypot(s.forward, s.lateral) for s in segments)))
    strips, patches = (), ()
    if evenness:
        strips = (Strip((-far, 0.0), (far, 0.0), 2 * far, rough=4 * evenness),)
    if slippery is not None:
        places = np.arange(1.5 - 3.0 * (far // 3), far, 3.0)
        patches = tuple(Patch(float(x), 0.0, 1.0, 2 * far, slippery) for x in places)
    return Ground(friction, patches, strips=strips)
