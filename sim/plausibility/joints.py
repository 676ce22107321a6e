"""Checks of joints: rates against angles, range and torque limits, units."""

from collections.abc import Iterator

import numpy as np

from surefoot.sim.importing.advice import entries
from surefoot.sim.log.schema import JOINTS, LEGS
from surefoot.sim.plausibility import legs
from surefoot.sim.plausibility.comparison import misread, of_scale
from surefoot.sim.plausibility.finding import Finding, plausibility_rule
from surefoot.sim.plausibility.limits import HARDLY, SCALED
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
_MOVES, _STIRS = 0.2, 0.02
"""RMS rate [rad/s] below which a joint's rate is not compared: if it does not correlate with its
angle's derivative, and if it does, unlike noise.
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
    logged, moved = view.means(log.dq), view.changes(log.q)
    size, error = np.sqrt(np.mean(moved**2, axis=0)), view.between_samples(log.dq, log.q)
    compared = (size > _STIRS) & (logged.std(axis=0) > 0.0) & np.isfinite(error)
    columns, witness = view.columns("dq"), "the change of its angle"
    found, match = misread("dq", log.joints, view.at, logged * compared, moved, witness)
    for one in found:
        if one.cause == "wrong sign":
            of_angle = legs.opposite_angles(view)
            wrong = tuple(x[1:] if x[1:] in of_angle else x for x in one.streams)
            backwards = ", or time runs backwards" * int(len(wrong) == compared.sum())
            changes = entries(wrong, sign=-1.0)
            one = Finding(wrong, one.evidence, f"{one.cause}{backwards}", changes)
        yield one
    for i in np.flatnonzero(compared & (size > _MOVES) & (match.paired < HARDLY)):
        if not any(columns[i] in one.streams for one in found):
            seen = f"correlation with {witness} {match.paired[i]:.2f}"
            cause = "no rate of this joint: shuffled rows, another clock, or a slow filter"
            yield Finding((columns[i],), seen, cause)
    sure = np.flatnonzero(match.surely)
    if not sure.size or not view.resolves:
        return
    typical = float(np.median(match.scale[sure]))
    if abs(np.degrees(typical) - 1.0) < 2.0 * SCALED:
        angles = view.columns("q", sure)
        less = f"{typical:.3g} times the change of q"
        yield Finding(angles, less, "angles in deg, not rad", entries(angles, unit="deg"))
        return
    # What does not correlate says nothing of the size.
    unsure = (error + 1.0 - match.paired)[sure]
    otherwise = "scaled, or stamps at a wrong rate"
    named = view.columns("dq", sure)
    yield from of_scale(named, match.scale[sure], "the change of q", otherwise, unsure)


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
    over = share > BEYOND_SHARE
    flipped = np.all(mirrored[over] < BEYOND_SHARE)
    cause = f"wrong {'sign' if flipped else 'zero'}, swapped joints, or another robot"
    for j in np.flatnonzero(over):
        limits = f"{low[j]:.2f} to {high[j]:.2f} rad of {view.robot.name}"
        seen = f"beyond {limits} in {100 * share[j]:.0f} % of rows, median {np.median(q[:, j]):.2f}"
        changes = {"robot": {"joint_sign": {names[j]: -1.0}}} if flipped else {}
        yield Finding(view.columns("q", [j]), f"{seen} rad", cause, changes)


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
    over = strong > TOO_STRONG * limit
    thousand = over.any() and np.median((strong / limit)[over]) > 30.0
    cause = "in mN m, not N m" if thousand else "another unit, or another robot"
    for j in np.flatnonzero(over):
        column, seen = view.columns("tau", [j]), f"{strong[j]:.3g} N m"
        changes = entries(column, unit="mN m") if thousand else {}
        yield Finding(column, f"{seen}, where the drive gives {limit[j]:.3g}", cause, changes)


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
