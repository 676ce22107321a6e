"""Checks of joints: rates against angles, range and torque limits of the robot, units."""

from collections.abc import Iterator

import numpy as np

from surefoot.sim.importing.advice import Changes, entries, scaled
from surefoot.sim.log.schema import JOINTS, LEGS
from surefoot.sim.plausibility import legs
from surefoot.sim.plausibility.finding import Finding, rule
from surefoot.sim.plausibility.units import in_another_unit
from surefoot.sim.plausibility.view import LogView

RATE_OFF = 0.1
"""Relative scale error of joint rates: 0.01 in clean walks, plus what the filters of drives take
from a swing.
"""
RATE_ALIKE = 0.5
"""Correlation of a rate with its angle's derivative below which it belongs to another joint: 0.9
and more in clean logs, 0.7 with a delay of a tenth of a swing.
"""
BEYOND = 0.1
"""Angle beyond a joint's limits [rad]: encoder zeros are set to some degrees, links bend by
less.
"""
BEYOND_SHARE = 0.02
"""Share of rows beyond the limits; touchdowns reach them for an instant."""
TOO_STRONG = 1.5
"""Ratio of the 99 % quantile to the model's largest torque; peak torques are rated for seconds."""
ZERO_OFF = {"hip": 0.15, "thigh": 0.25, "calf": 0.25}
"""Difference of the medians of a left joint and its mirrored right one [rad], if the other pair
agrees to within half of it: turning, or crossing a slope, affects both pairs alike. Hips differ by
0.04 on a measured Go1.
"""
_SEVERAL = 6
"""Number of joints from which some torques are negative in any motion."""
_ANOTHERS = 0.05
"""Least excess of a rate's correlation with the change of another joint over that with its own."""
_MOVES, _STIRS = 0.2, 0.02
"""RMS rate [rad/s] below which a joint's rate is not compared: if it does not correlate with its
angle's derivative, and if it does, unlike noise.
"""
_SURELY = 0.95
"""Correlation from which the scale of a slowly moving joint is compared."""
_INVERTED = 0.5
"""Scale, relative to the other rates', below which a rate of the opposite sign is a vibration that
a filter inverts: a moving average passes 0.22 of it at most.
"""
_TURNED, _ALWAYS = 0.1, 0.9
"""For a rate whose sign changes: least correlation before and after, and least sum of the two."""


@rule("joint rates", "t q dq", when="comparable")
def rates(view: LogView) -> Iterator[Finding]:
    """Check that a joint's rate is the derivative of its angle.

    Compares: means of dq with changes of q over 60 ms, joint by joint.
    Threshold: a factor off by {RATE_OFF:.0%}; correlation below {RATE_ALIKE:g}.
    Reason: equal by definition; clean walks agree to 1 %.
    Remedy: unit, sign or order of the columns.
    """
    log = view.log
    # The same whatever moves, if right.
    logged, moved = view.means(log.dq), view.changes(log.q)
    size = np.sqrt(np.mean(moved**2, axis=0))
    error = view.between_samples(log.dq, log.q)
    moves = np.flatnonzero((size > _STIRS) & (logged.std(axis=0) > 0.0) & np.isfinite(error))
    if not moves.size:
        return
    names = [log.joints[j] for j in moves]
    logged, moved = logged[:, moves], moved[:, moves]
    slow = size[moves] < _MOVES
    alike = np.corrcoef(logged, moved, rowvar=False)[: len(names), len(names) :]
    own = np.diag(alike)
    # What does not correlate says nothing of the size.
    error = error[moves] + 1.0 - own
    slope = logged.std(axis=0) / moved.std(axis=0)
    when = [sign_change(view.at, a, b) for a, b in zip(logged.T, moved.T, strict=True)]
    steady = np.array([one is None for one in when])
    other = np.abs(alike - np.diag(own)).argmax(axis=1)
    excess = np.abs(alike[range(len(own)), other]) - np.abs(own)
    exchanged = (other[other] == np.arange(len(own))) & ~slow
    exchanged &= np.minimum(excess, excess[other]) > _ANOTHERS
    opposite = steady & ~exchanged & (own < np.where(slow, -0.8, -RATE_ALIKE))
    strange = steady & ~opposite & ~slow & ((own < RATE_ALIKE) | exchanged)
    usual = float(np.median(slope[np.abs(own) > RATE_ALIKE])) if opposite.any() else 1.0
    inverted = opposite & (slope < _INVERTED * usual)
    for name, since in zip(names, when, strict=True):
        if since is not None:
            yield turned_round(f"dq_{name}", since, f"the change of q_{name}")
    for i in np.flatnonzero(inverted):
        seen = f"correlation with the change of q {own[i]:.2f}, at {slope[i]:.2g} of its size"
        yield Finding((f"dq_{names[i]}",), seen, "a slow filter, which inverts a vibration")
    flipped = opposite & ~inverted
    by_legs = legs.opposite_angles(view) if flipped.any() else set()
    of_angle = np.array([f"q_{name}" in by_legs for name in names])
    for kind, which in (("q", flipped & of_angle), ("dq", flipped & ~of_angle)):
        if not which.any():
            continue
        columns = tuple(f"{kind}_{names[i]}" for i in np.flatnonzero(which))
        seen = f"correlation of dq with the change of q {own[which].max():.2f} at best"
        cause = "wrong sign" if not which.all() else "wrong sign, or time runs backwards"
        yield Finding(columns, seen, cause, entries(columns, sign=-1.0))
    for i in np.flatnonzero(strange):
        seen = f"correlation with the change of q_{names[i]} {own[i]:.2f}"
        cause = "no rate of this joint: shuffled rows, another clock, or a broken sensor"
        changes: Changes = {}
        if alike[i, other[i]] > 0.8:
            its = names[other[i]]
            seen += f", of q_{its} {alike[i, other[i]]:.2f}"
            cause = f"it is the rate of {its}: swapped"
            changes = entries((f"dq_{its}",), of=f"dq_{names[i]}")
        yield Finding((f"dq_{names[i]}",), seen, cause, changes)
    good = own > np.where(slow, _SURELY, 0.8)
    if not (good.any() and view.resolves):
        return
    typical = float(np.median(slope[good]))
    together = good & (np.abs(slope / typical - 1.0) < 2.0 * RATE_OFF)
    # What lies between samples makes rates smaller, never larger.
    common = not -RATE_OFF - np.median(error[good]) < typical - 1.0 < RATE_OFF
    if common and 2 * together.sum() > good.sum():
        which = [name for name, one in zip(names, together, strict=True) if one]
        columns, angles = (tuple(f"{kind}_{name}" for name in which) for kind in ("dq", "q"))
        seen = f"{typical:.3g} times the change of q"
        if abs(np.degrees(typical) - 1.0) < 0.2:
            yield Finding(angles, seen, "angles in deg, not rad", entries(angles, unit="deg"))
        else:
            otherwise = "scaled, or stamps at a wrong rate"
            yield Finding(columns, seen, *in_another_unit("gyro", columns, typical, otherwise))
    else:
        typical = 1.0
    for i in np.flatnonzero(good & (np.abs(slope / typical - 1.0) > 2.0 * RATE_OFF + error)):
        seen = f"{slope[i]:.3g} times the change of q_{names[i]}"
        column, too_large = f"dq_{names[i]}", float(slope[i]) / typical
        yield Finding((column,), seen, "scaled, or its angle is", scaled(column, too_large))


def sign_change(
    at: np.ndarray, logged: np.ndarray, moved: np.ndarray, always: float = _ALWAYS
) -> float | None:
    """Time at which a stream changes its sign relative to the expected one; None where it does not.

    Args:
        at: times (M,) [s].
        logged: the stream (M,), such as a joint's rate.
        moved: the expected one (M,), such as the derivative of the joint's angle.
        always: least sum of the magnitudes of the correlations before and after.
    """
    # Clip outliers: an angle that changes its sign jumps.
    most = [np.quantile(np.abs(x), 0.95) for x in (logged, moved)]
    a, b = (np.clip(x, -m, m) for x, m in zip((logged, moved), most, strict=True))
    both = np.cumsum(a * b)
    k = int(np.argmax(np.abs(both) + np.abs(both[-1] - both)))
    before, after = both[k], both[-1] - both[k]
    whole = np.linalg.norm(a) * np.linalg.norm(b)
    least = min(abs(before), abs(after))
    if before * after >= 0.0 or least < _TURNED * whole or abs(before - after) < always * whole:
        return None
    return float(at[k])


def turned_round(column: str, since: float, expected: str) -> Finding:
    """The finding for a stream with another sign `since` some time [s]."""
    seen = f"from {since:.2f} s on minus {expected}, before it is that, or the other way round"
    return Finding((column,), seen, "its sign, or its angle's, changes on the way")


@rule("joints' unit", "q")
def units(view: LogView) -> Iterator[Finding]:
    """Check that angles of legs are in radians, and rates that are their change.

    Compares: the size of a leg's angles.
    Threshold: median above 2 pi rad.
    Reason: joints of legs do not turn about.
    Remedy: unit = "deg".
    """
    log = view.log
    if view.robot is None:
        return
    q = log.q
    turned = [j for j, x in zip(log.joints, q.T, strict=True) if np.median(np.abs(x)) > 2.0 * np.pi]
    if 2 * len(turned) > len(log.joints):
        turned = list(log.joints)  # hips may stay below
    if turned:
        worst = float(np.abs(q).max())
        seen = f"up to {worst:.4g} rad"
        units = {f"q_{j}": {"unit": "deg"} for j in turned}
        if log.has("dq") and view.comparable:
            size, moved = (x.std(axis=0) for x in (view.means(log.dq), view.changes(log.q)))
            if abs(float(np.median(size / np.maximum(moved, 1e-12))) - 1.0) < 2.0 * RATE_OFF:
                units |= {f"dq_{j}": {"unit": "deg/s"} for j in turned}
        cause = "in deg, not rad, or not unwrapped"
        yield Finding(tuple(units), seen, cause, {"columns": units})


@rule("joint range", "q", finds="symptom")
def stops(view: LogView) -> Iterator[Finding]:
    """Check that angles are within the limits of the robot's joints.

    Compares: angles of legs with the robot's stops.
    Threshold: {BEYOND:g} rad beyond in {BEYOND_SHARE:.0%} of the rows.
    Reason: zeros are set to some degrees, links bend by less; landings touch stops for an
        instant.
    Remedy: joint_sign, joint_offset, the order of the columns, the robot's name.
    """
    log = view.log
    if view.robot is None:
        return
    q = log.q
    low, high = view.robot.joint_range.T
    beyond = np.maximum(low - q, q - high)
    share = np.mean(beyond > BEYOND, axis=0)
    over = np.flatnonzero(share > BEYOND_SHARE)
    if not over.size:
        return
    worst = over[np.argmax(share[over])]
    limits = f"{low[worst]:.2f} to {high[worst]:.2f} rad of {view.robot.name}"
    seen = f"{log.joints[worst]} is beyond {limits} in {100 * share[worst]:.0f} % of rows, median"
    seen += f" {np.median(q[:, worst]):.2f} rad"
    within = np.mean(np.maximum(low + q, -q - high) > BEYOND, axis=0) < BEYOND_SHARE
    names = [log.joints[j] for j in over]
    cause, changes = "wrong zero, swapped joints, or another robot", {}
    if within[over].all():
        cause = "wrong sign, swapped joints, or another robot"
        changes = {"robot": {"joint_sign": dict.fromkeys(names, -1.0)}}
    yield Finding(tuple(f"q_{name}" for name in names), seen, cause, changes)


@rule("torque", "tau")
def torques(view: LogView) -> Iterator[Finding]:
    """Check that torques are within the limits of the robot's drives.

    Compares: torques with what the robot's drives can give.
    Threshold: {TOO_STRONG:g} times as much, one row in a hundred.
    Reason: drives give their peak for seconds at most, and no more.
    Remedy: unit = "mN m"; the robot's name.
    """
    if view.robot is None:
        return
    limit = view.robot.torque_limit
    strong = np.quantile(np.abs(view.log.tau), 0.99, axis=0)
    over = np.flatnonzero(strong > TOO_STRONG * limit)
    if over.size:
        j = over[np.argmax(strong[over] / limit[over])]
        seen = f"{strong[j]:.3g} N m, where the drive gives {limit[j]:.3g}"
        columns = tuple(f"tau_{view.log.joints[k]}" for k in over)
        thousand = np.median(strong[over] / limit[over]) > 30.0
        changes = entries(columns, unit="mN m") if thousand else {}
        cause = "in mN m, not N m" if thousand else "another unit, or another robot"
        yield Finding(columns, seen, cause, changes)


@rule("magnitudes", "tau")
def magnitudes(view: LogView) -> Iterator[Finding]:
    """Check that torques have both signs.

    Compares: the signs of torques.
    Threshold: none negative.
    Reason: joints of legs push both ways.
    Remedy: torques with their signs.
    """
    if view.robot is None or len(view.log.joints) < _SEVERAL:
        return
    tau = view.log.tau
    if tau.std(axis=0).min() > 0.0 and tau.min() >= 0.0:
        columns = tuple(f"tau_{j}" for j in view.log.joints)
        seen = f"no negative torque of {len(columns)} joints in any row"
        yield Finding(columns, seen, "magnitudes, without their sign")


@rule("zeros", "q", when="comparable", finds="symptom")
def zeros(view: LogView) -> Iterator[Finding]:
    """Check that left and right legs are held alike; a single joint that differs has a wrong
    zero.

    Compares: a left joint with the right one of the same pair of legs.
    Threshold: {ZERO_OFF[hip]:g} rad (hips), {ZERO_OFF[thigh]:g} rad (others) between medians
        (hips mirrored), while those of the other pair agree.
    Reason: legs of a pair are held alike; what holds them otherwise does so to both pairs.
    Remedy: joint_offset.
    """
    log, robot = view.log, view.robot
    if robot is None or log.joints != JOINTS:
        return
    middle = np.median(log.q, axis=0)
    # Lateral velocity of a foot by its hip: if it has the same sign, angles of mirrored legs are
    # opposite.
    aside = robot.feet_jacobian_I(middle[None])[0, :, :, 0] @ robot.R_BI[1]
    middle = middle.reshape(2, 2, 3)  # front and rear, left and right
    mirrored = -np.sign(np.prod(aside.reshape(2, 2), axis=1))
    apart = middle[:, 0] - middle[:, 1]
    apart[:, 0] = middle[:, 0, 0] - mirrored * middle[:, 1, 0]
    for pair, other in ((0, 1), (1, 0)):
        for k, (kind, most) in enumerate(ZERO_OFF.items()):
            if abs(apart[pair, k]) > most and np.all(np.abs(apart[other]) < 0.5 * most):
                left, right = (f"{LEGS[2 * pair + side]}_{kind}" for side in (0, 1))
                off = round(float(apart[pair, k]), 2)
                seen = f"medians {off:.2f} rad apart, the others {apart[other, k]:.2f}"
                ways = {left: -off, right: off * (1.0 if k else mirrored[pair])}
                words = " or ".join(f"joint_offset.{joint} = {x:g}" for joint, x in ways.items())
                cause = f"one of them has a wrong zero: {words} in [robot] of the map"
                yield Finding((f"q_{left}", f"q_{right}"), seen, cause)


@rule("commands", "q q_des")
def commands(view: LogView) -> Iterator[Finding]:
    """Check that commanded angles are in the unit of the measured ones.

    Compares: the size of q_des with that of q.
    Threshold: 10 times.
    Reason: a joint follows its command, so that both have about the same size.
    Remedy: unit = "deg".
    """
    log = view.log
    size = np.median(np.abs(log.q_des)) / max(float(np.median(np.abs(log.q))), 1e-6)
    if size > 10.0:
        columns = tuple(f"q_des_{j}" for j in log.joints)
        seen = f"{size:.3g} times the measured angles"
        yield Finding(columns, seen, "in deg, not rad", entries(columns, unit="deg"))
