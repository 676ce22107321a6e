"""Forces on a robot: friction of the feet, by those that slide, and outside forces.

A foot sliding along the ground with velocity v under the normal force n feels the tangential force
-mu n v / |v| (Coulomb). The force follows from the leg's torques, J^T f = inverse dynamics -
measured torque, and the velocity from kinematics and the reference. A foot that sticks gives only a
lower bound of mu.

Where a hand, a cable or a wall pushes the robot, the feet's forces differ from what the base's
motion requires (`base_wrench`), on a fixed base the torques from what the joints' motion requires,
for a while and not at every stride; an error of the robot's model recurs with its gait or motion.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.ndimage import uniform_filter1d

from surefoot.models.attribution.effect_sizes import Found
from surefoot.models.attribution.evidence import Evidence, LogUnderModel
from surefoot.models.attribution.weights import SLOWEST_SLIP
from surefoot.models.bootstrap import BLOCK_SECONDS, block_bootstrap_counts
from surefoot.models.residuals.binning import BIN, at_rows, base_motion
from surefoot.models.residuals.layout import Layout
from surefoot.models.residuals.torques import feet_wrenches
from surefoot.sim.common.gravity import GRAVITY
from surefoot.sim.effects import effect
from surefoot.sim.log import joint_velocity

DRY_FRICTION = 0.8
"""Coefficient of friction of a dry floor."""
DRY_SHARE = 0.75
"""Smallest friction of a dry floor, relative to the declared one: 0.6 of 0.8."""
_SLIDING_SPEED = 0.08
"""Speed from which a loaded foot certainly slides, above the error of joint rates [m/s]."""
OPPOSING = 0.9
"""Cosine between the ground's force on a sliding foot and the direction opposite to its motion."""
SLIDE_GAP = 0.02
"""Gap between sliding rows from which they belong to two slides [s]."""
SHORTEST_SLIDE = 0.008
"""Shortest slide [s]: most of _WINDOW. A landing foot, and one on a leg that springs, seem to slide
for less.
"""
SLIDE_LOAD = 0.08
"""Load on a foot, as a share of the weight, below which the leg's inertia spoils its force."""
_WINDOW = 0.01
"""Averaging time of these forces and velocities [s]."""
FEWEST_SLIDES = 5
"""Number of slides needed to estimate their friction."""
EVERYWHERE = 0.5
"""Share of the parts of a walk with a slide from which all the ground is slippery, not patches of
it.
"""
USED_RANGE = (0.7, 1.1)
"""Range of the friction used without sliding, relative to that of sliding feet: nearly all of it on
slippery ground, 3.3 times as much on compliant legs (walks of the Go1's model).
"""
SLIDE_SPREAD = 0.1
"""Largest interquartile range of the slides' friction, relative to their median: 0.05 on slippery
ground, 0.12 on soft ground and more on compliant legs (walks of the models of five robots).
"""
PUSH_OUTLIER = 6.0
"""Robust deviations above its median from which the residual force on the base is external."""
PUSH_SHARE = 0.03
"""Smallest outside force, as a share of the weight: 9 N for 32 kg; on a fixed base a torque, as a
share of the joint's largest.
"""
PUSH_GAP = 0.5
"""Gap from which two outside forces are separate, and margin around one in which it may act [s]."""
SHORTEST_PUSH = 0.1
"""Shortest outside force; a single bad touchdown is shorter [s]."""
PUSHED_SHARE = 0.3
"""Share of a log from which such forces are an error of the robot's model."""


@dataclass(frozen=True)
class FootFriction:
    """Friction of the feet.

    Attributes:
        limit: coefficient of friction at which feet slid; None where they hardly did.
        interval: 95 % interval of `limit`.
        slides: number of slides.
        scatter: interquartile range of their friction, relative to `limit`.
        everywhere: whether slides occur on most of the way and not on patches only.
        held: 99 % quantile of the friction used without sliding, a lower bound.
        by_leg: number of slides of each leg that slid.
    """

    limit: float | None
    interval: tuple[float, float]
    slides: int
    everywhere: bool
    held: float
    scatter: float = 0.0
    by_leg: Mapping[str, int] = field(default_factory=dict)

    @property
    def consistent(self) -> bool:
        """Whether all slides are at one friction, and sticking feet use nearly all of it and no
        more.

        Otherwise a delay or leg compliance may look like sliding.
        """
        if self.limit is None:
            return False
        low, high = USED_RANGE
        use = low * self.limit < self.held < high * self.limit
        return use and self.scatter < SLIDE_SPREAD


def estimate_friction(
    cases: Sequence[LogUnderModel], rng: np.random.Generator
) -> FootFriction | None:
    """Estimate the friction of the feet in these logs.

    None unless some log of a walking robot has torques, IMU, contacts and reference.

    Args:
        cases: logs under the model.
        rng: of the bootstrap over slides.
    """
    able = [case for case in cases if _is_determined(case)]
    if not able:
        return None
    held, slides, places, by_leg = [], [], [], Counter[str]()
    for number, case in enumerate(able):
        speed, along, used = _feet(case)
        held.append(used[speed < SLOWEST_SLIP])
        sliding = (speed > _SLIDING_SPEED) & (along > OPPOSING * used)
        for leg in range(sliding.shape[1]):
            rows = np.flatnonzero(sliding[:, leg])
            breaks = np.flatnonzero(np.diff(case.log.t[rows]) > SLIDE_GAP) + 1
            for one in np.split(rows, breaks):
                if len(one) >= SHORTEST_SLIDE * case.log.rate:
                    slides.append(np.median(along[one, leg]))
                    places.append((number, case.log.t[one[0]]))
                    by_leg[case.log.legs[leg]] += 1
    used = np.concatenate(held)
    most = float(np.quantile(used, 0.99)) if len(used) else 0.0
    if len(slides) < FEWEST_SLIDES:
        return FootFriction(None, (most, np.inf), len(slides), False, most)
    drawn = block_bootstrap_counts(len(slides), rng)
    medians = [np.median(np.repeat(slides, counts)) for counts in drawn]
    low, high = (float(x) for x in np.percentile(medians, [2.5, 97.5]))
    first, limit, third = (float(x) for x in np.percentile(slides, [25.0, 50.0, 75.0]))
    scatter = (third - first) / max(limit, 1e-12)
    span = sum(np.ptp(case.log.t) for case in able)
    parts = int(span / BLOCK_SECONDS)
    if most < USED_RANGE[1] * limit:
        # No foot that sticks uses more, so that few slides suffice.
        parts = min(parts, len(slides) // 2)
    length = span / max(1, parts)
    with_slides = {(log, t // length) for log, t in places}
    everywhere = len(with_slides) / max(1, parts) > EVERYWHERE
    return FootFriction(limit, (low, high), len(slides), everywhere, most, scatter, dict(by_leg))


def slip_effect(friction: FootFriction | None) -> tuple[Found, ...]:
    """The effect `foot_slip`, where friction is lower everywhere than on a dry floor."""
    if friction is None or friction.limit is None or not friction.everywhere:
        return ()
    low, high = friction.interval
    if high >= DRY_SHARE * DRY_FRICTION or not friction.consistent:
        return ()
    lost = effect(
        "foot_slip", "all", float(np.clip(1.0 - friction.limit / DRY_FRICTION, 0.0, 0.95))
    )
    return (Found(lost, (1.0 - high / DRY_FRICTION, 1.0 - low / DRY_FRICTION)),)


def slippery_places(friction: FootFriction | None) -> float | None:
    """Friction of the places in which feet slide, to two decimals; None where there are none."""
    if friction is None or friction.limit is None or friction.everywhere:
        return None
    return round(friction.limit, 2) if friction.scatter < SLIDE_SPREAD else None


def slip_notes(friction: FootFriction | None, walks: bool) -> tuple[str, ...]:
    """Notes on the friction of the feet.

    Args:
        friction: as estimated.
        walks: whether the logs show feet in stance.
    """
    if friction is None:
        lacking = "foot_slip: not identifiable without torques, IMU, contacts and a reference"
        return (lacking,) if walks else ()
    many = f"{friction.slides} slides under load"
    if friction.limit is None:
        # The friction of a foot that sticks is at least what it uses.
        share = max(0.0, 1.0 - friction.held / DRY_FRICTION)
        return (
            f"foot_slip: not identifiable, the feet hardly slide ({many}); they used a coefficient "
            f"of friction of up to {friction.held:.2f}, so a loss of up to {100 * share:.0f} % of "
            f"{DRY_FRICTION:g} would not show; harder starts, stops and turns would show it",
        )
    low, high = friction.interval
    where = "all along the way" if friction.everywhere else "in places"
    size = f"{friction.limit:.2f} ({low:.2f} to {high:.2f})"
    legs = ", ".join(f"{leg} {count}" for leg, count in friction.by_leg.items())
    note = f"friction: {many} ({legs}) at a coefficient of {size}, {where}"
    if not friction.consistent:
        note += f"; feet that did not slide used a coefficient of up to {friction.held:.2f}"
        if friction.everywhere:
            note += ", so soles differ, or a delay or leg compliance may look like sliding"
    return (note,)


def _is_determined(case: LogUnderModel) -> bool:
    groups = ("q", "tau", "contact", "reference", "imu")
    return case.robot.legged is not None and not case.fixed and all(map(case.log.has, groups))


def _feet(case: LogUnderModel) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Speed and friction use of each loaded foot (N, L), NaN elsewhere.

    Returns the speed over the ground [m/s], and the ratio of tangential to normal force: the
    component against the motion, and the magnitude.
    """
    log, motion, robot = case.log, case.motion, case.robot.legged
    assert robot is not None  # as `_is_determined`
    stands, dq = log.contact & motion.ok[:, None], joint_velocity(log)
    rows = max(1, round(_WINDOW * log.rate))

    def smooth(x: np.ndarray) -> np.ndarray:
        return uniform_filter1d(x, rows, axis=0)

    v_I = robot.feet.imu_velocity(log.q, dq, at_rows(log.gyro), motion.normal_I, stands)
    # A foot at rest reproduces the reference's velocity; the difference is the foot's own.
    v_B = smooth(np.nan_to_num(motion.v_I[:, None] - v_I) @ robot.R_BI.T)
    up_B = motion.normal_I @ robot.R_BI.T
    ddq = np.gradient(smooth(dq), log.t, axis=0)
    imu = (motion.gyro, motion.accel) if log.has("ref_v") else (log.gyro, log.accel)
    base = base_motion(log.t, *imu, robot)
    _, torque = robot.dynamics.inverse(log.q, dq, ddq, base)
    radius = np.tile(np.maximum(robot.foot_radius, 0.0), (len(log.t), 1))
    taken = np.ascontiguousarray(torque - log.tau)
    force_B = feet_wrenches(robot.legs, radius, log.q, up_B, stands, taken)[..., :3]
    force_B, n_B = smooth(force_B), up_B[:, None]
    load, rise = np.sum(force_B * n_B, axis=2), np.sum(v_B * n_B, axis=2)
    f_B, slide_B = force_B - load[..., None] * n_B, v_B - rise[..., None] * n_B
    whole = smooth(stands.astype(float)) > 0.999
    loaded = whole & (load > SLIDE_LOAD * robot.mass * GRAVITY)
    safe = np.where(loaded, load, np.nan)
    speed = np.linalg.norm(slide_B, axis=2)
    along = -np.sum(f_B * slide_B, axis=2) / np.maximum(speed, 1e-9) / safe
    return np.where(loaded, speed, np.nan), along, np.linalg.norm(f_B, axis=2) / safe


@dataclass(frozen=True)
class Push:
    """An outside force on a log.

    Attributes:
        log: index of the log, from 0.
        begin: start [s since the log's first row].
        end: end [s since the log's first row].
        force: its maximum [unit]; of a machine on a fixed base, the torque at a joint.
        unit: N or N m.
    """

    log: int
    begin: float
    end: float
    force: float
    unit: str

    def in_words(self) -> str:
        """A phrase such as 'outside forces of up to 21 N from 4.0 to 5.1 s of run 1'."""
        when = f"from {self.begin:.1f} to {self.end:.1f} s of run {self.log + 1}"
        size = f"{self.force:.2g} N" if self.unit == "N" else f"{self.force:.2g} N m at a joint"
        return f"outside forces of up to {size} {when}"


def outside_forces(
    cases: Sequence[LogUnderModel], left: np.ndarray, known: Evidence, averaged_over: float
) -> tuple[Push, ...]:
    """Find outside forces in the residual of logs.

    A log with such forces for much of its length has none: the cause is then the robot.

    Args:
        cases: the logs under the model.
        left: residual (M, W) with the effects found compensated; NaN where there is none.
        known: evidence whose columns and bins these are.
        averaged_over: time over which a residual is averaged [s].
    """
    pushes: list[Push] = []
    for number, case in enumerate(cases):
        own = known.log == number
        of_kind = _torques_beyond if case.fixed else _force_on_base
        force, share, unit = of_kind(case, left[own], known.layout, known.table[own])
        there = np.flatnonzero(np.isfinite(share))
        if len(there) == 0:
            continue
        t, force, share = known.t[own][there] - case.log.t[0], force[there], share[there]
        middle = np.median(share)
        spread = 1.4826 * np.median(np.abs(share - middle))
        rows = np.flatnonzero(share > max(middle + PUSH_OUTLIER * spread, PUSH_SHARE))
        apart, half = np.flatnonzero(np.diff(t[rows]) > PUSH_GAP) + 1, 0.5 * (averaged_over - BIN)
        found = [
            Push(
                number, float(t[i] - half), float(t[j] + half), float(force[i : j + 1].max()), unit
            )
            for i, j in ((one[0], one[-1]) for one in np.split(rows, apart) if len(one))
            if t[j] - t[i] + 2.0 * half >= SHORTEST_PUSH
        ]
        if sum(one.end - one.begin for one in found) < PUSHED_SHARE * np.ptp(t):
            pushes += found
    return tuple(pushes)


def _force_on_base(
    case: LogUnderModel, left: np.ndarray, layout: Layout, table: np.ndarray
) -> tuple[np.ndarray, np.ndarray, str]:
    """Residual force on the base of a walking robot: its magnitude (M,), share of the weight (M,),
    and unit.
    """
    none = np.full(len(left), np.nan)
    if case.robot.legged is None or "base_wrench" not in layout:
        return none, none, "N"
    force = np.linalg.norm(left[:, layout.of("base_wrench")[:3]], axis=1)
    # In standing, the feet share the load differently; judge whichever of the two is more common.
    stands = np.isfinite(table[:, layout.by_leg("leg_velocity")]).all(axis=(1, 2))
    walks = ~stands if stands.mean() < 0.5 else stands
    weight = case.robot.legged.mass * GRAVITY
    return force, np.where(walks, force, np.nan) / weight, "N"


def _torques_beyond(
    case: LogUnderModel, left: np.ndarray, layout: Layout, table: np.ndarray
) -> tuple[np.ndarray, np.ndarray, str]:
    """The same of a machine on a fixed base: residual torque (M,) of the joint where it is the
    largest share (M,) of the joint's peak torque.
    """
    none = np.full(len(left), np.nan)
    if not case.log.has("tau"):
        return none, none, "N m"
    torque = np.abs(left[:, layout.of("joint_torque")])
    peak = np.maximum(np.abs(case.log.tau).max(axis=0), 1e-9)
    share = torque / peak
    worst = np.argmax(np.nan_to_num(share), axis=1)[:, None]
    torque, share = (np.take_along_axis(one, worst, 1)[:, 0] for one in (torque, share))
    return torque, share, "N m"


def pushed_bins(
    cases: Sequence[LogUnderModel], known: Evidence, pushes: Sequence[Push]
) -> np.ndarray:
    """Mask (M,) of the bins in or near a push, whose influence on the motion takes a while to
    decay.
    """
    pushed = np.zeros(len(known.t), dtype=bool)
    for one in pushes:
        t = known.t - cases[one.log].log.t[0]
        near = (t > one.begin - PUSH_GAP) & (t < one.end + PUSH_GAP)
        pushed |= near & (known.log == one.log)
    return pushed
