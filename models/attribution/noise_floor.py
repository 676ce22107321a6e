"""What residual the declared model leaves by itself: the log's own motion, simulated again."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from surefoot.models.attribution.coarse_reference import Coarse, as_coarse, coarseness
from surefoot.models.attribution.evidence import (
    Evidence,
    Key,
    LogUnderModel,
    all_keys,
    linearise,
    log_under_model,
)
from surefoot.models.attribution.fit import NormalEquations, design, fit, normal_equations
from surefoot.models.attribution.robust_weights import RobustWeights, robust_weights
from surefoot.models.attribution.sensor_noise import reading_noise, sheet_noise
from surefoot.models.attribution.settings import DEFAULT, TraceSettings
from surefoot.models.attribution.whiteness import variance_inflation
from surefoot.models.residuals.layout import Layout, layout_for
from surefoot.models.residuals.registry import channels
from surefoot.models.residuals.torques import declared
from surefoot.models.residuals.without_reference import can_reckon, reckoned_by_legs
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.effects import Effect, known_effects
from surefoot.sim.ground.terrain import Ground, Strip
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot
from surefoot.sim.robot.limbs import QUADRUPED, Limbs
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.walk import walk
from surefoot.sim.walking.imitation import PIECE, body_twists

Twists = tuple[tuple[float, float, float], ...]
Groups = tuple[str, ...]


@dataclass(frozen=True)
class Repeat:
    """One walk of the declared model: its evidence, robust weights, normal equations,
    and how far each column (W,) is from white (`models.attribution.whiteness`)."""

    evidence: Evidence
    robust_weights: RobustWeights
    normal_equations: NormalEquations
    variance_inflation: np.ndarray = field(default_factory=lambda: np.ones(1))


@dataclass(frozen=True)
class FloorPlan:
    """What is walked for a floor: the robot's file, a course a walk, the groups of columns that the
    logs have, how far the ground is from a plane [m, standard deviation], how coarse the reference
    is, and effects of the ground that no model can compensate."""

    file: Path
    courses: tuple[Twists, ...]
    groups: Groups
    evenness: float
    coarse: Coarse | None
    settings: TraceSettings
    ground: tuple[Effect, ...] = ()


@dataclass(frozen=True)
class Unchanged:
    """What runs in which nothing changed show once all that was found is in the model.

    runs: how many; differ: candidate -> standard deviation [its unit] of its size in a new run;
    left: channel -> the most that the runs leave, and as far again as they differ, root mean
    square [its unit].
    """

    runs: int
    differ: Mapping[Key, float]
    left: Mapping[str, float]


@dataclass(frozen=True)
class NoiseFloor:
    """The residual of a robot that is as its model says.

    sigma (W,): noise of each column of the residual table, in its unit; repeats: the walks that it
    is from, walked by `plan`; source: in words; readings: the logs, where their own noise is the
    floor; unchanged: what other runs of the machine show, where they are known.
    """

    sigma: np.ndarray
    repeats: tuple[Repeat, ...]
    source: str
    plan: FloorPlan | None = None
    readings: tuple[LogUnderModel, ...] = ()
    unchanged: Unchanged | None = None
    _known: dict = field(default_factory=dict, compare=False, repr=False)

    @property
    def evenness(self) -> float:
        """How far the ground of the walks is from a plane, m."""
        return self.plan.evenness if self.plan else 0.0

    def counted(self, sigma: np.ndarray, alike: np.ndarray | float = 1.0) -> np.ndarray:
        """Noise sigma (W,) as it counts in a fit: what is not white is less informative.

        Two parts, each with its own correlation: what the declared model leaves, which resembles
        the candidates as far as its contacts do, and what the log has beyond it, of which `alike`
        (W,) entries in a row are worth one.
        """
        if not self.repeats:
            return sigma
        least = np.minimum(self.sigma, sigma) ** 2
        faked = np.mean([one.variance_inflation for one in self.repeats], axis=0)
        return np.sqrt(least * faked + (sigma**2 - least) * alike)

    def sizes(self, chosen: Sequence[Key], key: Key) -> tuple[float, float]:
        """Mean and spread of the size that `key`, fitted along with `chosen`, has where it is not.

        Contacts that give and creep look a little like effects, the same way on every walk.
        """
        mean, spread = self._of_walks(chosen, key)
        differ = self.unchanged.differ.get(key, 0.0) if self.unchanged else 0.0
        return mean, float(np.hypot(spread, differ))

    def _of_walks(self, chosen: Sequence[Key], key: Key) -> tuple[float, float]:
        if key not in self._keys:
            return 0.0, 0.0
        limbs = self.repeats[0].evidence.layout.limbs
        alike = [k for k in self._keys if k[0] == key[0] and _part(k, limbs) == _part(key, limbs)]
        free = self.repeats[0].normal_equations
        if key in free.stands_for:
            # A bias is drawn whenever the sensor is switched on: `fit` puts that in its error.
            return 0.0, 0.0
        own = self._sizes(chosen, key)
        mean, count = float(np.mean(own)), len(own)
        if count < 2:
            return mean, 0.0
        # A few walks are few samples of how far a size varies: its like on other legs are more.
        spreads = [np.var(self._sizes(chosen, k), ddof=1) for k in alike if k not in chosen]
        spread = float(np.sqrt(max(np.var(own, ddof=1), np.mean(spreads)) * (1 + 1 / count)))
        # Only what the walks agree on is the contacts' doing; the rest is chance.
        return (mean if abs(mean) > 2.0 * spread / np.sqrt(count) else 0.0), spread

    def doubt(self, key: Key, offset: float) -> float:
        """Standard deviation of the size `offset` that `key` has where it is not: that of the
        channels it shows in, where they know it, or else a share of it."""
        if not self.repeats:
            return 0.0
        kind = known_effects()[key[0]]
        shows_in = [channels()[name] for name in kind.channels_of(key[1]) if name in channels()]
        known = [c.known_to[key[1]] for c in shows_in if key[1] in c.known_to]
        if known and len(known) == len(shows_in):
            return max(known)
        return self.repeats[0].evidence.settings.faked_share * abs(offset)

    @property
    def _keys(self) -> tuple[Key, ...]:
        return self.repeats[0].normal_equations.keys if self.repeats else ()

    def _sizes(self, chosen: Sequence[Key], key: Key) -> np.ndarray:
        """Size of `key` (R,), fitted along with `chosen`, on each walk that knows of all."""
        asked = (tuple(chosen), key)
        if asked not in self._known:
            keys = [*chosen, key]
            knowing = [one for one in self.repeats if set(keys) <= set(one.normal_equations.keys)]
            sizes = [fit(one.normal_equations, keys, errors=False).sizes[-1] for one in knowing]
            self._known[asked] = np.array(sizes or [0.0])
        return self._known[asked]


def _part(key: Key, limbs: Limbs) -> str:
    """What a target has in common with its like on other legs: 'FL_calf' is 'of a calf'."""
    name, target = key
    if target in limbs.joints:
        return f"of a {limbs.kind(limbs.joints.index(target))}"
    if target in limbs.legs:
        return "of a leg"
    if known_effects()[name].targets == "leg_axis":
        return f"of a {target.rsplit('_', 1)[-1]}"
    return target


def noise_floor(
    cases: Sequence[LogUnderModel],
    ground: Sequence[Effect] = (),
    unchanged: Unchanged | None = None,
) -> NoiseFloor:
    """Repeats of the logs' own motion by the declared robot, in simulation.

    Each of a few short walks follows a stretch of the reference's body velocities. Seeds are fixed,
    so the floor is a function of the logs. A stretch on which the robot falls is tried again
    slower; where it cannot walk at all, and for a machine on a fixed base, the noise of the
    readings alone is the floor.

    Args:
        cases: the logs under the declared model.
        ground: effects that every walk has and no model compensates.
        unchanged: what other runs of the machine show.
    """
    floor = replace(_plain_floor(cases, ground), unchanged=unchanged)
    if unchanged is None:
        return floor
    beside = f"{floor.source}, and what {unchanged.runs} runs in which nothing changed differ by"
    return replace(floor, source=beside)


def _plain_floor(cases: Sequence[LogUnderModel], ground: Sequence[Effect]) -> NoiseFloor:
    """The floor by these logs alone."""
    first = cases[0]
    if first.fixed:
        source = "how the readings differ from one row to the next"
        return NoiseFloor(reading_noise(cases), (), source, readings=tuple(cases))
    known = ("imu", "q", "dq", "tau", "contact", "reference", "ref_v")
    walks = first.robot.limbs == QUADRUPED
    evenness = max(float(case.log.meta.model.get("ground_evenness", 0.0)) for case in cases)
    plan = FloorPlan(
        file=first.robot.file,
        courses=tuple(courses([_walked(c) for c in cases], first.settings)) if walks else (),
        groups=tuple(g for g in known if all(case.log.has(g) for case in cases)),
        evenness=evenness,
        coarse=coarseness(first.log, first.settings),
        settings=first.settings,
        ground=tuple(ground),
    )
    floor = _floor(plan, ())
    if floor.repeats:
        return floor
    sigma = sheet_noise(first.log.rate, layout_for(first.robot.limbs), evenness)
    return NoiseFloor(sigma, (), "data sheets of the declared sensors")


def noise_floor_with(floor: NoiseFloor, effects: Sequence[Effect]) -> NoiseFloor:
    """The floor of a robot that has these effects and a model that knows of them.

    An effect on the body changes how feet land, so the model with it leaves another residual than
    the model without, as do readings of which undoing it loses something. The same floor for all
    others, or where the robot falls. Of a fixed base noise alone is the floor, and an effect may
    carry more of it into the residual.
    """
    if floor.readings:
        return replace(floor, sigma=reading_noise(floor.readings, effects))
    # Two digits: sizes that differ by less walk alike, and are walked once.
    telling = tuple(
        replace(e, value=float(np.clip(float(f"{e.value:.1e}"), *type(e).inside(e.target))))
        for e in effects
        if is_on_the_body(e)
    )
    if not telling or floor.plan is None or not floor.repeats:
        return floor
    other = _floor(floor.plan, telling)
    return replace(other, unchanged=floor.unchanged) if other.repeats else floor


def is_on_the_body(one: Effect) -> bool:
    """Whether a robot that has it walks otherwise, or undoing it in the readings loses something:
    a model that knows of it leaves another residual than one that need not."""
    kind = type(one)
    on_body = kind.edit_spec is not Effect.edit_spec
    return on_body or kind.alter_ground is not Effect.alter_ground or kind.is_lossy(one.target)


def _floor(plan: FloorPlan, effects: tuple[Effect, ...]) -> NoiseFloor:
    known = tuple(known_effects())
    seed = plan.settings.floor_seed
    # A course that other logs have too is walked once for all.
    alone = replace(plan, courses=())
    walks = [_repeat(alone, one, seed + i, effects, known) for i, one in enumerate(plan.courses)]
    repeats = tuple(one for one in walks if one is not None)
    if not repeats:
        return NoiseFloor(np.zeros(0), (), "")
    sigma = np.sqrt(np.mean([one.robust_weights.sigma**2 for one in repeats], axis=0))
    sigma = np.maximum(sigma, _least(repeats[0].evidence.layout))
    source = f"{len(repeats)} simulated walks of the declared model along the log's own course"
    if plan.coarse:
        source += ", seen by a reference as coarse as the log's"
    return NoiseFloor(sigma, repeats, source, plan)


def _least(layout: Layout) -> np.ndarray:
    """The least noise (W,) that columns count with."""
    least = np.zeros(layout.width)
    for name, columns in layout.channels.items():
        least[columns] = channels()[name].least_noise
    return least


def _walked(case: LogUnderModel) -> Log:
    """The log of a walk, without a reference as it walked by its IMU and legs: a floor's course
    need not be exact."""
    log, robot = case.log, case.robot
    if log.has("reference") or not isinstance(robot, Robot) or not can_reckon(log):
        return log
    return reckoned_by_legs(log, robot)


def courses(logs: Sequence[Log], settings: TraceSettings = DEFAULT) -> list[Twists]:
    """Commanded forward, lateral velocity [m/s] and turn [rad/s] a second, for each repeat; none
    where the robot stands on all its feet throughout."""
    if all(log.has("contact") and np.mean(log.contact) > settings.standing_share for log in logs):
        return [()] * settings.floor_walks
    # Two decimals: rounding makes equal courses equal, so that they are walked once.
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
def _repeat(
    plan: FloorPlan, course: Twists, seed: int, effects: tuple[Effect, ...], known: tuple[str, ...]
) -> Repeat | None:
    """One walk, fitted with the `known` effects; None where the robot falls at every speed.

    Args:
        plan: robot file, groups of columns and settings.
        course: (forward, lateral, turn) of each segment [m/s, m/s, rad/s]; empty for standing.
        seed: of the walk.
        effects: that the walk is simulated with.
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
        if plan.coarse:
            log = as_coarse(log, plan.coarse, np.random.default_rng(seed))
        case = log_under_model(log, robot, s)
        data = design(linearise([case], effects, all_keys(case)))
        # The same least noise as of the log: each channel then weighs alike in both.
        weights = robust_weights(data, _least(data.evidence.layout))
        beyond = variance_inflation(data, weights)
        sums = normal_equations(data, weights.sigma * np.sqrt(beyond), weights.weight).total()
        # Of the walk itself only what is left of it matters from here on.
        return Repeat(data.evidence.only(()), weights, sums, beyond)
    return None


def ground_of(
    segments: Sequence[Segment], evenness: float, settings: TraceSettings = DEFAULT
) -> Ground:
    """Ground for a walk, whose heights differ from a plane by `evenness` [m, standard deviation].

    The bumps of a rough strip deviate by a quarter of the highest.
    """
    if not evenness:
        return Ground(settings.floor_friction)
    far = float(np.ceil(2 + sum(s.duration * np.hypot(s.forward, s.lateral) for s in segments)))
    bumps = Strip((-far, 0.0), (far, 0.0), 2 * far, rough=4 * evenness)
    return Ground(settings.floor_friction, strips=(bumps,))


def _with_groups(log: Log, groups: Groups) -> Log:
    """The walk with no more columns than the measured log has."""
    every = ("imu", "q", "dq", "tau", "contact", "reference", "ref_v")
    drop = [g for g in every if g not in groups]
    prefixes = {"imu": ("gyro_", "accel_"), "reference": ("ref_",), "ref_v": ("ref_v_",)}
    gone = tuple(p for g in drop for p in prefixes.get(g, (f"{g}_",)))
    names = [n for n in log.frame if gone and str(n).startswith(gone)]
    return Log(log.frame.drop(columns=names), log.meta, log.name)
