"""What only a simulation knows: the speed of each loaded foot over the ground, and its friction."""

import numpy as np
from numba import njit

from sim.kinematics import leg_forward
from sim.relief import normal
from sim.robot import Robot
from sim.sensors import Motion
from sim.terrain import Ground

LOADED = 0.02  # of the robot's weight, on one foot


def foot_truth(motion: Motion, robot: Robot, ground: Ground) -> tuple[np.ndarray, np.ndarray]:
    """Per row and leg: speed of the loaded foot's contact point over the ground [m/s], and mu.

    A rolling foot does not slip: the speed is that of its contact point, not of its centre.
    """
    slip, touching = _soles(
        robot.legs, ground.relief, robot.foot_radius, motion.q[1:], motion.dq[1:],
        motion.p_GB[1:], motion.R_GB[1:], motion.v_GB[1:], motion.w_B[1:],
    )  # fmt: skip
    slip[motion.force <= LOADED * robot.mass * 9.81] = 0.0
    return slip, ground.friction(touching[..., 0], touching[..., 1])


@njit(cache=True, nogil=True)
def _soles(legs, relief, radius, q, dq, p, R, v, w):
    """Speeds (N, 4) along the ground of the feet's contact points, and these points (N, 4, 2)."""
    n = len(p)
    f, J, Z = np.empty(3), np.empty((3, 3)), np.empty((3, 3))
    speed, touching = np.empty((n, 4)), np.empty((n, 4, 2))
    arm, velocity, spin = np.empty(3), np.empty(3), np.empty(3)
    for k in range(n):
        for leg in range(4):
            rate = dq[k, 3 * leg : 3 * leg + 3]
            leg_forward(legs, leg, q[k, 3 * leg : 3 * leg + 3], f, J, Z)
            wx, wy, wz = w[k, 0], w[k, 1], w[k, 2]
            vx = wy * f[2] - wz * f[1] + J[0, 0] * rate[0] + J[0, 1] * rate[1] + J[0, 2] * rate[2]
            vy = wz * f[0] - wx * f[2] + J[1, 0] * rate[0] + J[1, 1] * rate[1] + J[1, 2] * rate[2]
            vz = wx * f[1] - wy * f[0] + J[2, 0] * rate[0] + J[2, 1] * rate[1] + J[2, 2] * rate[2]
            wx += Z[0, 0] * rate[0] + Z[0, 1] * rate[1] + Z[0, 2] * rate[2]
            wy += Z[1, 0] * rate[0] + Z[1, 1] * rate[1] + Z[1, 2] * rate[2]
            wz += Z[2, 0] * rate[0] + Z[2, 1] * rate[1] + Z[2, 2] * rate[2]
            for a in range(3):
                r = R[k, a]
                arm[a] = r[0] * f[0] + r[1] * f[1] + r[2] * f[2]
                velocity[a] = v[k, a] + r[0] * vx + r[1] * vy + r[2] * vz
                spin[a] = r[0] * wx + r[1] * wy + r[2] * wz
            x, y, z = normal(relief, p[k, 0] + arm[0], p[k, 1] + arm[1])
            # The contact point lies below the centre along the ground's normal, not along gravity.
            s = -radius[leg]
            vx = velocity[0] + s * (spin[1] * z - spin[2] * y)
            vy = velocity[1] + s * (spin[2] * x - spin[0] * z)
            vz = velocity[2] + s * (spin[0] * y - spin[1] * x)
            up = vx * x + vy * y + vz * z
            speed[k, leg] = np.sqrt((vx - up * x) ** 2 + (vy - up * y) ** 2 + (vz - up * z) ** 2)
            touching[k, leg, 0] = p[k, 0] + arm[0] + s * x
            touching[k, leg, 1] = p[k, 1] + arm[1] + s * y
    return speed, touching
