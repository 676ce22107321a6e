"""Checks of joints: rates against angles, range and torque limits of the robot, units."""

from collections.abc import Iterator

import numpy as np

from surefoot.sim.log.schema import JOINTS, LEGS
from surefoot.sim.plausibility.finding import Finding
from surefoot.sim.plausibility.noise import noise_of
from surefoot.sim.plausibility.view import LogView

_DEGREE = 180.0 / np.pi
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
TURNS = 2.0 * np.pi
"""Angle that no joint of a leg reaches [rad]; in degrees, even a leg at rest exceeds it."""
TOO_STRONG = 1.5
"""Ratio of the 99 % quantile to the model's largest torque; peak torques are rated for seconds."""
ZERO_OFF = {"hip": 0.15, "thigh": 0.25, "calf": 0.25}
"""Difference of the medians of a left joint and its mirrored right one [rad], if the other pair
agrees to within half of it: turning, or crossing a slope, affects both pairs alike. Hips differ by
0.04 on a measured Go1.
"""
_SEVERAL = 6
"""Number of joints from which some torques are negative in any motion."""
NOISY_RATE = 1.5
"""Noise of a joint's rate between rows [rad/s]: one count of 12 bits in a row of 1 ms."""
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


def rates(view: LogView) -> Iterator[Finding]:
    """Check that a joint's rate is the derivative of its angle."""
    log = view.log
    if not (view.comparable and log.has("q") and log.has("dq")):
        return
    logged, moved = view.means(log.dq), view.changes(log.q)  # the same whatever moves, if right
    size = np.sqrt(np.mean(moved**2, axis=0))
    error = view.between_samples(log.dq, log.q)
    moves = np.flatnonzero((size > _STIRS) & (logged.std(axis=0) > 0.0) & np.isfinite(error))
    if not moves.size:
        return
    # Centred, so that a bias does not look like another joint.
    a, b = (x[:, moves] - x[:, moves].mean(axis=0) for x in (logged, moved))
    a, b = (x / np.linalg.norm(x, axis=0) for x in (a, b))
    alike = a.T @ b
    own = np.diag(alike)
    slope = logged[:, moves].std(axis=0) / moved[:, moves].std(axis=0)
    names = [log.joints[j] for j in moves]
    slow = size[moves] < _MOVES
    said: set[int] = set()
    for i, j in enumerate(moves):
        when = sign_change(view.at, logged[:, j], moved[:, j])
        if when is not None:
            said.add(i)
            told = f"from {when:.2f} s on minus the change of q_{names[i]}, before it is that, or"
            cause = "its sign, or its angle's, changes on the way"
            yield Finding((f"dq_{names[i]}",), f"{told} the other way round", cause)
    bad = [i for i in np.flatnonzero(own < RATE_ALIKE).tolist() if i not in said]
    others = np.abs(alike - np.diag(own)).argmax(axis=1)
    swapped = [
        i
        for i in range(len(moves))
        if not slow[i]
        and others[others[i]] == i
        and min(_excess(alike, i, others[i]), _excess(alike, others[i], i)) > _ANOTHERS
    ]
    bad = [*dict.fromkeys([*bad, *(i for i in swapped if i not in said)])]
    flipped = [i for i in bad if own[i] < -(0.8 if slow[i] else RATE_ALIKE) and i not in swapped]
    bad = [i for i in bad if not slow[i]]
    scale = float(np.median(slope[np.abs(own) > RATE_ALIKE])) if flipped else 1.0
    for i in [i for i in flipped if slope[i] < _INVERTED * scale]:
        flipped.remove(i)
        said.add(i)
        told = f"correlation with the change of q {own[i]:.2f}, at {slope[i]:.2g} of its size"
        yield Finding((f"dq_{names[i]}",), told, "a slow filter, which inverts a vibration")
    if flipped:
        said |= set(flipped)
        columns = tuple(f"dq_{names[i]}" for i in flipped)
        told = f"correlation with the change of q {own[flipped].max():.2f} at best"
        cause = "wrong sign" if len(flipped) < len(names) else "wrong sign, or time runs backwards"
        line = f"{', '.join(columns)} = {{ ..., sign = -1 }}"
        yield Finding(columns, told, cause, line)
    for i in bad:
        other = int(np.argmax(np.abs(alike[i])))
        if i in said:
            continue
        told = f"correlation with the change of q_{names[i]} {own[i]:.2f}"
        if alike[i, other] > 0.8:
            told += f", of q_{names[other]} {alike[i, other]:.2f}"
            cause = f"it is the rate of {names[other]}: swapped"
            line = f"dq_{names[other]} = {{ column = <their column of dq_{names[i]}> }}"
            yield Finding((f"dq_{names[i]}",), told, cause, line)
        else:
            cause = "no rate of this joint: shuffled rows, another clock, or a broken sensor"
            yield Finding((f"dq_{names[i]}",), told, cause)
    good = own > np.where(slow, _SURELY, 0.8)
    if not good.any():
        return
    typical = float(np.median(slope[good]))
    together = good & (np.abs(slope / typical - 1.0) < 2.0 * RATE_OFF)
    error = error[moves]
    # What lies between samples makes rates smaller, never larger.
    scaled = not -RATE_OFF - np.median(error[good]) < typical - 1.0 < RATE_OFF
    if scaled and 2 * together.sum() > good.sum():
        columns = tuple(f"dq_{n}" for n, g in zip(names, together, strict=True) if g)
        yield _scaled_rates(columns, typical, f"{typical:.3g} times the change of q")
    else:
        typical = 1.0
    for i in np.flatnonzero(good & (np.abs(slope / typical - 1.0) > 2.0 * RATE_OFF + error)):
        told = f"{slope[i]:.3g} times the change of q_{names[i]}"
        line = f"dq_{names[i]} = {{ ..., gain = {typical / slope[i]:.4g} }}"
        yield Finding((f"dq_{names[i]}",), told, "scaled, or its angle is", line)


def rate_noise(view: LogView) -> Iterator[Finding]:
    """Check the noise of joint rates."""
    log = view.log
    if log.has("dq") and view.comparable:
        ways = [log.dq, log.q] if log.has("q") else [log.dq]
        shown = np.flatnonzero(np.isfinite(view.between_samples(*ways)))
        names = [f"dq_{log.joints[j]}" for j in shown]
        yield from noise_of(log.dq[:, shown], names, NOISY_RATE, "rad/s")


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


def _excess(alike: np.ndarray, i: int, other: int) -> float:
    """How much better rate i correlates with another joint's change than with its own, of either
    sign; alike (J, J).
    """
    return float(abs(alike[i, other]) - abs(alike[i, i]))


def _scaled_rates(columns: tuple[str, ...], typical: float, told: str) -> Finding:
    angles = tuple(f"q_{c[3:]}" for c in columns)
    for factor, unit in ((_DEGREE, "deg/s"), (60.0 / (2.0 * np.pi), "rpm")):
        if abs(typical / factor - 1.0) < 0.2:
            line = f'{columns[0]}, ... = {{ ..., unit = "{unit}" }}'
            return Finding(columns, told, f"in {unit}, not rad/s", line)
    if abs(typical * _DEGREE - 1.0) < 0.2:
        line = f'{angles[0]}, ... = {{ ..., unit = "deg" }}'
        return Finding(angles, told, "angles in deg, not rad", line)
    return Finding(columns, told, "scaled, or stamps at a wrong rate")


def units(view: LogView) -> Iterator[Finding]:
    """Check that angles of legs are in radians, and rates that are their change."""
    log = view.log
    if not log.has("q") or view.robot is None:
        return
    q = log.q
    turned = [j for j, x in zip(log.joints, q.T, strict=True) if np.median(np.abs(x)) > TURNS]
    if 2 * len(turned) > len(log.joints):
        turned = list(log.joints)  # hips may stay below
    if turned:
        worst = float(np.abs(q).max())
        columns = tuple(f"q_{j}" for j in turned)
        line = f'{columns[0]}, ... = {{ ..., unit = "deg" }}'
        told = f"up to {worst:.4g} rad"
        if log.has("dq") and view.comparable:
            sizes = [x.std(axis=0) for x in (view.means(log.dq), view.changes(log.q))]
            if abs(float(np.median(sizes[0] / np.maximum(sizes[1], 1e-12))) - 1.0) < 0.2:
                columns += tuple(f"dq_{j}" for j in turned)
                line += f'; dq_{turned[0]}, ... = {{ ..., unit = "deg/s" }}'
                told += ", rates likewise"
        yield Finding(columns, told, "in deg, not rad, or not unwrapped", line)


def stops(view: LogView) -> Iterator[Finding]:
    """Check that angles are within the limits of the robot's joints."""
    log = view.log
    if not log.has("q") or view.robot is None:
        return
    q = log.q
    low, high = view.robot.joint_range.T
    beyond = np.maximum(low - q, q - high)
    share = np.mean(beyond > BEYOND, axis=0)
    over = np.flatnonzero(share > BEYOND_SHARE)
    if not over.size:
        return
    worst = over[np.argmax(share[over])]
    told = (
        f"{log.joints[worst]} is beyond {low[worst]:.2f} to {high[worst]:.2f} rad of "
        f"{view.robot.name} in {100 * share[worst]:.0f} % of rows, median "
        f"{np.median(q[:, worst]):.2f} rad"
    )
    within = np.mean(np.maximum(low + q, -q - high) > BEYOND, axis=0) < BEYOND_SHARE
    names = [log.joints[j] for j in over]
    cause, line = "wrong zero, swapped joints, or another robot", ""
    if within[over].all():
        cause = "wrong sign, swapped joints, or another robot"
        line = "; ".join(f"[robot.joint_sign] {name} = -1" for name in names)
    yield Finding(tuple(f"q_{name}" for name in names), told, cause, line)


def torques(view: LogView) -> Iterator[Finding]:
    """Check that torques are within the limits of the robot's drives."""
    if view.robot is None or not view.log.has("tau"):
        return
    limit = view.robot.torque_limit
    strong = np.quantile(np.abs(view.log.tau), 0.99, axis=0)
    over = np.flatnonzero(strong > TOO_STRONG * limit)
    if over.size:
        j = over[np.argmax(strong[over] / limit[over])]
        told = f"{strong[j]:.3g} N m, where the drive gives {limit[j]:.3g}"
        columns = tuple(f"tau_{view.log.joints[k]}" for k in over)
        thousand = np.median(strong[over] / limit[over]) > 30.0
        line = f'{columns[0]}, ... = {{ ..., unit = "mN m" }}' if thousand else ""
        cause = "in mN m, not N m" if thousand else "another unit, or another robot"
        yield Finding(columns, told, cause, line)


def magnitudes(view: LogView) -> Iterator[Finding]:
    """Check that torques have both signs."""
    if not view.log.has("tau") or view.robot is None or len(view.log.joints) < _SEVERAL:
        return
    tau = view.log.tau
    if tau.std(axis=0).min() > 0.0 and tau.min() >= 0.0:
        columns = tuple(f"tau_{j}" for j in view.log.joints)
        told = f"no negative torque of {len(columns)} joints in any row"
        yield Finding(columns, told, "magnitudes, without their sign")


def zeros(view: LogView) -> Iterator[Finding]:
    """Check that left and right legs are held alike; a single joint that differs has a wrong
    zero.
    """
    log, robot = view.log, view.robot
    if robot is None or log.joints != JOINTS or not log.has("q") or not view.comparable:
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
                names = tuple(f"q_{LEGS[2 * pair + side]}_{kind}" for side in (0, 1))
                told = f"medians {apart[pair, k]:.2f} rad apart, the others {apart[other, k]:.2f}"
                line = f"[robot] joint_offset of {names[0][2:]} or {names[1][2:]}"
                yield Finding(names, told, "one of them has a wrong zero", line)


def commands(view: LogView) -> Iterator[Finding]:
    """Check that commanded angles are in the unit of the measured ones."""
    log = view.log
    if not (log.has("q") and log.has("q_des")):
        return
    size = np.median(np.abs(log.q_des)) / max(float(np.median(np.abs(log.q))), 1e-6)
    if size > 10.0:
        columns = tuple(f"q_des_{j}" for j in log.joints)
        line = f'{columns[0]}, ... = {{ ..., unit = "deg" }}'
        told = f"{size:.3g} times the measured angles"
        yield Finding(columns, told, "in deg, not rad", line)
