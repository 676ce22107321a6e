"""Joint torques and foot forces of a walk whose log has none, from the balance of its momentum.

What the motion of all bodies takes at the floating base, M qdd + h in its six rows, is what the
standing feet give:

    sum_l f_l = F,    sum_l r_l x f_l = M,    tau = (M qdd + h)_joints - J^T f

Two feet leave one pull between them free, more feet more: of all such forces the least is taken,
each in the measure of what its own force sensor reads, in whatever unit, or else of its contact,
which comes and goes over a few hundredths of a second. Motor torques that press feet against each
other do not show in a motion, and are not found.
"""

from typing import Any, NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d

from surefoot.sim.log import Log, joint_velocity
from surefoot.sim.log.derived import derivative
from surefoot.sim.physics.inverse_dynamics import body_changes, dynamics_of
from surefoot.sim.robot import Robot
from surefoot.sim.robot.fixed_base import Machine

ACCELERATION_WINDOW = 0.04
"""s, over which rates are differentiated: passes 25 Hz, with which a foot's load comes and goes."""
LOADING = 0.01
"""s, standard deviation of the time over which a foot takes its load, and of the result."""
LIGHT_TOUCH = 0.05
"""Share of what a foot's sensor reads in its stances below which it touches nothing: drift and
hysteresis of force sensors are a few hundredths of their range."""
SLACK = 1e-3
"""Share of what all feet can give below which a force or moment is not asked of them: two feet give
no moment about the line between them."""


class MomentumBalance(NamedTuple):
    """What a motion takes: torque (N, J) [N m] of the joints; force (N, L, 3) [N], in B, of the
    ground on the feet, zero on feet that touch nothing."""

    torque: np.ndarray
    force: np.ndarray


def momentum_balance(log: Log, robot: Robot) -> MomentumBalance:
    """Joint torques and foot forces from IMU, joint angles and contacts of a walk.

    Raises LogError where the log lacks one of them.
    """
    log.require("imu", "q", "contact")
    columns = log.columns_of("q", "dq", "imu", "contact", "force")
    return log.once("balance of momentum", columns, lambda: _balanced(log, robot), *parts_of(robot))


def parts_of(robot: Machine) -> tuple[Any, ...]:
    """The parts of a model that loads depend on: objects that are the same until they change."""
    if not isinstance(robot, Robot):
        return (robot.extras.links,)
    return robot.legs, robot.R_BI, robot.p_BI, robot.extras.links


def _balanced(log: Log, robot: Robot) -> MomentumBalance:
    wrench, needed = taken_by_motion(log, robot)
    smooth = LOADING * log.rate
    loaded = _loaded_by_force(log)
    if loaded is None:
        # From nothing where a contact begins or ends to all of it within the stance.
        standing = gaussian_filter1d(log.contact.astype(float), smooth, axis=0)
        loaded = np.maximum(2 * standing - 1, 0) * log.contact
    feet_B = robot.feet_I(log.q) @ robot.R_BI.T + robot.p_BI
    force = _least_forces(wrench, feet_B, loaded, robot.leg_length)
    J = np.einsum("ij,nljk->nlik", robot.R_BI, robot.feet_jacobian_I(log.q))
    by_leg, given = np.einsum("nlik,nli->nlk", J, force), np.zeros_like(needed)
    for leg, chain in enumerate(robot.limbs.chains):
        given[:, chain] = by_leg[:, leg, : len(chain)]
    return MomentumBalance(gaussian_filter1d(needed - given, smooth, axis=0), force)


def _loaded_by_force(log: Log) -> np.ndarray | None:
    """What each foot's sensor reads (N, L) beyond its reading in the air, over the same in its
    stances; None where the log has no such forces, or where one says nothing of its contact.

    A foot carries before its load crosses the threshold from which it counts as standing.
    """
    if not log.has("force"):
        return None
    force, loaded = log.force, np.empty(log.contact.shape)
    for leg, stands in enumerate(log.contact.T):
        if not stands.any():
            return None
        rest = float(np.median(force[~stands, leg])) if not stands.all() else 0.0
        full = float(np.median(force[stands, leg]))
        if not full > rest:
            return None
        loaded[:, leg] = (force[:, leg] - rest) / (full - rest)
    return np.maximum(loaded - LIGHT_TOUCH, 0.0) / (1.0 - LIGHT_TOUCH)


def taken_by_motion(log: Log, robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    """Wrench (N, 6) [N, N m] on the base, in B about its origin, and joint torques (N, J) [N m]
    that the motion takes, feet in the air."""
    t, dq = log.t, joint_velocity(log)
    omega, accel = (
        gaussian_filter1d(x @ robot.R_BI.T, LOADING * log.rate, axis=0)
        for x in (log.gyro, log.accel)
    )
    ddq, spin = (derivative(t, x, ACCELERATION_WINDOW, causal=False) for x in (dq, omega))
    p = robot.p_BI
    origin = accel - np.cross(spin, p) - np.cross(omega, np.cross(omega, p))
    dynamics = dynamics_of(robot.file, robot.joint_names)
    base = np.hstack([omega, spin, origin])
    return dynamics.inverse(log.q, dq, ddq, base, body_changes(robot))


def _least_forces(
    wrench: np.ndarray, feet: np.ndarray, weight: np.ndarray, length: float
) -> np.ndarray:
    """Forces (N, L, 3) at `feet` (N, L, 3) with the given wrench (N, 6) and the least sum of
    squares over `weight` (N, L); moments count as forces at `length` [m]."""
    n, legs = weight.shape
    # Columns: what a force along each axis at each foot gives, forces first.
    A = np.zeros((n, 6, legs, 3))
    A[:, :3] = np.eye(3)[:, None]
    A[:, 3:] = np.cross(feet[:, :, None], np.eye(3)).transpose(0, 3, 1, 2) / length
    asked = np.concatenate([wrench[:, :3], wrench[:, 3:] / length], axis=1)
    AW = (A * weight[:, None, :, None]).reshape(n, 6, -1)
    S = AW @ A.reshape(n, 6, -1).transpose(0, 2, 1)
    S += SLACK * np.maximum(np.trace(S, axis1=1, axis2=2), 1e-9)[:, None, None] * np.eye(6)
    return np.einsum("nij,ni->nj", AW, np.linalg.solve(S, asked[..., None])[..., 0]).reshape(
        n, legs, 3
    )
