"""Checks of leg kinematics against the body's motion: swapped legs and joints, signs, delays."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product

import numpy as np

from surefoot.sim.common.gravity import GRAVITY
from surefoot.sim.importing.advice import entries
from surefoot.sim.plausibility.attitude import LATE
from surefoot.sim.plausibility.axes import lag_of
from surefoot.sim.plausibility.finding import Finding, rule
from surefoot.sim.plausibility.stance import Stance
from surefoot.sim.plausibility.view import STEP, LogView
from surefoot.sim.robot.robot import Robot

MISFIT = 0.01
"""Mean squared velocity of standing feet, relative to the body's, without the worst tenth: 0.006 in
clean simulated walks, 0.03 to 0.1 on a measured Go1. Below it nothing is reported.
"""
MENDED = 0.6
"""Share of it that may remain with a corrected order of legs or contacts: on clean walks and the
measured Go1, each wrong one has at least 1.66 times as much as the right one.
"""
MENDED_JOINTS = 0.5
"""The same for signs and order of joints, with more alternatives: 2.2 times, but for hips of robots
that walk straight ahead, 1.2 times, see LEANS.
"""
FAIR, AS_GOOD = 0.1, 3.0
"""Largest misfit of a correct leg, and largest ratio of a corrected leg's misfit to that of the
worst correct one; without correct legs, any correction is accepted.
"""
CLEARER = 0.9
"""Improvement required over an alternative that exchanges fewer legs, which is tried first."""
OFFSETS = np.outer(np.arange(2, 9) / 10.0, [1.0, -1.0]).ravel()
"""Offsets of joints that are tried [rad]: an encoder's zero is set to some degrees."""
LEANS = 0.06
"""Sideways part of a leg's load by its torques from which the hip may have the opposite sign: 0.05
at most in clean walks of eleven robots, 0.08 to 0.7 with that sign.
"""
DUTY = 0.48
"""Mean duty factor: half and more in walks and trots."""
HOPELESS = 0.6
"""Misfit from which the legs do not measure the body's motion at all, and no alternative corrects
it.
"""
SIZE = (0.65, 1.5)
"""Ratio of the velocity by the legs to the body's: 0.76 to 1.05 for rolling and compliant legs."""
_TURNING = 0.5
"""Quantile of the gyro above which rows are used: legs differ where the body rotates."""
LATEST_LEGS = 1.0
"""Largest delay of the legs that is searched for [s]: two strides."""
LATE_PART, LATEST_PART = 0.03, 0.16
"""Smallest delay of contacts, or of one leg, that is reported [s]: 0.02 on a measured Go1, whose
feet spring back before they lift; and the largest searched for, before the next step begins.
"""
_MOVES = 0.1
"""Speed of the body below which nothing is compared [m/s]."""
_FEWEST = 50
"""Least number of samples of feet in contact."""
_TRIED = 600
"""Number of times at which alternatives of joints are tried."""
CLIMBS = 0.15
"""Climbing rate of a reference relative to the standing feet [m/s]: stairs at 0.5 m/s climb by 0.3,
rolling and compliant feet appear to by some hundredths.
"""
LATE_LOAD, LATEST_LOAD = 0.025, 0.15
"""Smallest delay of torques relative to contacts that is reported [s], and largest searched for:
0.002 in clean walks; foot sensors lag by ten times as much.
"""
LOADS = 0.7
"""Correlation of the loads with the contacts from which they are compared: 0.82 to 0.87."""
_LOADED = 20.0
"""Length of the section in which loads are compared [s], some tens of strides."""
SUPPORT = (0.5, 1.7)
"""Range of the weight carried by the torques of standing legs, relative to the model's: payloads
add a third, single legs of a stride carry twice.
"""


@dataclass(frozen=True)
class Moving:
    """Motion that legs are compared with.

    Attributes:
        gyro: (K, 3) [rad/s].
        truth: velocity of the body (K, 3) [m/s] in I by the reference; None where it is not
            trusted.
        used: mask (K,).
    """

    gyro: np.ndarray
    truth: np.ndarray | None
    used: np.ndarray

    def rows(self, some: np.ndarray) -> "Moving":
        """Select some of the K times."""
        truth = None if self.truth is None else self.truth[some]
        return Moving(self.gyro[some], truth, self.used[some])

    def where_turning(self) -> "Moving":
        """Use only the times at which the body turns most: there legs differ."""
        rate = np.linalg.norm(self.gyro, axis=1)
        return replace(self, used=self.used & (rate > np.quantile(rate, _TURNING)))

    def misfit(self, u: np.ndarray, contact: np.ndarray) -> float:
        """Mean squared error of the legs' velocity, relative to the body's, without the worst
        tenth.

        NaN where too few legs are in contact. Without a truth, the legs are compared with their
        mean.

        u: (K, L, 3) velocity of the body by each leg [m/s]; contact: (K, L), bool.
        """
        on = contact & self.used[:, None]
        truth = self.truth
        if truth is None:
            on = on & (on.sum(axis=1, keepdims=True) > 1)
            count = np.maximum(on.sum(axis=1, keepdims=True), 1)
            truth = np.sum(np.where(on[:, :, None], u, 0.0), axis=1) / count
        on = on & (np.linalg.norm(truth, axis=1) > _MOVES)[:, None]
        # Swinging feet also move together, so that without a truth some strides are needed.
        if on.sum() < _FEWEST * (1 if self.truth is not None else 2):
            return float("nan")
        missed = np.sort(np.sum((u - truth[:, None]) ** 2, axis=2)[on])[: int(0.9 * on.sum())]
        size = np.broadcast_to(np.sum(truth**2, axis=1)[:, None], on.shape)[on]
        return float(missed.mean() / size.mean())

    def misfits(self, u: np.ndarray, contact: np.ndarray) -> np.ndarray:
        """The misfit of each leg (L,)."""
        return np.array([self.misfit(u[:, [i]], contact[:, [i]]) for i in range(u.shape[1])])


@rule("legs", "t gyro contact", beside="q ref foot")
def kinematics(view: LogView) -> Iterator[Finding]:
    """Check that all legs in contact and the reference agree on the body's velocity.

    Compares: the velocity that the body has if feet in contact stand, leg by leg, with that of
        the reference (of each other without one): as they are, with legs exchanged, joints
        exchanged or of opposite sign, contacts inverted; all, one leg or contacts alone late.
    Threshold: a reading that leaves {MENDED:g} of the mean square (joints {MENDED_JOINTS:g});
        {CLEARER:g} for a sign with which torques, which else push to a side by {LEANS:g} of the
        leg's load, do so half as much; {HOPELESS:.0%} of the body's own; not {SIZE[0]:g} to
        {SIZE[1]:g} times as fast.
    Reason: standing feet stand: 0.6 % in simulated walks, 3 to 10 % on a measured Go1, where
        each wrong reading has 1.66 times as much at least; legs that roll and give are 0.76 to
        1.05 times as fast.
    Remedy: order or sign of the columns, joint_sign, the robot's name.
    """
    legs = view.stance
    if legs is None or len(view.log.legs) < 2:
        return
    whole = _motion(view, legs)
    moving = whole.where_turning()
    u = legs.body_velocity(moving.gyro)
    base = moving.misfit(u, legs.contact)
    found = _late(view, legs, whole) if base > MISFIT else []
    found = found or _put_right(view, legs, moving, base) or _late_parts(view, legs, whole)
    yield from found
    if found or moving.truth is None or not base > MISFIT:
        return
    size, alike = _size(u, legs.contact, moving)
    if alike > 0.6 and not SIZE[0] < size < SIZE[1]:
        seen = f"legs move the body {size:.2f} times as fast as the reference"
        cause = "another robot's log (its legs have another length), or units of positions"
        yield Finding(("q", "ref_p"), seen, cause)
    elif base > HOPELESS:
        seen = f"standing feet have {100 * base:.0f} % of the body's velocity, squared"
        cause = "wrong joints, contacts or robot; or it slides"
        yield Finding(("q", "contact"), seen, cause)


def _motion(view: LogView, legs: Stance) -> Moving:
    """The motion that legs are compared with."""
    gyro = view.gyro[legs.which]
    used = view.ok[legs.which] if view.log.has("reference") else np.ones(len(gyro), bool)
    return Moving(gyro, view.v_I[legs.which] if view.trusts_reference else None, used)


@rule("climbing", "t gyro contact ref", beside="q foot accel", when="trusts_reference")
def climbing(view: LogView) -> Iterator[Finding]:
    """Check that a reference climbs as its feet do.

    Compares: the reference's vertical velocity with that of standing feet.
    Threshold: {CLIMBS:g} m/s in the median.
    Reason: feet that stand do not sink.
    Remedy: another reference; level its world with [reference] q_GW.
    """
    legs = view.stance
    if legs is None:
        return
    up = view.R_GI.inv().apply([0.0, 0.0, 1.0])[legs.which]
    apart = view.v_I[legs.which][:, None] - legs.body_velocity(view.gyro[legs.which])
    climbs = np.einsum("kli,ki->kl", apart, up)
    on = legs.contact & view.ok[legs.which, None]
    if on.sum() < _FEWEST:
        return
    climb = float(np.median(climbs[on]))
    if abs(climb) > CLIMBS:
        seen = f"{'climbs' if climb > 0 else 'sinks'} by {abs(climb):.2f} m/s, and the feet do not"
        yield Finding(("ref_p_z",), seen, "an estimate that drifts, or a world that is not level")


def _late(view: LogView, legs: Stance, moving: Moving) -> list[Finding]:
    """Find a delay of joints and contacts together relative to gyro and reference."""

    def left(late: float) -> list[float]:
        then = _earlier(view, legs, moving, late)
        return [then.misfit(legs.body_velocity(then.gyro), legs.contact)]

    if moving.truth is None:
        return []
    (late,), (share,) = _lags(left, LATEST_LEGS)
    if abs(late) < view.least_lag(2.0 * LATE) or not share < MENDED:
        return []
    which = "after" if late > 0 else "before"
    seen = f"move {abs(late):.2f} s {which} the reference and the IMU"
    return [Finding(("q", "contact"), seen, "another clock, or lost rows")]


def _late_parts(view: LogView, legs: Stance, moving: Moving) -> list[Finding]:
    """Find a delay of contacts relative to joints, of all or of one, and of single legs relative to
    the others.
    """
    u, names, least = legs.body_velocity(moving.gyro), view.log.legs, view.least_lag(LATE_PART)

    def of_contacts(late: float) -> list[float]:
        rows = np.searchsorted(view.t, view.at[legs.which] + late)
        contact = view.log.contact[np.clip(rows, 0, len(view.t) - 1)]
        return [moving.misfit(u, contact), *moving.misfits(u, contact)]

    def of_legs(late: float) -> np.ndarray:
        then = _earlier(view, legs, moving, late)
        return then.misfits(legs.body_velocity(then.gyro), legs.contact)

    def better(share: float, late: float) -> str:
        when = f"{abs(late):.2f} s {'earlier' if late > 0 else 'later'}"
        return f"standing feet move {1.0 / share:.1f} times less (squared) {when}"

    if moving.truth is None:
        return []
    (late, *late_contact), (share, *by_contact) = _lags(of_contacts, LATEST_PART)
    if abs(late) > least and share < MENDED:
        columns = tuple(f"contact_{leg}" for leg in names)
        cause = "a filter, or another clock" if late > 0 else "early, or the joints are late"
        return [Finding(columns, better(share, late), cause)]
    found = []
    late_leg, by_leg = _lags(of_legs, LATEST_PART)
    for i, leg in enumerate(names):
        late, share = late_contact[i], by_contact[i]
        if share < min(by_leg[i], MENDED) and abs(late) > least:
            cause = f"{'late' if late > 0 else 'early'}, unlike the other contacts"
            found.append(Finding((f"contact_{leg}",), better(share, late), cause))
        elif abs(late := late_leg[i]) > least and by_leg[i] < MENDED:
            seen = f"{leg} moves {abs(late):.2f} s {'after' if late > 0 else 'before'} the body"
            found.append(Finding((f"q_{leg}", f"contact_{leg}"), seen, "a clock of its own"))
    return found if 2 * len(found) <= len(names) else []


def _earlier(view: LogView, legs: Stance, moving: Moving, late: float) -> Moving:
    """The motion to compare with legs that are late by some seconds."""
    then = np.clip(legs.which - round(late / STEP), 0, len(view.at) - 1)
    return Moving(view.gyro[then], view.v_I[then], moving.used & view.ok[then])


def _lags(
    left: Callable[[float], Sequence[float] | np.ndarray], latest: float
) -> tuple[np.ndarray, np.ndarray]:
    """The delays (D,) [s], up to `latest`, with the smallest misfits, and their ratios to those at
    0; 0 and 1 where there is no minimum.

    `left` gives D misfits for a delay.
    """
    tried = STEP * np.arange(-round(latest / STEP), round(latest / STEP) + 1)
    misfits = np.array([left(float(late)) for late in tried])
    base = misfits[len(tried) // 2]
    misfits = np.where(np.isfinite(misfits), misfits, np.inf)
    best = misfits.argmin(axis=0)
    found = (best > 0) & (best < len(tried) - 1) & (base > 0.0)
    share = misfits.min(axis=0) / np.where(found, base, 1.0)
    return np.where(found, tried[best], 0.0), np.where(found, share, 1.0)


def _put_right(view: LogView, legs: Stance, moving: Moving, base: float) -> list[Finding]:
    """Find the correction with the smallest misfit: other legs, or other signs and orders of
    joints.
    """
    gain, found = _swapped(view, legs, moving, base) if base > MISFIT else (1.0, [])
    more, misread = _misread(view, legs, moving)
    return misread if more > gain else found


def _chains(view: LogView) -> np.ndarray | None:
    """Joints (L, C) of each leg; None where feet are not known by them, or legs differ."""
    chains = () if view.robot is None or view.log.has("foot") else view.robot.limbs.chains
    return np.array(chains) if len({len(chain) for chain in chains}) == 1 else None


def _swapped(
    view: LogView, legs: Stance, moving: Moving, base: float
) -> tuple[float, list[Finding]]:
    """Find swapped legs, by joints, contacts or both, or inverted contacts.

    Also returns the reduction of the squared misfit when corrected.
    """
    names = view.log.legs
    own = list(range(len(names)))
    chains = _chains(view)
    u = _by_each_leg(view, legs, moving.gyro, chains)
    best: tuple[float, list[int], str] = (base, own, "")
    for order in sorted(permutations(own), key=lambda one: sum(i != j for i, j in enumerate(one))):
        pick = list(order)
        ways = [("contact_", u[:, own, own], legs.contact[:, pick])]
        if chains is not None:
            ways += [
                ("q_", u[:, own, pick], legs.contact),
                ("", u[:, own, pick], legs.contact[:, pick]),
            ]
        for what, moved, contact in ways if pick != own else ():
            left = moving.misfit(moved, contact)
            if left < CLEARER * best[0]:
                best = (left, pick, what)
    left, order, what = best
    if moving.truth is not None:
        # In a trot, the other diagonal stands while this one is lifted, so both may fit.
        inverted = moving.misfit(u[:, own, own], ~legs.contact)
        likelier = 3.0 if legs.contact.mean() < DUTY else 1.0 / 3.0
        if inverted < min(MENDED * base, likelier * left):
            columns = tuple(f"contact_{leg}" for leg in names)
            return _mended(base / inverted, columns, "inverted: 1 means lifted")
    if left > MENDED * base:
        return 1.0, []
    wrong = [(names[i], names[j]) for i, j in enumerate(order) if i != j]
    columns = tuple(f"{p}{i}" for p in ((what,) if what else ("q_", "contact_")) for i, _ in wrong)
    pairs = ", ".join(f"{i} is {j}" for i, j in wrong)
    parts = {"q_": "joints", "contact_": "contacts", "": "joints and contacts"}[what]
    return _mended(base / left, columns, f"swapped legs ({parts}): {pairs}")


def _mended(gain: float, columns: tuple[str, ...], cause: str) -> tuple[float, list[Finding]]:
    seen = f"standing feet move {gain:.1f} times less (squared) when put right"
    return gain, [Finding(columns, seen, cause)]


def _by_each_leg(
    view: LogView, legs: Stance, gyro: np.ndarray, chains: np.ndarray | None
) -> np.ndarray:
    """Velocity (K, L, L, 3) of the body by leg i if it had the joints of leg j."""
    k = np.arange(len(view.log.legs))
    out = np.empty((len(gyro), len(k), len(k), 3))
    out[:, k, k] = legs.body_velocity(gyro)
    if chains is None or view.robot is None:
        return out
    for shift in k[1:]:
        order = (k + shift) % len(k)
        columns = np.arange(view.log.q.shape[1])
        columns[chains] = chains[order]
        moved = legs.with_joints(view.robot, view.log.q, columns)
        out[:, k, order] = moved.body_velocity(gyro)
    return out


def _misread(view: LogView, legs: Stance, moving: Moving) -> tuple[float, list[Finding]]:
    """Find joints that are swapped within a leg, or have the opposite sign.

    Also returns the reduction of the squared misfit when corrected.
    """
    robot, chains = view.robot, _chains(view)
    if robot is None or chains is None or moving.truth is None or chains.shape[1] > 3:
        return 1.0, []
    (few, moving), q = _few(legs, moving), view.log.q
    size = chains.shape[1]
    base = moving.misfits(few.body_velocity(moving.gyro), few.contact)
    # Legs that fit have their joints in order, but a hip about 0 rad may have another sign.
    orders = [*permutations(range(size))] if (base > MISFIT).any() else [tuple(range(size))]
    ways = [*product(orders, product((1.0, -1.0), repeat=size))]
    misfits, leans = np.empty((2, len(ways), len(chains)))
    for way, (order, signs) in enumerate(ways):
        columns, sign = np.arange(q.shape[1]), np.ones(q.shape[1])
        columns[chains], sign[chains] = chains[:, order], signs
        other = few.with_joints(robot, q, columns, sign)
        misfits[way] = moving.misfits(other.body_velocity(moving.gyro), few.contact)
        leans[way] = _leaning(view, robot, few, columns, sign)
    best, left = misfits.argmin(axis=0), misfits.min(axis=0)
    good = base[base < FAIR]
    as_good = AS_GOOD * max(float(good.max()), MISFIT) if good.size else np.inf
    upright = (leans[0] > LEANS) & (leans[best, np.arange(len(best))] < 0.5 * leans[0])
    most = np.where(upright, CLEARER, MENDED_JOINTS) * base
    mends = (best > 0) & (left < np.minimum(most, as_good))
    findings = []
    for way in dict.fromkeys(best[mends].tolist()):
        which = mends & (best == way)
        joints = np.array(view.log.joints)[chains[which]]
        gain = float(np.median(base[which] / left[which]))
        findings.append(_misread_finding(joints, *ways[int(way)], gain))
    mended = np.nansum(np.where(mends, left, base))
    return float(np.nansum(base) / max(mended, 1e-12)), findings


def _leaning(
    view: LogView, robot: Robot, legs: Stance, columns: np.ndarray, sign: np.ndarray
) -> np.ndarray:
    """Sideways part (L,) of the load that torques mean on each leg, relative to the upward one,
    where up is the specific force; 0 where it is not known.

    Args:
        view: of the log.
        robot: its robot.
        legs: their times.
        columns: that joints are read from (J,).
        sign: (J,) of the angles and torques read.
    """
    log, rows, on = view.log, legs.rows[1], legs.contact
    if not log.has("tau"):
        return np.zeros(on.shape[1])
    pushed = _pushes(robot, log.q[rows][:, columns] * sign, log.tau[rows][:, columns] * sign)
    up = view.accel[legs.which]
    up = up / np.maximum(np.linalg.norm(up, axis=1, keepdims=True), 1e-9)
    upward = np.einsum("kli,ki->kl", pushed, up)
    aside = pushed @ robot.R_BI[1] - upward * (up @ robot.R_BI[1])[:, None]
    in_all = [np.abs(np.sum(x * on, axis=0)) for x in (aside, upward)]
    return in_all[0] / np.maximum(in_all[1], 1e-9)


def _misread_finding(
    joints: np.ndarray, order: tuple[int, ...], signs: tuple[float, ...], gain: float
) -> Finding:
    """The finding for misread joints, in words.

    Args:
        joints: names (L, C) of the legs concerned.
        order: of a leg's joints, as it should be.
        signs: of its joints, after that.
        gain: factor by which the misfit falls when corrected.
    """
    swapped = [k for k, other in enumerate(order) if k != other]
    flipped = [k for k, sign in enumerate(signs) if sign < 0]
    columns = tuple(f"q_{name}" for name in joints[:, sorted({*swapped, *flipped})].flat)
    pairs = ", ".join(f"{joints[0, k]} is {joints[0, order[k]]}" for k in swapped)
    causes = [f"swapped joints ({pairs})"] * bool(swapped) + ["wrong sign"] * bool(flipped)
    changes = {"robot": {"joint_sign": dict.fromkeys(joints[:, flipped].flat, -1.0)}}
    seen = f"standing feet move {gain:.3g} times less (squared) when put right"
    return Finding(columns, seen, " and ".join(causes), changes if flipped else {})


def opposite_angles(view: LogView) -> set[str]:
    """Columns of angles that put standing feet right with the opposite sign."""
    legs = view.stance
    found = [] if legs is None else _misread(view, legs, _motion(view, legs).where_turning())[1]
    return {column for one in found if one.cause == "wrong sign" for column in one.streams}


def _few(legs: Stance, moving: Moving) -> tuple[Stance, Moving]:
    """Feet and motion at some of the times, at which alternatives are tried."""
    used = np.flatnonzero(moving.used)
    some = used[np.unique(np.linspace(0, len(used) - 1, _TRIED).astype(int))]
    return legs.at(some), moving.rows(some)


@rule("zeros of most legs", "t gyro q contact ref", beside="foot", when="trusts_reference")
def zeros_of_most(view: LogView) -> Iterator[Finding]:
    """Check that the angles of most legs count from where the model's do.

    `joints.zeros` finds that of a single joint.

    Compares: the velocity that the body has if feet in contact stand with that of the
        reference, as angles are and moved.
    Threshold: {OFFSETS[0]:g} rad or more, of the same joint of most legs, that leave
        {MENDED:g} of the mean square.
    Reason: zeros are set to some degrees.
    Remedy: joint_offset.
    """
    legs, robot, log, chains = view.stance, view.robot, view.log, _chains(view)
    if legs is None or robot is None or chains is None:
        return
    few, moving = _few(legs, _motion(view, legs).where_turning())
    base = moving.misfits(few.body_velocity(moving.gyro), few.contact)
    if not np.median(base) > MISFIT:
        return
    misfits = np.empty((chains.shape[1], len(OFFSETS), len(chains)))
    for k, n in np.ndindex(misfits.shape[:2]):
        offset = np.zeros(log.q.shape[1])
        offset[chains[:, k]] = OFFSETS[n]
        other = few.with_joints(robot, log.q, offset=offset)
        misfits[k, n] = moving.misfits(other.body_velocity(moving.gyro), few.contact)
    if not np.isfinite(misfits).all():
        return
    left = misfits.min(axis=1) / base  # by joint of a leg, and leg
    mended = (left < MENDED) & (base > MISFIT)
    kinds = [k for k in np.argsort(np.median(left, axis=1)) if 2 * mended[k].sum() > len(chains)]
    columns, seen = [], []
    for k in kinds:
        which = np.flatnonzero(mended[k])
        columns += [f"q_{log.joints[chains[i, k]]}" for i in which]
        added = sorted({float(OFFSETS[misfits[k, :, i].argmin()]) for i in which})
        gain = 1.0 / float(np.median(left[k, which]))
        seen.append(f"{gain:.1f} times with {' or '.join(f'{x:+g}' for x in added)} rad added")
    if columns:
        seen = f"standing feet move less (squared): {', else '.join(seen)}"
        cause = "other zeros than the model's: measure them for joint_offset in [robot] of the map"
        yield Finding(tuple(columns), seen, cause)


def _size(u: np.ndarray, contact: np.ndarray, moving: Moving) -> tuple[float, float]:
    """Slope of the legs' horizontal velocity over the body's, and their correlation."""
    truth = moving.truth
    assert truth is not None
    on = contact & (moving.used & (np.linalg.norm(truth, axis=1) > _MOVES))[:, None]
    if on.sum() < _FEWEST:
        return 1.0, 0.0
    a = u[on][:, :2]
    b = np.broadcast_to(truth[:, None], u.shape)[on][:, :2]
    size = np.sum(a**2, axis=1)
    keep = size < np.quantile(size, 0.9)
    a, b = a[keep], b[keep]
    both = float(np.sum(a * b))
    return both / float(np.sum(b**2)), both / float(np.sqrt(np.sum(a**2) * np.sum(b**2)))


@rule("support", "q contact tau accel", beside="foot", finds="symptom")
def weight_carried(view: LogView) -> Iterator[Finding]:
    """Check that torques of standing legs carry the robot's weight.

    Compares: the weight that torques of legs in contact carry with the robot's.
    Threshold: {SUPPORT[0]:g} to {SUPPORT[1]:g} times.
    Reason: on average a robot carries itself; payloads add a third.
    Remedy: sign, unit or order of tau; torques of the output, not of the motor; the robot's
        name.
    """
    legs, robot, log = view.stance, view.robot, view.log
    if legs is None or robot is None:
        return
    rows = legs.rows[1][:: max(1, len(legs.which) // _TRIED)]
    loads = _pushes(robot, log.q[rows], log.tau[rows]) @ robot.R_BI[2]
    contact = log.contact[rows]
    share = float(np.median(np.sum(loads * contact, axis=1)[contact.any(axis=1)]))
    share /= robot.mass * GRAVITY
    seen = f"legs in contact carry {share:.2f} times the weight of {robot.name}"
    columns = tuple(f"tau_{joint}" for joint in log.joints)
    if SUPPORT[0] < share < SUPPORT[1] or contact.mean() < 0.2 or not loads.any():
        return
    cause, changes = "swapped joints, another unit, a motor's side of a gear, or another robot", {}
    if -SUPPORT[1] < share < -SUPPORT[0]:
        cause, changes = "wrong sign", entries(columns, sign=-1.0)
    yield Finding(columns, seen, cause, changes)


@rule("late torques", "t q contact tau accel", beside="foot")
def late_torques(view: LogView) -> Iterator[Finding]:
    """Check that torques load the legs while they stand.

    Compares: the forces that torques mean with contacts, over time.
    Threshold: {LATE_LOAD:g} s late or early.
    Reason: a leg is loaded while it stands: 2 ms in clean walks.
    Remedy: the filter or clock of tau, or of the contacts.
    """
    if view.stance is None or view.robot is None:
        return
    at = view.at[np.abs(view.at - 0.5 * (view.t[0] + view.t[-1])) < 0.5 * _LOADED]
    rows = np.clip(np.searchsorted(view.t, at), 0, len(view.t) - 1)
    if len(rows) < _FEWEST:
        return
    loads = _pushes(view.robot, view.log.q[rows], view.log.tau[rows]) @ view.robot.R_BI[2]
    contact = view.log.contact[rows]
    walks = (contact.std(axis=0) > 0.2) & (loads.std(axis=0) > 0.0)
    if not walks.any():
        return
    late, alike = lag_of(loads[:, walks], contact[:, walks].astype(float), STEP, LATEST_LOAD)
    if alike > LOADS and abs(late) > view.least_lag(LATE_LOAD):
        seen = f"load legs {abs(late):.3f} s {'after' if late > 0 else 'before'} they stand"
        columns = tuple(f"tau_{joint}" for joint in view.log.joints)
        yield Finding(columns, seen, "a filter, or another clock (or that of the contacts)")


def _pushes(robot: Robot, q: np.ndarray, tau: np.ndarray) -> np.ndarray:
    """Force (K, L, 3) [N] in I on each leg that balances torques (K, J) quasi-statically, at
    angles (K, J); 0 where a leg is stretched, or legs have not three joints.
    """
    chains = robot.limbs.chains
    if {*map(len, chains)} != {3}:
        return np.zeros((len(q), len(chains), 3))
    J = robot.feet_jacobian_I(q)
    usable = (np.abs(np.linalg.det(J)) > 1e-4)[..., None]
    J_T = np.where(usable[..., None], np.swapaxes(J, 2, 3), np.eye(3))
    return -np.linalg.solve(J_T, tau[:, np.array(chains)][..., None])[..., 0] * usable
