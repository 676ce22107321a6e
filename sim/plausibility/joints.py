"""Checks of joints: rates against angles, range and torque limits of the robot, units."""

from collections.abc import Iterator

import numpy as np

from surefoot.sim.importing.advice import entries, scaled
from surefoot.sim.log.schema import JOINTS, LEGS
from surefoot.sim.plausibility import legs
from surefoot.sim.plausibility.comparison import (
    HARDLY,
    LIKELY,
    SCALED,
    SURELY,
    in_another_unit,
    match_axes,
    of_changing_sign,
    sign_change,
)
from surefoot.sim.plausibility.finding import Finding, plausibility_rule
from surefoot.sim.plausibility.view import LogView

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
_INVERTED = 0.5
"""Scale, relative to the other rates', below which a rate of the opposite sign is a vibration that
a filter inverts: a moving average passes 0.22 of it at most.
"""


@plausibility_rule("joint rates", "t q dq", when="comparable")
def rates(view: LogView) -> Iterator[Finding]:
    """Check that a joint's rate is the derivative of its angle.

    Compares: means of dq with changes of q over 60 ms, joint by joint.
    Threshold: a factor off by {SCALED:.0%}; correlation below {HARDLY:g}.
    Reason: equal by definition; clean walks agree to 1 %.
    Remedy: unit, sign or order of the columns.
    """
    log = view.log
    # The same whatever moves, if right.
    logged, moved = view.means(log.dq), view.changes(log.q)
    size, error = np.sqrt(np.mean(moved**2, axis=0)), view.between_samples(log.dq, log.q)
    moves = np.flatnonzero((size > _STIRS) & (logged.std(axis=0) > 0.0) & np.isfinite(error))
    names, slow = np.array(log.joints)[moves], size[moves] < _MOVES
    logged, moved = logged[:, moves], moved[:, moves]
    match = match_axes(logged, moved)
    own, slope = match.own, logged.std(axis=0) / moved.std(axis=0)
    changes = [sign_change(view.at, *both) for both in zip(logged.T, moved.T, strict=True)]
    steady = np.array([since is None for since in changes], dtype=bool)
    swapped = steady & match.exchanged & ~slow & (match.best - np.abs(own) > _ANOTHERS)
    opposite = steady & ~swapped & (own < np.where(slow, -LIKELY, -HARDLY))
    good = steady & ~swapped & (own > np.where(slow, SURELY, LIKELY))
    inverted = opposite & (slope < _INVERTED * (np.median(slope[good]) if good.any() else 1.0))
    for name, since in zip(names, changes, strict=True):
        if since is not None:
            yield of_changing_sign(f"dq_{name}", since, f"the change of q_{name}")
    for i in np.flatnonzero(swapped | (steady & ~slow & ~opposite & (own < HARDLY))):
        column, seen = f"dq_{names[i]}", f"correlation with the change of q_{names[i]} {own[i]:.2f}"
        if match.best[i] > LIKELY and swapped[i]:
            its = names[match.order[i]]
            seen += f", of q_{its} {match.best[i]:.2f}"
            cause, mended = f"it is the rate of {its}: swapped", entries((f"dq_{its}",), of=column)
        else:
            cause = "no rate of this joint: shuffled rows, another clock, or a broken sensor"
            mended = {}
        yield Finding((column,), seen, cause, mended)
    for i in np.flatnonzero(inverted):
        seen = f"correlation with the change of q {own[i]:.2f}, at {slope[i]:.2g} of its size"
        yield Finding((f"dq_{names[i]}",), seen, "a slow filter, which inverts a vibration")
    flipped = np.flatnonzero(opposite & ~inverted)
    of_angle = legs.opposite_angles(view) if flipped.size else set()
    for kind in ("q", "dq"):
        which = [i for i in flipped if (f"q_{names[i]}" in of_angle) == (kind == "q")]
        if which:
            columns = tuple(f"{kind}_{names[i]}" for i in which)
            seen = f"correlation of dq with the change of q {own[which].max():.2f} at best"
            cause = "wrong sign" + ", or time runs backwards" * (len(which) == len(names))
            yield Finding(columns, seen, cause, entries(columns, sign=-1.0))
    if good.any() and view.resolves:
        # What does not correlate says nothing of the size.
        yield from _rates_scaled(names[good], slope[good], (error[moves] + 1.0 - own)[good])


def _rates_scaled(names: np.ndarray, slope: np.ndarray, error: np.ndarray) -> Iterator[Finding]:
    """Check the scale of rates of G joints, as the slope (G,) over the changes of angles, with the
    error (G,) of that.
    """
    typical = float(np.median(slope))
    together = np.abs(slope / typical - 1.0) < 2.0 * SCALED
    # What lies between samples makes rates smaller, never larger.
    as_expected = -SCALED - np.median(error) < typical - 1.0 < SCALED
    if as_expected or 2 * together.sum() <= len(names):
        typical = 1.0
    else:
        columns, angles = (
            tuple(f"{kind}_{name}" for name in names[together]) for kind in ("dq", "q")
        )
        seen = f"{typical:.3g} times the change of q"
        if abs(np.degrees(typical) - 1.0) < 2.0 * SCALED:
            yield Finding(angles, seen, "angles in deg, not rad", entries(angles, unit="deg"))
        else:
            otherwise = "scaled, or stamps at a wrong rate"
            yield Finding(columns, seen, *in_another_unit("gyro", columns, typical, otherwise))
    for i in np.flatnonzero(np.abs(slope / typical - 1.0) > 2.0 * SCALED + error):
        column, seen = f"dq_{names[i]}", f"{slope[i]:.3g} times the change of q_{names[i]}"
        too_large = float(slope[i]) / typical
        yield Finding((column,), seen, "scaled, or its angle is", scaled(column, too_large))


@plausibility_rule("joints' unit", "q")
def units(view: LogView) -> Iterator[Finding]:
    """Check that angles of legs are in radians, and rates that are their change.

    Compares: the size of a leg's angles.
    Threshold: median above 2 pi rad.
    Reason: joints of legs do not turn about.
    Remedy: unit = "deg".
    """
    log = view.log
    turned = np.median(np.abs(log.q), axis=0) > 2.0 * np.pi
    if view.robot is None or not turned.any():
        return
    if 2 * turned.sum() > len(turned):
        turned[:] = True  # hips may stay below
    units = {column: {"unit": "deg"} for column in view.columns("q", turned)}
    if log.has("dq") and view.comparable:
        size, moved = (x.std(axis=0) for x in (view.means(log.dq), view.changes(log.q)))
        if abs(float(np.median(size / np.maximum(moved, 1e-12))) - 1.0) < 2.0 * SCALED:
            units |= {column: {"unit": "deg/s"} for column in view.columns("dq", turned)}
    seen, cause = f"up to {np.abs(log.q).max():.4g} rad", "in deg, not rad, or not unwrapped"
    yield Finding(tuple(units), seen, cause, {"columns": units})


@plausibility_rule("joint range", "q")
def stops(view: LogView) -> Iterator[Finding]:
    """Check that angles are within the limits of the robot's joints.

    Compares: angles of legs with the robot's stops.
    Threshold: {BEYOND:g} rad beyond in {BEYOND_SHARE:.0%} of the rows.
    Reason: zeros are set to some degrees, links bend by less; landings touch stops for an
        instant.
    Remedy: joint_sign, joint_offset, the order of the columns, the robot's name.
    """
    q, names = view.log.q, view.log.joints
    if view.robot is None:
        return
    low, high = view.robot.joint_range.T
    share, mirrored = (np.mean(np.maximum(low - x, x - high) > BEYOND, axis=0) for x in (q, -q))
    over = np.flatnonzero(share > BEYOND_SHARE)
    if not over.size:
        return
    worst = over[np.argmax(share[over])]
    limits = f"{low[worst]:.2f} to {high[worst]:.2f} rad of {view.robot.name}"
    seen = f"{names[worst]} is beyond {limits} in {100 * share[worst]:.0f} % of rows, median"
    seen += f" {np.median(q[:, worst]):.2f} rad"
    cause, changes = "wrong zero, swapped joints, or another robot", {}
    if np.all(mirrored[over] < BEYOND_SHARE):
        cause = "wrong sign, swapped joints, or another robot"
        changes = {"robot": {"joint_sign": {names[j]: -1.0 for j in over}}}
    yield Finding(view.columns("q", over), seen, cause, changes)


@plausibility_rule("torque", "tau")
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
        columns = view.columns("tau", over)
        thousand = np.median(strong[over] / limit[over]) > 30.0
        changes = entries(columns, unit="mN m") if thousand else {}
        cause = "in mN m, not N m" if thousand else "another unit, or another robot"
        yield Finding(columns, seen, cause, changes)


@plausibility_rule("magnitudes", "tau")
def magnitudes(view: LogView) -> Iterator[Finding]:
    """Check that torques have both signs.

    Compares: the signs of torques.
    Threshold: none negative.
    Reason: joints of legs push both ways.
    Remedy: torques with their signs.
    """
    tau = view.log.tau
    several = view.robot is not None and tau.shape[1] >= _SEVERAL
    if several and tau.std(axis=0).min() > 0.0 and tau.min() >= 0.0:
        seen = f"no negative torque of {tau.shape[1]} joints in any row"
        yield Finding(view.columns("tau"), seen, "magnitudes, without their sign")


@plausibility_rule("zeros", "q", when="comparable")
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


@plausibility_rule("commands", "q q_des")
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
        columns = view.columns("q_des")
        seen = f"{size:.3g} times the measured angles"
        yield Finding(columns, seen, "in deg, not rad", entries(columns, unit="deg"))
