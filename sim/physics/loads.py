"""Loads on a robot's joints and feet in each row, from motor torques or from the motion.

For logs without torques they follow from the momentum balance. The wrench that the motion of all
bodies requires at the floating base, M qdd + h in its six rows, equals that of the standing feet:

    sum_l f_l = F,    sum_l r_l x f_l = M,    tau = (M qdd + h)_joints - J^T f

For two feet, the internal force between them is undetermined; for more feet, more. The minimum-norm
solution is taken, with each foot weighted by the reading of its force sensor, in whatever unit, or
else by its contact, ramped over a few hundredths of a second. Motor torques that press the feet
against each other do not affect the motion, and are not found.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import numpy as np
from scipy.ndimage import gaussian_filter1d

from surefoot.sim.log import Log, joint_velocity
from surefoot.sim.log.derived import derivative
from surefoot.sim.robot import Robot
from surefoot.sim.robot.machine import Machine, Modelled

T = TypeVar("T")

ACCELERATION_WINDOW = 0.04
"""Window for the differentiation of rates [s]: passes 25 Hz, the rate of a foot's loading."""
LOADING_TIME = 0.01
"""Standard deviation of the time in which a foot takes up load, and of the result's smoothing
[s].
"""
LEAST_CONTACT_SHARE = 0.05
"""Share of a foot sensor's reading in stance below which the foot has no contact: drift and
hysteresis of force sensors are a few hundredths of their range.
"""
WRENCH_TOLERANCE = 1e-3
"""Share of the largest wrench of all feet below which a component is not required of them: two feet
cannot produce a moment about the line between them.
"""


class MomentumBalance(NamedTuple):
    """Torques and forces of a motion.

    Attributes:
        torque: of the joints (N, J) [N m].
        force: of the ground on the feet, in B (N, L, 3) [N]; zero without contact.
    """

    torque: np.ndarray
    force: np.ndarray


def momentum_balance(log: Log, robot: Robot) -> MomentumBalance:
    """Joint torques and foot forces of a walk from IMU, joint angles and contacts.

    Raises LogError where the log lacks one of them.
    """
    log.require("imu", "q", "contact")
    return once_for_loads("balance of momentum", log, robot, lambda: _balanced(log, robot))


def once_for_loads(what: str, log: Log, robot: Machine, make: Callable[[], T], *given: Any) -> T:
    """`Log.once` for a value that depends on what determines loads, in the log and in the model.

    Args:
        what: name of the value.
        log: from whose columns it is made.
        robot: with its model.
        make: makes it.
        given: what else it depends on.
    """
    legged = robot.legged
    geometry = () if legged is None else (legged.legs, legged.R_BI, legged.p_BI)
    # These objects are identical until they change.
    uses = ("q", "dq", "tau", "imu", "contact", "force")
    return log.once(what, uses, make, *given, *geometry, robot.extras.links)


def feet_jacobian_B(log: Log, robot: Robot) -> np.ndarray:
    """Jacobian of each foot by its own leg's joints (N, L, 3, P) in B [m/rad]."""

    def made() -> np.ndarray:
        return robot.R_BI @ robot.feet_jacobian_I(log.q)

    return log.once("Jacobians of the feet", ["q"], made, robot.legs, robot.R_BI)


def _balanced(log: Log, robot: Robot) -> MomentumBalance:
    wrench, needed = rigid_body_wrench(log, robot)
    smooth = LOADING_TIME * log.rate
    loaded = _loaded_by_force(log)
    if loaded is None:
        # Ramped from zero at a contact's ends to one within the stance.
        standing = gaussian_filter1d(log.contact.astype(float), smooth, axis=0)
        loaded = np.maximum(2 * standing - 1, 0) * log.contact
    feet_B = robot.feet_I(log.q) @ robot.R_BI.T + robot.p_BI
    force = _least_forces(wrench, feet_B, loaded, robot.leg_length)
    J = feet_jacobian_B(log, robot)
    by_leg, given = np.einsum("nlik,nli->nlk", J, force), np.zeros_like(needed)
    for leg, chain in enumerate(robot.limbs.chains):
        given[:, chain] = by_leg[:, leg, : len(chain)]
    return MomentumBalance(gaussian_filter1d(needed - given, smooth, axis=0), force)


def _loaded_by_force(log: Log) -> np.ndarray | None:
    """Reading of each foot's sensor (N, L) above that in the air, relative to that in stance.

    None where the log has no such forces, or where one does not correlate with its contact. A foot
    carries load before it crosses the contact threshold.
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
    return np.maximum(loaded - LEAST_CONTACT_SHARE, 0.0) / (1.0 - LEAST_CONTACT_SHARE)


def rigid_body_wrench(log: Log, robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    """Inverse dynamics without foot forces: wrench (N, 6) [N, N m] on the base, in B about its
    origin, and joint torques (N, J) [N m].
    """
    t, dq = log.t, joint_velocity(log)
    omega, accel = (
        gaussian_filter1d(x @ robot.R_BI.T, LOADING_TIME * log.rate, axis=0)
        for x in (log.gyro, log.accel)
    )
    ddq, spin = (derivative(t, x, ACCELERATION_WINDOW, causal=False) for x in (dq, omega))
    p = robot.p_BI
    origin = accel - np.cross(spin, p) - np.cross(omega, np.cross(omega, p))
    return robot.dynamics.inverse(log.q, dq, ddq, np.hstack([omega, spin, origin]))


def _least_forces(
    wrench: np.ndarray, feet: np.ndarray, weight: np.ndarray, length: float
) -> np.ndarray:
    """Forces (N, L, 3) at `feet` (N, L, 3) with the given wrench (N, 6) and the least sum of
    squares over `weight` (N, L); moments count as forces at a distance of `length` [m].
    """
    n, legs = weight.shape
    # Columns: wrench of a unit force along each axis at each foot, forces first.
    A = np.zeros((n, 6, legs, 3))
    A[:, :3] = np.eye(3)[:, None]
    A[:, 3:] = np.cross(feet[:, :, None], np.eye(3)).transpose(0, 3, 1, 2) / length
    asked = np.concatenate([wrench[:, :3], wrench[:, 3:] / length], axis=1)
    AW = (A * weight[:, None, :, None]).reshape(n, 6, -1)
    S = AW @ A.reshape(n, 6, -1).transpose(0, 2, 1)
    trace = np.maximum(np.trace(S, axis1=1, axis2=2), 1e-9)
    S += WRENCH_TOLERANCE * trace[:, None, None] * np.eye(6)
    solved = np.linalg.solve(S, asked[..., None])[..., 0]
    return np.einsum("nij,ni->nj", AW, solved).reshape(n, legs, 3)


STICTION_RATE = 0.03
"""Rate below which dry friction is smoothed [rad/s]: a few times the noise of a measured rate."""


def knows_loads(log: Log) -> bool:
    """Whether a log determines the loads of joints and feet, by torques or by its motion."""
    return log.has("tau") or (log.has("imu") and log.has("contact"))


def joint_loads(log: Log, robot: Modelled) -> np.ndarray:
    """Torque (N, J) [N m] that each motor transmits to its link.

    The motor's torque, as logged or else from the momentum balance, less rotor inertia and declared
    friction.
    """
    return once_for_loads("joint loads", log, robot, lambda: _joint_loads(log, robot))


def _joint_loads(log: Log, robot: Modelled) -> np.ndarray:
    if log.has("tau") or robot.legged is None:
        torque = log.tau
    else:
        torque = momentum_balance(log, robot.legged).torque
    dynamics, dq = robot.dynamics, joint_velocity(log)
    rotor, viscous, dry = (
        getattr(dynamics.model, name)[dynamics.dof_adr]
        for name in ("dof_armature", "dof_damping", "dof_frictionloss")
    )
    ddq = derivative(log.t, dq, ACCELERATION_WINDOW, causal=False)
    return torque - rotor * ddq - viscous * dq - dry * np.tanh(dq / STICTION_RATE)


def foot_loads_B(log: Log, robot: Robot) -> np.ndarray:
    """Force (N, L, 3) [N], in B, of the ground on each foot; zero without contact.

    From logged torques for legs of three joints, J^T f = inverse dynamics - torque, else from the
    momentum balance.
    """
    return once_for_loads("foot loads", log, robot, lambda: _foot_loads_B(log, robot))


def _foot_loads_B(log: Log, robot: Robot) -> np.ndarray:
    if not log.has("tau") or not robot.limbs.point_feet:
        return momentum_balance(log, robot).force
    _, needed = rigid_body_wrench(log, robot)
    stands = log.contact
    J, taken = feet_jacobian_B(log, robot)[stands], (needed - log.tau)[:, robot.legs.joints]
    force = np.zeros((*stands.shape, 3))
    force[stands] = np.linalg.solve(np.swapaxes(J, 1, 2), taken[stands][..., None])[..., 0]
    return force
