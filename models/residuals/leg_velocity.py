"""Velocity of the body from the kinematics of each standing foot."""

import numpy as np

from surefoot.sim.common.kernels import kernel
from surefoot.sim.log import Log, foot_velocity, joint_velocity
from surefoot.sim.robot import Robot
from surefoot.sim.robot.given_feet import GivenFeet, Walker
from surefoot.sim.robot.kinematics import leg_forward


def leg_velocity_of(
    log: Log, robot: Walker, omega: np.ndarray, up: np.ndarray, standing: np.ndarray
) -> np.ndarray:
    """Velocity of the IMU in I (N, L, 3) [m/s] by each standing foot of a log; NaN for the others.

    Args:
        log: with joint angles, or with positions of the feet where the machine is known by these.
        robot: the machine.
        omega: rate (N, 3) [rad/s] of the IMU, in I.
        up: the ground's unit normal (N, 3) in I.
        standing: feet (N, L) for which to compute it.
    """
    if isinstance(robot, GivenFeet):
        return velocity_by_feet(log.foot_I, foot_velocity(log), omega, standing)
    return leg_velocity(robot, log.q, joint_velocity(log), omega, up, standing)


def velocity_by_feet(
    feet_I: np.ndarray, rates_I: np.ndarray, omega: np.ndarray, standing: np.ndarray
) -> np.ndarray:
    """Velocity of the IMU in I (N, L, 3) [m/s] by each standing point foot; NaN for the others.

    A foot that does not move over the ground gives v_I = -rate - omega x foot.

    Args:
        feet_I: positions (N, L, 3) [m] in I.
        rates_I: their derivatives (N, L, 3) [m/s].
        omega: rate (N, 3) [rad/s] of the IMU, in I.
        standing: feet (N, L) for which to compute it.
    """
    v_I = -rates_I - np.cross(omega[:, None], feet_I)
    return np.where(standing[..., None], v_I, np.nan)


def leg_velocity(
    robot: Robot,
    q: np.ndarray,
    dq: np.ndarray,
    omega: np.ndarray,
    up: np.ndarray,
    standing: np.ndarray,
) -> np.ndarray:
    """Velocity of the IMU in I (N, legs, 3) [m/s] by each standing foot; NaN for the others.

    Args:
        robot: legs, radius of the feet, mounting of the IMU.
        q: angles (N, J) [rad].
        dq: rates (N, J) [rad/s].
        omega: rate (N, 3) [rad/s] of the IMU, in I.
        up: the ground's unit normal (N, 3) in I.
        standing: feet (N, legs) for which to compute it.
    """
    # Contiguous, so that it is compiled once.
    rows = (np.ascontiguousarray(x) for x in (q, dq, omega, up, standing))
    return _leg_velocity(robot.legs, robot.foot_radius, robot.R_BI, robot.p_BI, *rows)


@kernel
def _leg_velocity(legs, radius, R_BI, p_BI, q, dq, omega, up, standing):
    """Velocity (M, L, 3) [m/s] of the IMU in I by each standing leg; NaN for the others.

    Args:
        legs: geometry of the legs, as of `leg_forward`.
        radius: (L,) [m], of the feet.
        R_BI: (3, 3), mounting of the IMU.
        p_BI: (3,) [m], its origin in B.
        q: (M, J) [rad].
        dq: (M, J) [rad/s].
        omega: (M, 3) [rad/s] in I.
        up: (M, 3), the ground's normal in I.
        standing: (M, L) bool.
    """
    out = np.full((len(q), standing.shape[1], 3), np.nan)
    most = legs.q_zero.shape[1]
    foot, J, axes = np.empty(3), np.empty((3, most)), np.empty((3, most))
    sole, spin, step = np.empty(3), np.empty(3), np.empty(3)
    for k in range(len(q)):
        # In B from here on, like the legs; the result is rotated back into I.
        for a in range(3):
            sole[a] = R_BI[a, 0] * up[k, 0] + R_BI[a, 1] * up[k, 1] + R_BI[a, 2] * up[k, 2]
            spin[a] = R_BI[a, 0] * omega[k, 0] + R_BI[a, 1] * omega[k, 1] + R_BI[a, 2] * omega[k, 2]
        for leg in range(standing.shape[1]):
            if not standing[k, leg]:
                continue
            leg_forward(legs, leg, q[k], foot, J, axes)
            r = radius[leg]
            for a in range(3):
                b, c = (a + 1) % 3, (a + 2) % 3
                v = 0.0
                # omega x (r n - (foot - p_BI)), then omega_foot x r n and J dq, joint by joint
                v += spin[b] * (r * sole[c] - foot[c] + p_BI[c])
                v -= spin[c] * (r * sole[b] - foot[b] + p_BI[b])
                for j in range(legs.joint_count[leg]):
                    roll = r * (axes[b, j] * sole[c] - axes[c, j] * sole[b])
                    v += dq[k, legs.joints[leg, j]] * (roll - J[a, j])
                step[a] = v
            for a in range(3):
                out[k, leg, a] = R_BI[0, a] * step[0] + R_BI[1, a] * step[1] + R_BI[2, a] * step[2]
    return out
