"""Checks of joints and their drives: rates against angles, range and torque limits, units.

On a fixed base torques are compared with inverse dynamics along the motion, commanded angles with
the measured ones, in the same way: sign, scale, and whether the stream goes on where what it
explains does.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from surefoot.sim.importing.advice import entries, scaled
from surefoot.sim.log.schema import JOINTS, LEGS
from surefoot.sim.plausibility import legs
from surefoot.sim.plausibility.comparison import changing_sign, correlation, match_axes, of_scale
from surefoot.sim.plausibility.finding import Finding, plausibility_rule
from surefoot.sim.plausibility.limits import HARDLY, LIKELY, SCALED, SURELY
from surefoot.sim.plausibility.streams import LIMITED, still_sections
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
DRIVEN = (0.4, 2.0)
"""Range of the scale relative to what is expected: measured drives have 0.6 to 1.3, because of
friction and inaccurate published masses; a torque of the motor's side is smaller by the gear ratio.
"""
STRAYS = 3.0
"""Ratio to the usual error from which a constant torque or command is stuck."""
SLIDES = 0.05
"""Rate below which dry friction does not reach its full size [rad/s]."""
MOVE = 0.5
"""Time over which moves of a joint are compared with those of its command [s]; servos are 0.1 s
late.
"""
COMMANDED = 1.0
"""Time without a change of a command, while its joint moves, from which it is stuck [s]."""


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
    columns, slow = view.columns("dq", moves), size[moves] < _MOVES
    logged, moved = logged[:, moves], moved[:, moves]
    match = match_axes(logged, moved)
    paired, slope = match.paired, logged.std(axis=0) / moved.std(axis=0)
    changing = [
        changing_sign(column, f"the change of {column[1:]}", view.at, logged[:, i], moved[:, i])
        for i, column in enumerate(columns)
    ]
    steady = np.array([one is None for one in changing], dtype=bool)
    another = match.exchanged & (match.best > LIKELY) & (match.best - np.abs(paired) > _ANOTHERS)
    swapped = steady & another & ~slow
    opposite = steady & ~swapped & (paired < np.where(slow, -LIKELY, -HARDLY))
    good = steady & ~swapped & (paired > np.where(slow, SURELY, LIKELY))
    slowest = _INVERTED * (np.median(slope[good]) if good.any() else 1.0)
    of_angle = legs.opposite_angles(view) if np.any(opposite & (slope >= slowest)) else set()
    for i, (column, found) in enumerate(zip(columns, changing, strict=True)):
        angle, seen = column[1:], f"correlation with the change of {column[1:]} {paired[i]:.2f}"
        if found is not None:
            yield found
        elif swapped[i]:
            rate = columns[match.order[i]]
            seen = f"{seen}, of {rate[1:]} {match.best[i]:.2f}"
            cause = f"it is the rate of {rate.removeprefix('dq_')}: swapped"
            yield Finding((column,), seen, cause, entries((rate,), of=column))
        elif opposite[i] and slope[i] < slowest:
            seen = f"{seen}, at {slope[i]:.2g} of its size"
            yield Finding((column,), seen, "a slow filter, which inverts a vibration")
        elif opposite[i]:
            wrong = (angle if angle in of_angle else column,)
            cause = "wrong sign, or time runs backwards" if opposite.all() else "wrong sign"
            yield Finding(wrong, seen, cause, entries(wrong, sign=-1.0))
        elif not slow[i] and paired[i] < HARDLY:
            cause = "no rate of this joint: shuffled rows, another clock, or a broken sensor"
            yield Finding((column,), seen, cause)
    if not good.any() or not view.resolves:
        return
    typical = float(np.median(slope[good]))
    if abs(np.degrees(typical) - 1.0) < 2.0 * SCALED:
        angles = view.columns("q", moves[good])
        less = f"{typical:.3g} times the change of q"
        yield Finding(angles, less, "angles in deg, not rad", entries(angles, unit="deg"))
        return
    # What does not correlate says nothing of the size.
    unsure = (error[moves] + 1.0 - paired)[good]
    otherwise = "scaled, or stamps at a wrong rate"
    named = view.columns("dq", moves[good])
    yield from of_scale(named, slope[good], "the change of q", otherwise, unsure)


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


@dataclass(frozen=True)
class _Explained:
    """A stream of a joint on a fixed base, and what explains it.

    Attributes:
        column: its name.
        x: mean values (M,).
        expected: (M,) in the same unit, but for friction or an offset.
        rest: regressors (M, R) of these.
        alike: two series (M,) whose correlation has the sign of the stream.
        holds: time without a change, while what it explains goes on, from which it is stuck [s].
        witness: name of what is expected.
        why_stuck: cause of a stream that is stuck.
        otherwise: cause of another scale.
    """

    column: str
    x: np.ndarray
    expected: np.ndarray
    rest: np.ndarray
    alike: tuple[np.ndarray, np.ndarray]
    holds: float
    witness: str
    why_stuck: str
    otherwise: str

    def fitted(self, where: np.ndarray | slice = slice(None)) -> tuple[np.ndarray, float]:
        """Least-squares fit (M,), and the factor of what is expected, on the times `where`."""
        terms = np.column_stack([self.expected, self.rest])
        sizes = np.linalg.lstsq(terms[where], self.x[where], rcond=None)[0]
        return terms @ sizes, float(sizes[0])

    @property
    def beside_rest(self) -> float:
        """Correlation of stream and expectation without what the rest explains of both."""
        terms = np.column_stack([self.rest, np.ones(len(self.x))])
        both = np.column_stack([self.x, self.expected])
        return correlation(*(both - terms @ np.linalg.lstsq(terms, both, rcond=None)[0]).T)


@plausibility_rule("torques of a fixed base", "t q tau", when="comparable")
def driving(view: LogView) -> Iterator[Finding]:
    """Check that the torques of drives on a fixed base explain its motion.

    Compares: torques with what the machine's model asks for along the motion, and friction
        beside it.
    Threshold: correlation below -{HARDLY:g}; a sign that changes on the way; not
        {DRIVEN[0]:g} to {DRIVEN[1]:g} times as large; no change for {LIMITED:g} s while
        {STRAYS:g} times as much is missed as else.
    Reason: three measured machines have 0.6 to 1.3 times what their models ask for.
    Remedy: sign, unit or gain of tau; torques of the output, not of the motor.
    """
    log, machine = view.log, view.machine
    if machine is None or machine.dynamics is None or not machine.fixed:
        return
    if any(d.startswith("tau") for d in log.meta.derived):
        return
    otherwise = "another unit, of the motor's side, or a load that the model lacks"
    words = "what the model asks for", "a sensor that hangs", otherwise
    tau, dq = view.means(log.tau), view.changes(log.q)
    rigid = machine.dynamics.inverse(view.means(log.q), dq, np.gradient(dq, view.at, axis=0))[1]
    for column, x, expected, rate in zip(view.columns("tau"), tau.T, rigid.T, dq.T, strict=True):
        friction = np.column_stack([np.tanh(rate / SLIDES), rate])
        one = _Explained(column, x, expected, friction, (x, expected), LIMITED, *words)
        yield from _drive_faults(view, one)


@plausibility_rule("commands of a fixed base", "t q q_des", when="comparable on_fixed_base")
def followed(view: LogView) -> Iterator[Finding]:
    """Check that the joints of a machine on a fixed base follow their commands.

    Compares: q_des with q, joint by joint, and their moves within {MOVE:g} s.
    Threshold: correlation below -{HARDLY:g}; a sign that changes on the way; not
        {DRIVEN[0]:g} to {DRIVEN[1]:g} times as far; no change for {COMMANDED:g} s while the
        joint goes {STRAYS:g} times as far off as else.
    Reason: nothing but its drive moves a joint of an arm as far.
    Remedy: sign, unit or gain of q_des.
    """
    causes = "a command that was not logged", "another unit than its angle's"
    both, offset = (view.log.q_des, view.log.q), np.ones((len(view.at), 1))
    moves = [view.after(x, 0.5 * MOVE) - view.after(x, -0.5 * MOVE) for x in both]
    asked, reached = (view.means(x) for x in both)
    for j, joint in enumerate(view.log.joints):
        alike, words = (moves[0][:, j], moves[1][:, j]), (f"the motion of q_{joint}", *causes)
        column, x, expected = f"q_des_{joint}", asked[:, j], reached[:, j]
        one = _Explained(column, x, expected, offset, alike, COMMANDED, *words)
        yield from _drive_faults(view, one)


def _drive_faults(view: LogView, one: _Explained) -> Iterator[Finding]:
    """Check that a stream changes when what explains it does, its sign and its scale."""
    column = (one.column,)
    if stuck := _stuck(view, one):
        yield Finding(column, f"{stuck} while {one.witness} goes on", one.why_stuck)
        return
    if not (one.x.std() > 0.0 and one.expected.std() > 0.0):
        return
    fitted, scale = one.fitted()
    alike = correlation(*one.alike)
    changing = changing_sign(one.column, one.witness, view.at, *one.alike, LIKELY)
    # What is expected alone is inconclusive for a machine that pushes against something.
    explained = correlation(one.x, fitted) > LIKELY
    if changing is not None:
        yield changing
    elif explained and alike < -HARDLY:
        seen = f"correlation with {one.witness} {alike:.2f}"
        yield Finding(column, seen, "wrong sign", entries(column, sign=-1.0))
    elif explained and abs(one.beside_rest) > LIKELY and not DRIVEN[0] < scale < DRIVEN[1]:
        seen = f"{scale:.3g} times {one.witness}"
        yield Finding(column, seen, one.otherwise, scaled(one.column, scale))


def _stuck(view: LogView, one: _Explained) -> str:
    """The first section in which a stream does not change, while what explains it does, in words;
    "" where there is none.
    """
    sections = still_sections(view.t, view.log.columns[one.column], one.holds)
    for begin, end in (view.t[[rows.start, rows.stop - 1]] for rows in sections):
        # After a step of a command, a joint is still moving.
        during = (view.at > begin + 0.25 * one.holds) & (view.at < end)
        outside = (view.at < begin) | (view.at > end + 0.25 * one.holds)
        if min(during.sum(), outside.sum()) < 3:
            continue
        fitted = one.fitted(outside)[0]
        missed = (one.x - fitted) ** 2
        goes_on = min(missed[during].mean(), np.ptp(fitted[during]) ** 2)
        if goes_on > STRAYS**2 * missed[outside].mean():
            return f"no change from {begin:.2f} to {end:.2f} s"
    return ""
