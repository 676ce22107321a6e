"""Checks of torques against motion and contacts: what legs carry, when, and on which side."""

from collections.abc import Iterator

import numpy as np

from surefoot.sim.common.gravity import GRAVITY
from surefoot.sim.importing.advice import entries
from surefoot.sim.physics.loads import momentum_balance
from surefoot.sim.plausibility.comparison import match_axes
from surefoot.sim.plausibility.finding import Finding, plausibility_rule
from surefoot.sim.plausibility.limits import FEWEST, LATE_STREAM, LATEST_STREAM, LIKELY
from surefoot.sim.plausibility.stance import Stance
from surefoot.sim.plausibility.view import LogView
from surefoot.sim.robot.robot import Robot

SUPPORT = (0.5, 1.7)
"""Range of the weight carried by the torques of standing legs, relative to the model's: payloads
add a third, single legs of a stride carry twice.
"""


@plausibility_rule("joint torques", "t gyro accel q contact tau", beside="foot dq")
def torque_signs(view: LogView) -> Iterator[Finding]:
    """Check that a joint's torque has the sign of what moves and carries its leg.

    Compares: torques with those of the balance of momentum, by motion and contacts.
    Threshold: correlation below -{LIKELY:g}, where most joints have more than {LIKELY:g} of
        either sign.
    Reason: walking robots push against the ground and swing their legs; clean walks have 0.86.
    Remedy: sign of tau_<joint>, or of all.
    """
    robot, part = view.robot, view.middle
    derived = any(one.startswith("tau") for one in view.log.meta.derived)
    if robot is None or derived or not part.comparable:
        return
    asked = momentum_balance(part.log, robot).torque
    match = match_axes(part.means(part.log.tau), part.means(asked))
    sure = ~match.exchanged & (match.best > LIKELY)
    opposite = sure & (match.sign < 0.0)
    if 2 * sure.sum() > len(sure):
        for j in np.flatnonzero(opposite):
            seen = f"correlation with what motion and contacts ask for {match.paired[j]:.2f}"
            column = view.columns("tau", [j])
            yield Finding(column, seen, "wrong sign", entries(column, sign=-1.0))


@plausibility_rule("support", "q contact tau accel", beside="foot")
def weight_carried(view: LogView) -> Iterator[Finding]:
    """Check that torques of standing legs carry the robot's weight.

    Compares: the weight that torques of legs in contact carry with the robot's.
    Threshold: {SUPPORT[0]:g} to {SUPPORT[1]:g} times.
    Reason: on average a robot carries itself; payloads add a third.
    Remedy: unit or order of tau; torques of the output, not of the motor; the robot's
        name.
    """
    robot, (loads, contact) = view.robot, _loads(view)
    if robot is None or not loads.any() or contact.mean() < 0.2:
        return
    share = float(np.median(np.sum(loads * contact, axis=1)[contact.any(axis=1)]))
    share /= robot.mass * GRAVITY
    if SUPPORT[0] < share < SUPPORT[1]:
        return
    seen = f"legs in contact carry {share:.2f} times the weight of {robot.name}"
    cause = "swapped joints, another unit, a motor's side of a gear, or another robot"
    yield Finding(view.columns("tau"), seen, cause)


@plausibility_rule("late torques", "t q contact tau accel", beside="foot")
def late_torques(view: LogView) -> Iterator[Finding]:
    """Check that torques load the legs while they stand.

    Compares: the forces that torques mean with contacts, over time.
    Threshold: {LATE_STREAM:g} s late or early.
    Reason: a leg is loaded while it stands: 2 ms in clean walks.
    Remedy: the filter or clock of tau, or of the contacts.
    """
    loads, contact = _loads(view)
    if len(loads) < FEWEST:
        return
    walks = (contact.std(axis=0) > 0.2) & (loads.std(axis=0) > 0.0)
    if not walks.any():
        return
    steps = contact[:, walks].astype(float)
    lag, alike = view.delay(loads[:, walks], steps, LATE_STREAM, LATEST_STREAM)
    if lag and alike > LIKELY:
        seen = f"load legs {abs(lag):.3f} s {'after' if lag > 0 else 'before'} they stand"
        yield Finding(
            view.columns("tau"), seen, "a filter, or another clock (or that of the contacts)"
        )


def _loads(view: LogView) -> tuple[np.ndarray, np.ndarray]:
    """Force [N] on each leg along the body's z by its torques, and contacts, (K, L) each, in the
    middle of the log; without rows where these are not known.
    """
    if view.stance is None or view.robot is None:
        return np.zeros((0, 1)), np.zeros((0, 1), dtype=bool)
    part, log = view.middle, view.middle.log
    rows = np.clip(np.searchsorted(part.t, part.at), 0, len(part.t) - 1)
    pushed = _pushes(view.robot, log.q[rows], log.tau[rows])
    return pushed @ view.robot.R_BI[2], log.contact[rows]


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
