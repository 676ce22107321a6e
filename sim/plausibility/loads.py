"""Checks of torques and commands against motion: their sign, size and time, and on which side of
a leg they push.
"""

from collections.abc import Iterator

import numpy as np

from surefoot.sim.importing.advice import scaled
from surefoot.sim.physics.loads import momentum_balance
from surefoot.sim.plausibility.comparison import misread
from surefoot.sim.plausibility.finding import Finding, plausibility_rule
from surefoot.sim.plausibility.limits import LATE_STREAM, LATEST_STREAM, LIKELY
from surefoot.sim.plausibility.stance import Stance
from surefoot.sim.plausibility.streams import LIMITED, still_sections
from surefoot.sim.plausibility.view import LogView
from surefoot.sim.robot.robot import Robot

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


_EXPECTED = {
    "tau": (
        "what the model asks for",
        "another unit, of the motor's side, another robot, or a load that the model lacks",
        LIMITED,
    ),
    "q_des": ("the motion of its joint", "another unit than its angle's", COMMANDED),
}
"""By kind of stream, in words, what is expected of it and the cause of another size; and the time
without a change, while what is expected goes on, from which it is stuck [s].
"""


@plausibility_rule(
    "torques of a fixed base", "t q tau", when="comparable on_fixed_base torque_is_measured"
)
def driven(view: LogView) -> Iterator[Finding]:
    """Check that torques of drives on a fixed base explain its motion.

    Compares: torques with inverse dynamics along the motion, friction aside.
    Threshold: correlation above {LIKELY:g} with another joint's or its negative; a sign that
        changes on the way; not {DRIVEN[0]:g} to {DRIVEN[1]:g} times as large; no change for
        {LIMITED:g} s while {STRAYS:g} times as much is missed as else.
    Reason: three measured machines have 0.6 to 1.3 times what their models ask for.
    Remedy: sign, order, unit or gain of tau; torques of the output, not of the motor.
    """
    log, machine = view.log, view.machine
    if machine is None or machine.dynamics is None:
        return
    dq = view.changes(log.q)
    asked = machine.dynamics.inverse(view.means(log.q), dq, np.gradient(dq, view.at, axis=0))[1]
    joints = zip(view.means(log.tau).T, asked.T, dq.T, strict=True)
    both = np.stack([_beside_friction(*one) for one in joints], axis=2)
    yield from _drive_faults(view, "tau", *both)


@plausibility_rule(
    "torques of legs",
    "t gyro accel q contact tau",
    beside="foot dq",
    when="comparable resolves torque_is_measured",
)
def carrying(view: LogView) -> Iterator[Finding]:
    """Check that torques of legs carry and move the robot, while they stand.

    Compares: torques with those of the balance of momentum, by motion and contacts; the loads that
        they mean with contacts, over time.
    Threshold: {LATE_STREAM:g} s late or early; correlation above {LIKELY:g} with another joint's or
        its negative; a sign that changes on the way; not {DRIVEN[0]:g} to {DRIVEN[1]:g} times as
        large in the median of the joints.
    Reason: clean walks correlate by 0.86 and are 2 ms late; payloads add a third.
    Remedy: clock, sign, order or unit of tau; torques of the output, not of the motor; the robot's
        name.
    """
    robot, part = view.robot, view.middle
    if robot is None or not part.comparable:
        return
    log = part.log
    pushed = _pushes(robot, log.q, log.tau) @ robot.R_BI[2]
    loads, stands = part.means(pushed), part.means(log.contact.astype(float))
    lag, alike = part.delay(loads, stands, LATE_STREAM, LATEST_STREAM)
    if lag and alike > LIKELY:
        seen = f"load legs {abs(lag):.3f} s {'after' if lag > 0 else 'before'} they stand"
        cause = "a filter, or another clock (or that of the contacts)"
        yield Finding(view.columns("tau"), seen, cause)
        return
    asked, (witness, otherwise, _) = momentum_balance(log, robot).torque, _EXPECTED["tau"]
    tau, asked = part.means(log.tau), part.means(asked)
    found, match = misread("tau", log.joints, part.at, tau, asked, witness)
    yield from found
    sure = match.paired > LIKELY
    size = float(np.median(match.scale[sure])) if sure.any() else 1.0
    if not DRIVEN[0] < size < DRIVEN[1]:
        yield Finding(view.columns("tau"), f"{size:.2g} times {witness}", otherwise)


def _beside_friction(tau: np.ndarray, asked: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """What friction does not explain (2, M) of torques and of what is asked for (M,), at rates (M,)
    [rad/s].
    """
    friction = np.column_stack([np.tanh(rate / SLIDES), rate, np.ones(len(rate))])
    both = np.column_stack([tau, asked])
    return (both - friction @ np.linalg.lstsq(friction, both, rcond=None)[0]).T


@plausibility_rule("commands of a fixed base", "t q q_des", when="comparable on_fixed_base")
def followed(view: LogView) -> Iterator[Finding]:
    """Check that the joints of a machine on a fixed base follow their commands.

    Compares: moves of q_des and of q within {MOVE:g} s, joint by joint.
    Threshold: correlation above {LIKELY:g} with another joint's or its negative; a sign that
        changes on the way; not {DRIVEN[0]:g} to {DRIVEN[1]:g} times as far; no change for
        {COMMANDED:g} s while the joint goes {STRAYS:g} times as far off as else.
    Reason: nothing but its drive moves a joint of an arm as far.
    Remedy: sign, unit or gain of q_des.
    """
    both = (view.log.q_des, view.log.q)
    moves = [view.after(x, 0.5 * MOVE) - view.after(x, -0.5 * MOVE) for x in both]
    yield from _drive_faults(view, "q_des", *moves)


def _drive_faults(
    view: LogView, kind: str, x: np.ndarray, expected: np.ndarray
) -> Iterator[Finding]:
    """Check streams x (M, J) of a kind beside what is expected of them (M, J)."""
    witness, otherwise, holds = _EXPECTED[kind]
    x, columns = x.copy(), view.columns(kind)
    for i, column in enumerate(columns):
        if seen := _stuck(view, column, x[:, i], expected[:, i], holds):
            yield Finding((column,), f"{seen} while {witness} goes on", "it hangs")
            x[:, i] = 0.0
    found, match = misread(kind, view.log.joints, view.at, x, expected, witness)
    yield from found
    for i in np.flatnonzero(match.paired > LIKELY):
        size = float(x[:, i].std() / expected[:, i].std())
        if not DRIVEN[0] < size < DRIVEN[1]:
            changes = scaled(columns[i], size)
            yield Finding((columns[i],), f"{size:.3g} times {witness}", otherwise, changes)


def _stuck(view: LogView, column: str, x: np.ndarray, expected: np.ndarray, holds: float) -> str:
    """The first section in which a stream does not change, while what is expected does, in words;
    "" where there is none.
    """
    for rows in still_sections(view.t, view.log.columns[column], holds):
        begin, end = view.t[[rows.start, rows.stop - 1]]
        # After a step of a command, a joint is still moving.
        during = (view.at > begin + 0.25 * holds) & (view.at < end)
        outside = (view.at < begin) | (view.at > end + 0.25 * holds)
        if min(during.sum(), outside.sum()) < 3:
            continue
        fitted = np.polyval(np.polyfit(expected[outside], x[outside], 1), expected)
        missed = (x - fitted) ** 2
        goes_on = min(missed[during].mean(), np.ptp(fitted[during]) ** 2)
        if goes_on > STRAYS**2 * missed[outside].mean():
            return f"no change from {begin:.2f} to {end:.2f} s"
    return ""


def leaning(view: LogView, legs: Stance, others: np.ndarray, sign: np.ndarray) -> np.ndarray:
    """Sideways part (L,) of the load that torques mean on each leg, relative to the upward one,
    where up is the specific force; 0 where it is not known.

    Args:
        view: of the log.
        legs: their times.
        others: joints whose angles and torques are taken for those of each leg (L, C).
        sign: of these (C,).
    """
    log, robot, rows = view.log, view.robot, legs.rows[:, 1]
    if robot is None or not log.has("tau"):
        return np.zeros(len(others))
    q, tau = (exchanged(view, x[rows], others, sign) for x in (log.q, log.tau))
    pushed = _pushes(robot, q, tau)
    up = view.accel[legs.which]
    up = up / np.maximum(np.linalg.norm(up, axis=1, keepdims=True), 1e-9)
    upward = np.einsum("kli,ki->kl", pushed, up)
    aside = pushed @ robot.R_BI[1] - upward * (up @ robot.R_BI[1])[:, None]
    in_all = [np.abs(np.sum(x * legs.contact, axis=0)) for x in (aside, upward)]
    return in_all[0] / np.maximum(in_all[1], 1e-9)


def exchanged(
    view: LogView,
    x: np.ndarray,
    others: np.ndarray,
    sign: np.ndarray | float,
    offset: np.ndarray | float = 0.0,
) -> np.ndarray:
    """Angles or torques x (K, J) of which those of other joints (L, C), times a sign (C,) and with
    an offset (C,) added, are taken for each leg's.
    """
    read = x.copy()
    read[:, view.chains] = x[:, others] * sign + offset
    return read


def _pushes(robot: Robot, q: np.ndarray, tau: np.ndarray) -> np.ndarray:
    """Force (K, L, 3) [N] in I on each leg that balances torques (K, J) quasi-statically, at
    angles (K, J); 0 where a leg is stretched, or legs have not three joints.
    """
    chains = robot.limbs.chains
    if not robot.limbs.point_feet:
        return np.zeros((len(q), len(chains), 3))
    J = robot.feet_jacobian_I(q)
    usable = (np.abs(np.linalg.det(J)) > 1e-4)[..., None]
    J_T = np.where(usable[..., None], np.swapaxes(J, 2, 3), np.eye(3))
    return -np.linalg.solve(J_T, tau[:, np.array(chains)][..., None])[..., 0] * usable
