"""Loads on a robot's joints and feet in each row, from motor torques or from the motion."""

import numpy as np

from surefoot.sim.log import Log, joint_velocity
from surefoot.sim.log.derived import derivative
from surefoot.sim.physics.momentum_balance import (
    ACCELERATION_WINDOW,
    feet_jacobian_B,
    momentum_balance,
    once_for_loads,
    rigid_body_wrench,
)
from surefoot.sim.robot import Robot
from surefoot.sim.robot.machine import Modelled

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
