"""Checks of leg kinematics against the body's motion: swapped legs and joints, signs, delays."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import permutations, product

import numpy as np

from surefoot.sim.common.gravity import GRAVITY
from surefoot.sim.plausibility.attitude import LATE
from surefoot.sim.plausibility.axes import lag_of
from surefoot.sim.plausibility.finding import Finding
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
"""The same for signs and order of joints, with more alternatives: 2.2 times."""
FAIR, AS_GOOD = 0.1, 3.0
"""Largest misfit of a correct leg, and largest ratio of a corrected leg's misfit to that of the
worst correct one; without correct legs, any correction is accepted.
"""
CLEARER = 0.9
"""Improvement required over an alternative that exchanges fewer legs, which is tried first."""
OFFSETS = np.array([-0.8, -0.7, -0.6, -0.5, -0.4, -0.3, -0.2, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8])
"""Offsets of joints that are tried [rad]: an encoder's zero is set to some degrees."""
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
_LOADED, _MOST_LOADED = 20.0, 10_000
"""Length of the section in which loads are compared [s], some tens of strides, and its largest
number of rows.
"""
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

    def misfits(self, legs: Stance) -> np.ndarray:
        """The misfit of each leg (L,), at the same times."""
        u, each = legs.body_velocity(self.gyro), range(legs.contact.shape[1])
        return np.array([self.misfit(u[:, [i]], legs.contact[:, [i]]) for i in each])


def kinematics(view: LogView) -> Iterator[Finding]:
    """Check that all legs in contact and the reference agree on the body's velocity."""
    legs = view.stance
    if legs is None or not view.log.has("imu") or len(view.log.legs) < 2:
        return
    moving = _turning(view, legs)
    gyro, truth = moving.gyro, moving.truth
    used = view.ok[legs.which] if view.log.has("reference") else np.ones(len(gyro), bool)
    u = legs.body_velocity(gyro)
    base = moving.misfit(u, legs.contact)
    found: list[Finding] = []
    if base > MISFIT:
        late = None if truth is None else _late(view, legs, Moving(gyro, truth, used))
        found = [late] if late else _put_right(view, legs, moving, base)
    if not found and truth is not None:
        found = _late_parts(view, legs, Moving(gyro, truth, used))
    yield from found
    if found or truth is None or not base > MISFIT:
        return
    size, alike = _size(u, legs.contact, moving)
    if alike > 0.6 and not SIZE[0] < size < SIZE[1]:
        told = f"legs move the body {size:.2f} times as fast as the reference"
        cause = "another robot's log (its legs have another length), or units of positions"
        yield Finding(("q", "ref_p"), told, cause)
    elif base > HOPELESS:
        told = f"standing feet have {100 * base:.0f} % of the body's velocity, squared"
        cause = "wrong joints, contacts or robot; or it slides"
        yield Finding(("q", "contact"), told, cause)


def _turning(view: LogView, legs: Stance) -> Moving:
    """The motion that legs are compared with, used where the body turns most."""
    gyro = view.gyro[legs.which]
    used = view.ok[legs.which] if view.log.has("reference") else np.ones(len(gyro), bool)
    truth = view.v_I[legs.which] if view.trusts_reference else None
    rate = np.linalg.norm(gyro, axis=1)
    return Moving(gyro, truth, used & (rate > np.quantile(rate, _TURNING)))


def climbing(view: LogView) -> Iterator[Finding]:
    """Check that a reference climbs as its feet do."""
    legs = view.stance
    if legs is None or not view.log.has("imu") or not view.trusts_reference:
        return
    used = view.ok[legs.which]
    up = view.R_GI.inv().apply([0.0, 0.0, 1.0])[legs.which]
    by_feet = np.einsum("kli,ki->kl", legs.body_velocity(view.gyro[legs.which]), up)
    by_reference = np.einsum("ki,ki->k", view.v_I[legs.which], up)
    on = legs.contact & used[:, None]
    if on.sum() < _FEWEST:
        return
    apart = float(np.median((by_reference[:, None] - by_feet)[on]))
    if abs(apart) > CLIMBS:
        told = f"{'climbs' if apart > 0 else 'sinks'} by {abs(apart):.2f} m/s, and the feet do not"
        yield Finding(("ref_p_z",), told, "an estimate that drifts, or a world that is not level")


def _late(view: LogView, legs: Stance, moving: Moving) -> Finding | None:
    """Find a delay of joints and contacts together relative to gyro and reference."""

    def left(late: float) -> float:
        then = _earlier(view, legs, moving, late)
        return then.misfit(legs.body_velocity(then.gyro), legs.contact)

    late, share = _lag(left, LATEST_LEGS)
    if abs(late) < view.least_lag(2.0 * LATE) or not share < MENDED:
        return None
    which = "after" if late > 0 else "before"
    told = f"move {abs(late):.2f} s {which} the reference and the IMU"
    return Finding(("q", "contact"), told, "another clock, or lost rows")


def _late_parts(view: LogView, legs: Stance, moving: Moving) -> list[Finding]:
    """Find a delay of contacts relative to joints, of all or of one, and of single legs relative to
    the others.
    """
    u, names = legs.body_velocity(moving.gyro), view.log.legs
    every = list(range(len(names)))

    def of_contacts(which: list[int]) -> tuple[float, float]:
        def left(late: float) -> float:
            rows = np.searchsorted(view.t, view.at[legs.which] + late)
            contact = view.log.contact[np.clip(rows, 0, len(view.t) - 1)]
            return moving.misfit(u[:, which], contact[:, which])

        return _lag(left, LATEST_PART)

    def of_leg(i: int) -> tuple[float, float]:
        def left(late: float) -> float:
            then = _earlier(view, legs, moving, late)
            return then.misfit(legs.body_velocity(then.gyro)[:, [i]], legs.contact[:, [i]])

        return _lag(left, LATEST_PART)

    late, share = of_contacts(every)
    least = view.least_lag(LATE_PART)
    if abs(late) > least and share < MENDED:
        columns = tuple(f"contact_{leg}" for leg in names)
        told = f"standing feet move {1.0 / share:.1f} times less (squared) {abs(late):.2f} s "
        told += "earlier" if late > 0 else "later"
        cause = "a filter, or another clock" if late > 0 else "early, or the joints are late"
        return [Finding(columns, told, cause)]
    found = []
    for i, leg in enumerate(names):
        late, share = of_leg(i)
        of_contact, by_contact = of_contacts([i])
        if by_contact < share and abs(of_contact) > least and by_contact < MENDED:
            which = "earlier" if of_contact > 0 else "later"
            told = f"the foot moves {1.0 / by_contact:.1f} times less (squared) "
            told += f"{abs(of_contact):.2f} s {which}"
            cause = f"{'late' if of_contact > 0 else 'early'}, unlike the other contacts"
            found.append(Finding((f"contact_{leg}",), told, cause))
        elif abs(late) > view.least_lag(LATE_PART) and share < MENDED:
            told = f"{leg} moves {abs(late):.2f} s {'after' if late > 0 else 'before'} the body"
            found.append(Finding((f"q_{leg}", f"contact_{leg}"), told, "a clock of its own"))
    return found if 2 * len(found) <= len(names) else []


def _earlier(view: LogView, legs: Stance, moving: Moving, late: float) -> Moving:
    """The motion to compare with legs that are late by some seconds."""
    assert moving.truth is not None
    then = np.clip(legs.which - round(late / STEP), 0, len(view.at) - 1)
    return Moving(view.gyro[then], view.v_I[then], moving.used & view.ok[then])


def _lag(left: Callable[[float], float], latest: float) -> tuple[float, float]:
    """The delay [s], up to `latest`, with the smallest misfit, and its ratio to that at 0."""
    tried = STEP * np.arange(-round(latest / STEP), round(latest / STEP) + 1)
    misfits = np.array([left(float(late)) for late in tried])
    base = misfits[len(tried) // 2]
    if not np.isfinite(misfits).any() or not base > 0.0:
        return 0.0, 1.0
    best = int(np.nanargmin(misfits))
    if best in (0, len(tried) - 1):
        return 0.0, 1.0  # no minimum
    return float(tried[best]), float(misfits[best] / base)


def _put_right(view: LogView, legs: Stance, moving: Moving, base: float) -> list[Finding]:
    """Find the correction with the smallest misfit: other legs, or other signs and orders of
    joints.
    """
    gain, found = _swapped(view, legs, moving, base)
    if view.robot is not None and moving.truth is not None and not view.log.has("foot"):
        more, misread = _misread(view, view.robot, legs, moving)
        if more > gain:
            return misread
    return found


def _swapped(
    view: LogView, legs: Stance, moving: Moving, base: float
) -> tuple[float, list[Finding]]:
    """Find swapped legs, by joints, contacts or both, or inverted contacts.

    Also returns the reduction of the squared misfit when corrected.
    """
    names = view.log.legs
    own = list(range(len(names)))
    u = _by_each_leg(view, legs, moving.gyro)
    best: tuple[float, list[int], str] = (base, own, "")
    for order in sorted(permutations(own), key=lambda one: sum(i != j for i, j in enumerate(one))):
        pick = list(order)
        ways = [("contact_", u[:, own, own], legs.contact[:, pick])]
        if not view.log.has("foot"):
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
        if inverted < MENDED * base and inverted < likelier * left:
            told = f"standing feet move {base / inverted:.1f} times less (squared) when put right"
            columns = tuple(f"contact_{leg}" for leg in names)
            finding = Finding(columns, told, "inverted: 1 means lifted")
            return base / inverted, [finding]
    if left > MENDED * base:
        return 1.0, []
    told = f"standing feet move {base / left:.1f} times less (squared) when put right"
    wrong = [(names[i], names[j]) for i, j in enumerate(order) if i != j]
    columns = tuple(f"{p}{i}" for p in ((what,) if what else ("q_", "contact_")) for i, _ in wrong)
    pairs = ", ".join(f"{i} is {j}" for i, j in wrong)
    parts = {"q_": "joints", "contact_": "contacts", "": "joints and contacts"}[what]
    return base / left, [Finding(columns, told, f"swapped legs ({parts}): {pairs}")]


def _by_each_leg(view: LogView, legs: Stance, gyro: np.ndarray) -> np.ndarray:
    """Velocity (K, L, L, 3) of the body by leg i if it had the joints of leg j."""
    count = len(view.log.legs)
    k = np.arange(count)
    out = np.empty((len(gyro), count, count, 3))
    out[:, k, k] = legs.body_velocity(gyro)
    robot = view.robot
    if view.log.has("foot") or robot is None:
        return out
    q, chains = view.log.q, robot.limbs.chains
    for shift in range(1, count):
        order = (k + shift) % count
        if any(len(chains[i]) != len(chains[j]) for i, j in zip(k, order, strict=True)):
            out[:, k, order] = np.inf
            continue
        columns = np.arange(q.shape[1])
        for i, j in zip(k, order, strict=True):
            columns[list(chains[i])] = chains[j]
        moved = legs.with_joints(robot, q, columns, np.ones(q.shape[1]))
        out[:, k, order] = moved.body_velocity(gyro)
    return out


def _misread(
    view: LogView, robot: Robot, legs: Stance, moving: Moving
) -> tuple[float, list[Finding]]:
    """Find joints that are swapped within a leg, or have the opposite sign.

    Also returns the reduction of the squared misfit when corrected.
    """
    chains = robot.limbs.chains
    size = len(chains[0])
    if any(len(chain) != size for chain in chains) or size > 3:
        return 1.0, []
    (few, moving), q = _few(legs, moving), view.log.q
    base = moving.misfits(few)
    bad = np.flatnonzero(base > MISFIT)
    best: list[tuple[float, tuple[int, ...], tuple[float, ...]]] = [
        (float(x), (), ()) for x in base
    ]
    for order in permutations(range(size)) if bad.size else ():
        for signs in product((1.0, -1.0), repeat=size):
            columns, sign = np.arange(q.shape[1]), np.ones(q.shape[1])
            for chain in chains:
                columns[list(chain)] = [chain[k] for k in order]
                sign[list(chain)] = signs
            left = moving.misfits(few.with_joints(robot, q, columns, sign))
            for i in bad:
                if left[i] < best[i][0]:
                    best[i] = (float(left[i]), order, signs)
    good = base[base < FAIR]
    as_good = AS_GOOD * max(float(good.max()), MISFIT) if good.size else np.inf
    found: dict[tuple[tuple[int, ...], tuple[float, ...]], list[int]] = {}
    for i in bad:
        left, order, signs = best[i]
        if order and left < min(MENDED_JOINTS * base[i], as_good):
            found.setdefault((order, signs), []).append(int(i))
    mended = base.copy()
    for which in found.values():
        mended[which] = [best[i][0] for i in which]
    findings = []
    for (order, signs), which in found.items():
        gain = float(np.median([base[i] / best[i][0] for i in which]))
        findings.append(_misread_finding(view.log.joints, chains, which, order, signs, gain))
    return float(np.nansum(base) / max(np.nansum(mended), 1e-12)), findings


def _few(legs: Stance, moving: Moving) -> tuple[Stance, Moving]:
    """Feet and motion at some of the times, at which alternatives are tried."""
    used = np.flatnonzero(moving.used)
    some = used[np.unique(np.linspace(0, len(used) - 1, _TRIED).astype(int))]
    return legs.at(some), moving.rows(some)


def zeros_of_most(view: LogView) -> Iterator[Finding]:
    """Check that the angles of most legs count from where the model's do.

    `joints.zeros` finds that of a single joint.
    """
    legs, robot, log = view.stance, view.robot, view.log
    if legs is None or robot is None or log.has("foot") or not view.trusts_reference:
        return
    chains = robot.limbs.chains
    size = len(chains[0])
    few, moving = _few(legs, _turning(view, legs))
    base = moving.misfits(few)
    if any(len(chain) != size for chain in chains) or not np.median(base) > MISFIT:
        return
    misfits = np.empty((size, len(OFFSETS), len(chains)))
    for k, n in np.ndindex(misfits.shape[:2]):
        offset = np.zeros(log.q.shape[1])
        offset[[chain[k] for chain in chains]] = OFFSETS[n]
        misfits[k, n] = moving.misfits(few.with_joints(robot, log.q, offset=offset))
    if not np.isfinite(misfits).all():
        return
    left = misfits.min(axis=1) / base  # by joint of a leg, and leg
    mended = (left < MENDED) & (base > MISFIT)
    kinds = [k for k in np.argsort(np.median(left, axis=1)) if 2 * mended[k].sum() > len(chains)]
    columns, told = [], []
    for k in kinds:
        which = np.flatnonzero(mended[k])
        columns += [f"q_{log.joints[chains[i][k]]}" for i in which]
        added = sorted({float(OFFSETS[misfits[k, :, i].argmin()]) for i in which})
        gain = 1.0 / float(np.median(left[k, which]))
        told.append(f"{gain:.1f} times with {' or '.join(f'{x:+g}' for x in added)} rad added")
    if columns:
        told = f"standing feet move less (squared): {', else '.join(told)}"
        line = "[robot.joint_offset] of one joint of each leg"
        yield Finding(tuple(columns), told, "other zeros than the model's", line)


def _misread_finding(
    joints: Sequence[str],
    chains: Sequence[Sequence[int]],
    which: Sequence[int],
    order: tuple[int, ...],
    signs: tuple[float, ...],
    gain: float,
) -> Finding:
    """The finding for misread joints, in words.

    Args:
        joints: names.
        chains: joints of each leg.
        which: legs concerned.
        order: of a leg's joints, as it should be.
        signs: of its joints, after that.
        gain: factor by which the misfit falls when corrected.
    """
    swapped = [k for k, other in enumerate(order) if k != other]
    flipped = [k for k, sign in enumerate(signs) if sign < 0]
    columns = tuple(
        f"q_{joints[chains[i][k]]}" for i in which for k in sorted({*swapped, *flipped})
    )
    told = f"standing feet move {gain:.0f} times less (squared) when put right"
    one = chains[which[0]]
    causes = []
    if swapped:
        pairs = ", ".join(f"{joints[one[k]]} is {joints[one[order[k]]]}" for k in swapped)
        causes.append(f"swapped joints ({pairs})")
    line = ""
    if flipped:
        causes.append("wrong sign")
        line = "; ".join(
            f"[robot.joint_sign] {joints[chains[i][k]]} = -1" for i in which for k in flipped
        )
    return Finding(columns, told, " and ".join(causes), line)


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


def weight_carried(view: LogView) -> Iterator[Finding]:
    """Check that torques of standing legs carry the robot's weight."""
    legs, robot, log = view.stance, view.robot, view.log
    if legs is None or robot is None:
        return
    rows = legs.rows[1][:: max(1, len(legs.which) // _TRIED)]
    loads, contact = _loads(view, robot, rows), log.contact[rows]
    if loads is None:
        return
    share = float(np.median(np.sum(loads * contact, axis=1)[contact.any(axis=1)]))
    share /= robot.mass * GRAVITY
    told = f"legs in contact carry {share:.2f} times the weight of {robot.name}"
    columns = tuple(f"tau_{joint}" for joint in log.joints)
    if SUPPORT[0] < share < SUPPORT[1] or contact.mean() < 0.2:
        return
    if -SUPPORT[1] < share < -SUPPORT[0]:
        line = f"{columns[0]}, ... = {{ ..., sign = -1 }}"
        yield Finding(columns, told, "wrong sign", line)
    elif share > 100.0:
        line = f'{columns[0]}, ... = {{ ..., unit = "mN m" }}'
        yield Finding(columns, told, "in mN m, not N m", line)
    else:
        cause = "swapped joints, another unit, a motor's side of the gear, or another robot"
        yield Finding(columns, told, cause)


def late_torques(view: LogView) -> Iterator[Finding]:
    """Check that torques load the legs while they stand."""
    if view.stance is None or view.robot is None:
        return
    t = view.t
    period = max(float(np.median(np.diff(t))), _LOADED / _MOST_LOADED)
    middle = 0.5 * (t[0] + t[-1])
    times = np.arange(max(t[0], middle - 0.5 * _LOADED), min(t[-1], middle + 0.5 * _LOADED), period)
    rows = np.clip(np.searchsorted(t, times), 0, len(t) - 1)
    loads = _loads(view, view.robot, rows)
    if loads is None or len(rows) < _FEWEST:
        return
    contact = view.log.contact[rows]
    walks = (contact.std(axis=0) > 0.2) & (loads.std(axis=0) > 0.0)
    if not walks.any():
        return
    late, alike = lag_of(loads[:, walks], contact[:, walks].astype(float), period, LATEST_LOAD)
    if alike > LOADS and abs(late) > view.least_lag(LATE_LOAD):
        told = f"load legs {abs(late):.3f} s {'after' if late > 0 else 'before'} they stand"
        columns = tuple(f"tau_{joint}" for joint in view.log.joints)
        yield Finding(columns, told, "a filter, or another clock (or that of the contacts)")


def _loads(view: LogView, robot: Robot, rows: np.ndarray) -> np.ndarray | None:
    """Upward force (K, L) [N] on each leg that balances its torques quasi-statically, at rows (K,).

    0 where a leg is stretched, None where the torques are unknown.
    """
    log, up = view.log, view.up_by_body
    if up is None or not (log.has("tau") and log.has("imu") and log.has("q")):
        return None
    if any(len(c) != 3 for c in robot.limbs.chains):
        return None
    J = robot.feet_jacobian_I(log.q[rows])
    tau = log.tau[rows][:, np.array(robot.limbs.chains)]
    usable = np.abs(np.linalg.det(J)) > 1e-4
    if not usable.any():
        return None
    pushed = -np.linalg.solve(
        np.where(usable[..., None, None], np.swapaxes(J, 2, 3), np.eye(3)), tau[..., None]
    )[..., 0]
    return (pushed @ up) * usable
