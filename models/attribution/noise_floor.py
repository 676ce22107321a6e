"""Noise floor of a trace: the residual of the declared model itself.

The motion of the log is simulated again with the declared robot; the residual of these walks is
what remains when the model lacks nothing.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from surefoot.models.attribution.evidence import (
    Evidence,
    Key,
    LogUnderModel,
    all_keys,
    linearise,
    log_under_model,
)
from surefoot.models.attribution.fit import NormalEquations, design, fit, total_normal_equations
from surefoot.models.attribution.reference_sampling import (
    ReferenceSampling,
    reference_sampling,
    resample_reference,
)
from surefoot.models.attribution.robust_weights import RobustWeights, robust_weights
from surefoot.models.attribution.sensor_noise import apparent_sizes, data_sheet_noise, reading_noise
from surefoot.models.attribution.settings import DEFAULT, TraceSettings
from surefoot.models.attribution.whiteness import variance_inflation
from surefoot.models.residuals.layout import Layout, layout_for
from surefoot.models.residuals.registry import channels
from surefoot.models.residuals.torques import declared
from surefoot.models.residuals.without_reference import can_dead_reckon, with_dead_reckoning
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.effects import Effect, known_effects
from surefoot.sim.ground.terrain import Ground, Strip
from surefoot.sim.log import Log
from surefoot.sim.robot.limbs import QUADRUPED, Limbs
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
        normal_equations: of its blocks.
        variance_inflation: of each column (W,), see `models.attribution.whiteness`.
    """

    evidence: Evidence
    robust_weights: RobustWeights
    normal_equations: NormalEquations
    variance_inflation: np.ndarray = field(default_factory=lambda: np.ones(1))


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
    """

    file: Path
    courses: tuple[Twists, ...]
    groups: Groups
    evenness: float
    sampling: ReferenceSampling | None
    settings: TraceSettings
    ground: tuple[Effect, ...] = ()


@dataclass(frozen=True)
class RunVariation:
    """Variation between machines without an effect.

    Attributes:
        runs: number of machines' walks.
        size_spread: candidate -> standard deviation of its size in a new run [its unit].
        highest_residual: channel -> upper limit of the residual's root mean square [its unit]: the
            largest of the runs plus their range.
    """

    runs: int
    size_spread: Mapping[Key, float]
    highest_residual: Mapping[str, float]


POINT_FEET = RunVariation(
    runs=21,
    size_spread={
        ("joint_delay", "all"): 0.6e-3,
        ("clock_scale", "joints"): 6e-5,
        ("clock_scale", "feet"): 5e-5,
        ("contact_delay", "touchdown"): 3e-3,
        ("contact_delay", "liftoff"): 6e-3,
    },
    highest_residual={"leg_velocity": 4.4e-3, "stance_velocity": 2.8e-3, "contact_timing": 11e-3},
)
"""What rolling and creeping feet leave where a log gives them and they are taken for points.

From simulated walks of seven robots without an effect (spot_class, v60_class, go1, go2, aliengo,
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
        plan: what was simulated.
        readings: the logs, where the noise of their own readings is the floor.
        run_variation: variation between runs of the same machine, where known.
        of_noise: candidate -> apparent size that the noise of the readings alone gives it.
    """

    sigma: np.ndarray
    walks: tuple[FloorWalk, ...]
    source: str
    plan: FloorPlan | None = None
    readings: tuple[LogUnderModel, ...] = ()
    run_variation: RunVariation | None = None
    of_noise: Mapping[Key, float] = field(default_factory=dict)
    _known: dict = field(default_factory=dict, compare=False, repr=False)

    @property
    def evenness(self) -> float:
        """Standard deviation of the ground from a plane [m]: of the walks', or by the maps."""
        return self.plan.evenness if self.plan else _evenness(self.readings)

    def effective_noise(self, sigma: np.ndarray, alike: np.ndarray | float = 1.0) -> np.ndarray:
        """Effective noise (W,) of columns with noise sigma (W,), larger where it is not white.

        The sum of two parts: that of the declared model, inflated by its correlation with the
        candidates, and the excess of the log over it, of which `alike` (W,) successive entries
        count as one independent value.
        """
        if not (self.walks or self._by_feet):
            return sigma
        least = np.minimum(self.sigma, sigma) ** 2
        faked = 1.0
        if self.walks:
            faked = np.mean([one.variance_inflation for one in self.walks], axis=0)
        return np.sqrt(least * faked + (sigma**2 - least) * alike)

    def sizes(self, chosen: Sequence[Key], key: Key) -> tuple[float, float]:
        """Mean and spread of the apparent size of `key`, fitted along with `chosen`, without the
        effect.

        Compliant, creeping contacts resemble some effects a little, in the same way on every walk.
        Without walks, the noise of the readings gives some effects a size (`apparent_sizes`).
        """
        mean, spread = self._of_walks(chosen, key)
        differ = self.run_variation.size_spread.get(key, 0.0) if self.run_variation else 0.0
        return mean, float(np.hypot(spread, differ))

    def _of_walks(self, chosen: Sequence[Key], key: Key) -> tuple[float, float]:
        if key not in self._keys:
            return self.of_noise.get(key, 0.0), 0.0
        limbs = self.walks[0].evidence.layout.limbs
        alike = [k for k in self._keys if k[0] == key[0] and _part(k, limbs) == _part(key, limbs)]
        free = self.walks[0].normal_equations
        if key in free.described_by:
            # A turn-on bias is redrawn at every start; `fit` adds that to the covariance.
            return 0.0, 0.0
        own = self._sizes(chosen, key)
        mean, count = float(np.mean(own)), len(own)
        if count < 2:
            return mean, 0.0
        # A few walks are a small sample; include the variance of the same part on other legs.
        spreads = [np.var(self._sizes(chosen, k), ddof=1) for k in alike if k not in chosen]
        spread = float(np.sqrt(max(np.var(own, ddof=1), np.mean(spreads)) * (1 + 1 / count)))
        # Only a mean that is significant over the walks is a property of the contacts.
        return (mean if abs(mean) > 2.0 * spread / np.sqrt(count) else 0.0), spread

    def size_uncertainty(self, key: Key, offset: float) -> float:
        """Standard deviation of the apparent size `offset` that `key` has without the effect.

        Taken from the channels in which the effect shows if all of them declare it, else a share of
        the offset.
        """
        if not self.walks:
            # Noise is not quite normal and white, so its share is no better known.
            return self._settings.apparent_size_uncertainty * abs(offset)
        kind = known_effects()[key[0]]
        shows_in = [channels()[name] for name in kind.channels_of(key[1]) if name in channels()]
        known = [c.level_spread[key[1]] for c in shows_in if key[1] in c.level_spread]
        if known and len(known) == len(shows_in):
            return max(known)
        return self._settings.apparent_size_uncertainty * abs(offset)

    @property
    def _by_feet(self) -> bool:
        """Whether the logs are of a machine that is known by its feet alone."""
        return bool(self.readings) and self.readings[0].by_feet

    @property
    def _settings(self) -> TraceSettings:
        if self.walks:
            return self.walks[0].evidence.settings
        return self.readings[0].settings if self.readings else DEFAULT

    @property
    def _keys(self) -> tuple[Key, ...]:
        return self.walks[0].normal_equations.keys if self.walks else ()

    def _sizes(self, chosen: Sequence[Key], key: Key) -> np.ndarray:
        """Apparent size of `key` (R,), fitted along with `chosen`, on each walk that has all of
        them.
        """
        asked = (tuple(chosen), key)
        if asked not in self._known:
            keys = [*chosen, key]
            knowing = [one for one in self.walks if set(keys) <= set(one.normal_equations.keys)]
            sizes = [fit(one.normal_equations, keys, errors=False).sizes[-1] for one in knowing]
            self._known[asked] = np.array(sizes or [0.0])
        return self._known[asked]


def _part(key: Key, limbs: Limbs) -> str:
    """What a target shares with its counterparts on other legs: 'of a calf' for 'FL_calf'."""
    name, target = key
    if target in limbs.joints:
        return f"of a {limbs.kind(limbs.joints.index(target))}"
    if target in limbs.legs:
        return "of a leg"
    if known_effects()[name].targets == "leg_axis":
        return f"of a {target.rsplit('_', 1)[-1]}"
    return target


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
        source = "the differences between successive readings"
        sigma = _of_readings(cases)
        known = apparent_sizes(cases, sigma)
        return NoiseFloor(sigma, (), source, readings=tuple(cases), of_noise=known)
    if first.by_feet:
        source = (
            "the noise of the readings, and what point feet leave on simulated walks of other "
            "robots, since there is no model of this one"
        )
        readings = tuple(cases)
        return NoiseFloor(_of_readings(cases), (), source, None, readings, POINT_FEET)
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
    floor = _floor(plan, ())
    if floor.walks:
        return floor
    sigma = data_sheet_noise(first.log.rate, layout_for(first.robot.limbs), evenness)
    return NoiseFloor(sigma, (), "data sheets of the declared sensors")


def noise_floor_with(floor: NoiseFloor, effects: Sequence[Effect]) -> NoiseFloor:
    """The noise floor of a robot with these effects, compensated by its model.

    An effect on the body changes how the feet land, and compensating some effects loses
    information; either changes the residual. The floor is unchanged for all other effects, and
    where the robot falls. On a fixed base the floor is the noise of the readings as the
    compensation propagates it.
    """
    if floor.readings:
        return replace(floor, sigma=_of_readings(floor.readings, effects))
    limbs = floor.walks[0].evidence.layout.limbs if floor.walks else None
    # Rounded to two digits, so that nearly equal sizes share one simulated walk.
    bounds = [type(e).interior_bounds(e.target, limbs) for e in effects]
    telling = tuple(
        replace(e, value=float(np.clip(float(f"{e.value:.1e}"), *within)))
        for e, within in zip(effects, bounds, strict=True)
        if is_compensated_approximately(e)
    )
    if not telling or floor.plan is None or not floor.walks:
        return floor
    other = _floor(floor.plan, telling)
    return replace(other, run_variation=floor.run_variation) if other.walks else floor


def is_compensated_approximately(one: Effect) -> bool:
    """Whether an effect changes the robot's motion, or compensating it loses information.

    In either case the residual differs from that of a robot without the effect even if it is
    compensated exactly.
    """
    kind = type(one)
    on_body = kind.edit_spec is not Effect.edit_spec
    return on_body or kind.alter_ground is not Effect.alter_ground or kind.is_lossy(one.target)


def _floor(plan: FloorPlan, effects: tuple[Effect, ...]) -> NoiseFloor:
    known = tuple(known_effects())
    seed = plan.settings.floor_seed
    # Without the other courses, so that a walk is cached once for all logs that contain it.
    alone = replace(plan, courses=())
    walks = [
        _floor_walk(alone, one, seed + i, effects, known) for i, one in enumerate(plan.courses)
    ]
    completed = tuple(one for one in walks if one is not None)
    if not completed:
        return NoiseFloor(np.zeros(0), (), "")
    sigma = np.sqrt(np.mean([one.robust_weights.sigma**2 for one in completed], axis=0))
    sigma = np.maximum(sigma, _least_noise(completed[0].evidence.layout))
    source = f"{len(completed)} simulated walks of the declared model along the log's own course"
    if plan.sampling:
        source += ", with a reference as coarse as the log's"
    return NoiseFloor(sigma, completed, source, plan)


def _of_readings(cases: Sequence[LogUnderModel], effects: Sequence[Effect] = ()) -> np.ndarray:
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
    plan: FloorPlan, course: Twists, seed: int, effects: tuple[Effect, ...], known: tuple[str, ...]
) -> FloorWalk | None:
    """One walk, fitted with the `known` effects; None where the robot falls at every speed.

    Args:
        plan: robot file, groups of columns and settings.
        course: (forward, lateral, yaw rate) of each segment [m/s, m/s, rad/s]; empty for standing.
        seed: of the walk.
        effects: with which the walk is simulated.
        known: names of the effects that the fit may use.
    """
    robot, s = declared(plan.file), plan.settings
    for slower in (1.0, 0.6, 0.3) if course else (1.0,):
        segments = tuple(
            Segment(PIECE, forward * slower, lateral * slower, turn * slower)
            for forward, lateral, turn in course or ((0.0, 0.0, 0.0),)
        )
        stand = s.floor_stand if course else s.floor_seconds
        scenario = Scenario("floor", segments, ground_of(segments, plan.evenness, s), stand=stand)
        try:
            log = walk(scenario, robot, seed, (*plan.ground, *effects), declared=False)
        except SurefootError:  # fallen, or a size that leaves it no foot
            continue
        if not course:
            log = replace(log, frame=log.frame[log.t - log.t[0] < s.floor_seconds - s.floor_stand])
        log = _with_groups(log, plan.groups)
        if plan.sampling:
            log = resample_reference(log, plan.sampling, np.random.default_rng(seed))
        case = log_under_model(log, robot, s)
        data = design(linearise([case], effects, all_keys(case)))
        # The same minimum noise as for the log, so that channels have the same relative weight.
        weights = robust_weights(data, _least_noise(data.evidence.layout))
        beyond = variance_inflation(data, weights)
        sums = total_normal_equations(data, weights.sigma * np.sqrt(beyond), weights.weight)
        # The candidates' regressors are no longer needed.
        return FloorWalk(data.evidence.only(()), weights, sums, beyond)
    return None


def ground_of(
    segments: Sequence[Segment], evenness: float, settings: TraceSettings = DEFAULT
) -> Ground:
    """Ground whose height deviates from a plane by `evenness` [m, standard deviation].

    The bumps of a rough strip have a standard deviation of a quarter of their height.
    """
    if not evenness:
        return Ground(settings.floor_friction)
    far = float(np.ceil(2 + sum(s.duration * np.hypot(s.forward, s.lateral) for s in segments)))
    bumps = Strip((-far, 0.0), (far, 0.0), 2 * far, rough=4 * evenness)
    return Ground(settings.floor_friction, strips=(bumps,))


def _with_groups(log: Log, groups: Groups) -> Log:
    """Drop the groups of columns that the measured log does not have."""
    every = ("imu", "q", "dq", "tau", "contact", "reference", "ref_v")
    drop = [g for g in every if g not in groups]
    prefixes = {"imu": ("gyro_", "accel_"), "reference": ("ref_",), "ref_v": ("ref_v_",)}
    gone = tuple(p for g in drop for p in prefixes.get(g, (f"{g}_",)))
    names = [n for n in log.frame if gone and str(n).startswith(gone)]
    return Log(log.frame.drop(columns=names), log.meta, log.name)
