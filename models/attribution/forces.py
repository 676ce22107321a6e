"""Forces that the robot's model does not have: friction of feet that slide, and outside forces."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d

from surefoot.models.attribution.effect_sizes import Found
from surefoot.models.attribution.evidence import Evidence, LogUnderModel
from surefoot.models.attribution.settings import TraceSettings
from surefoot.models.bootstrap import block_bootstrap_counts
from surefoot.models.residuals.binning import at_rows, base_motion
from surefoot.models.residuals.torques import feet_wrenches
from surefoot.sim.common.gravity import GRAVITY
from surefoot.sim.effects import effect
from surefoot.sim.log import joint_velocity


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
    """

    limit: float | None
    interval: tuple[float, float]
    slides: int
    everywhere: bool
    held: float
    scatter: float = 0.0

    def consistent(self, settings: TraceSettings) -> bool:
        """Whether all slides are at one friction, and sticking feet use nearly all of it and no
        more.

        Otherwise a delay or leg compliance may look like sliding.
        """
        if self.limit is None:
            return False
        low, high = settings.used_friction_range
        use = low * self.limit < self.held < high * self.limit
        return use and self.scatter < settings.slide_spread


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
    s = able[0].settings
    held, slides, places = [], [], []
    for number, case in enumerate(able):
        speed, along, used = _feet(case)
        held.append(used[speed < s.slowest_slip])
        sliding = (speed > s.sliding_speed) & (along > s.opposing_cosine * used)
        for leg in range(sliding.shape[1]):
            rows = np.flatnonzero(sliding[:, leg])
            breaks = np.flatnonzero(np.diff(case.log.t[rows]) > s.slide_gap) + 1
            for one in np.split(rows, breaks):
                if len(one) < s.shortest_slide * case.log.rate:
                    continue
                slides.append(along[one, leg])
                places.append((number, case.log.t[one[0]]))
    used = np.concatenate(held)
    most = float(np.quantile(used, 0.99)) if len(used) else 0.0
    if len(slides) < s.fewest_slides:
        return FootFriction(None, (most, np.inf), len(slides), False, most)
    middle = np.array([np.median(one) for one in slides])
    drawn = block_bootstrap_counts(len(middle), rng)
    medians = [np.median(np.repeat(middle, counts)) for counts in drawn]
    low, high = (float(x) for x in np.percentile(medians, [2.5, 97.5]))
    first, limit, third = (float(x) for x in np.percentile(middle, [25.0, 50.0, 75.0]))
    scatter = (third - first) / max(limit, 1e-12)
    parts = int(sum(np.ptp(case.log.t) for case in able) / s.block)
    if most < s.used_friction_range[1] * limit:
        # No foot that sticks uses more, so that few slides suffice.
        parts = min(parts, len(slides) // 2)
    everywhere = _spread(places, able, max(1, parts)) > s.slides_everywhere
    return FootFriction(limit, (low, high), len(slides), everywhere, most, scatter)


def _spread(
    places: Sequence[tuple[int, float]], cases: Sequence[LogUnderModel], parts: int
) -> float:
    """Share of this many parts of the logs in which slides occur.

    Args:
        places: number of the log and time [s] of each slide.
        cases: the logs.
        parts: number of parts of equal duration.
    """
    length = sum(np.ptp(case.log.t) for case in cases) / parts
    return len({(log, t // length) for log, t in places}) / parts


def slip_effect(friction: FootFriction | None, settings: TraceSettings) -> tuple[Found, ...]:
    """The effect `foot_slip`, where friction is lower everywhere than on a dry floor."""
    if friction is None or friction.limit is None or not friction.everywhere:
        return ()
    dry, (low, high) = settings.dry_friction, friction.interval
    if high >= settings.dry_friction_share * dry or not friction.consistent(settings):
        return ()
    lost = effect("foot_slip", "all", float(np.clip(1.0 - friction.limit / dry, 0.0, 0.95)))
    return (Found(lost, (1.0 - high / dry, 1.0 - low / dry)),)


def slip_notes(
    friction: FootFriction | None, walks: bool, settings: TraceSettings
) -> tuple[str, ...]:
    """Notes on the friction of the feet.

    Args:
        friction: as estimated.
        walks: whether the logs show feet in stance.
        settings: of the trace.
    """
    if friction is None:
        lacking = "foot_slip: not identifiable without torques, IMU, contacts and a reference"
        return (lacking,) if walks else ()
    dry, many = settings.dry_friction, f"{friction.slides} slides under load"
    if friction.limit is None:
        # The friction of a foot that sticks is at least what it uses.
        share = max(0.0, 1.0 - friction.held / dry)
        return (
            f"foot_slip: not identifiable, the feet hardly slide ({many}); they used a coefficient "
            f"of friction of up to {friction.held:.2f}, so a loss of up to {100 * share:.0f} % of "
            f"{dry:g} would not show; harder starts, stops and turns would show it",
        )
    low, high = friction.interval
    where = "all along the way" if friction.everywhere else "in places"
    size = f"{friction.limit:.2f} ({low:.2f} to {high:.2f})"
    note = f"friction: {many} at a coefficient of {size}, {where}"
    if not friction.consistent(settings):
        note += f"; feet that did not slide used a coefficient of up to {friction.held:.2f}"
        if friction.everywhere:
            note += ", so a delay or leg compliance may look like sliding"
    return (note,)


def _is_determined(case: LogUnderModel) -> bool:
    groups = ("q", "tau", "contact", "reference", "imu")
    return case.robot.legged is not None and not case.fixed and all(map(case.log.has, groups))


def _feet(case: LogUnderModel) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Speed and friction use of each loaded foot (N, L), NaN elsewhere.

    Returns the speed over the ground [m/s], and the ratio of tangential to normal force: the
    component against the motion, and the magnitude.
    """
    log, motion, robot, s = case.log, case.motion, case.robot.legged, case.settings
    assert robot is not None  # as `_is_determined`
    stands, dq = log.contact & motion.ok[:, None], joint_velocity(log)
    rows = max(1, round(s.force_window * log.rate))

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
    loaded = whole & (load > s.slide_load * robot.mass * GRAVITY)
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
        force: its maximum [N].
    """

    log: int
    begin: float
    end: float
    force: float

    def in_words(self) -> str:
        """A phrase such as 'outside forces of up to 21 N from 4.0 to 5.1 s of run 1'."""
        when = f"from {self.begin:.1f} to {self.end:.1f} s of run {self.log + 1}"
        return f"outside forces of up to {self.force:.2g} N {when}"


def outside_forces(
    cases: Sequence[LogUnderModel], left: np.ndarray, known: Evidence
) -> tuple[Push, ...]:
    """Find outside forces in the residual of logs.

    A log with such forces for much of its length has none: the cause is then the robot.

    Args:
        cases: the logs under the model.
        left: residual (M, W) with the effects found compensated; NaN where there is none.
        known: evidence whose columns and bins these are.
    """
    s = known.settings
    pushes: list[Push] = []
    if "base_wrench" not in known.layout:
        return ()
    columns, feet = known.layout.of("base_wrench")[:3], known.layout.by_leg("leg_velocity")
    for number, case in enumerate(cases):
        own = known.log == number
        force = np.linalg.norm(left[own][:, columns], axis=1)
        # In standing, the feet share the load differently; judge whichever of the two is more
        # common.
        stands = np.isfinite(known.table[own][:, feet]).all(axis=(1, 2))
        walks = ~stands if stands.mean() < 0.5 else stands
        there = np.flatnonzero(np.isfinite(force) & walks)
        if case.robot.legged is None or len(there) == 0:
            continue
        t, force = known.t[own][there] - case.log.t[0], force[there]
        middle = np.median(force)
        spread = 1.4826 * np.median(np.abs(force - middle))
        least = s.push_share * case.robot.legged.mass * GRAVITY
        rows = np.flatnonzero(force > max(middle + s.push_outlier * spread, least))
        apart = np.flatnonzero(np.diff(t[rows]) > s.push_gap) + 1
        found = [
            Push(number, float(t[one[0]]), float(t[one[-1]]), float(force[one].max()))
            for one in (np.split(rows, apart) if len(rows) else ())
            if t[one[-1]] - t[one[0]] >= s.shortest_push
        ]
        if sum(one.end - one.begin for one in found) < s.pushed_share * np.ptp(t):
            pushes += found
    return tuple(pushes)


def pushed_bins(
    cases: Sequence[LogUnderModel], known: Evidence, pushes: Sequence[Push]
) -> np.ndarray:
    """Mask (M,) of the bins in or near a push, whose influence on the motion takes a while to
    decay.
    """
    pushed = np.zeros(len(known.t), dtype=bool)
    for one in pushes:
        t = known.t - cases[one.log].log.t[0]
        near = (t > one.begin - known.settings.push_gap) & (t < one.end + known.settings.push_gap)
        pushed |= near & (known.log == one.log)
    return pushed
