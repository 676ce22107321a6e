"""Truth of a simulation: the speed of each loaded foot over the ground, and the friction under
it.
"""

import numpy as np

from surefoot.sim.common.gravity import GRAVITY
from surefoot.sim.common.kernels import kernel
from surefoot.sim.ground.height_map import normal
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.robot import Robot
from surefoot.sim.robot.kinematics import (
    BaseMotion,
    FootMotion,
    foot_motion,
    leg_forward,
    sole_motion,
)
from surefoot.sim.sensors.streams import Motion

LOADED = 0.02  # of the robot's weight, on one foot
SLIPPING = 0.05
"""Speed over the ground from which a loaded foot slips [m/s]."""


def foot_truth(motion: Motion, robot: Robot, ground: Ground) -> tuple[np.ndarray, np.ndarray]:
    """Speed of each loaded foot's contact point over the ground [m/s], and mu, per row and leg.

    A rolling foot does not slip, since its contact point does not move over the ground.
    """
    # Contiguous, like the arrays of the controller: `leg_forward` is compiled once for both.
    p, R, v, w, q, dq = (
        np.ascontiguousarray(x[1:])
        for x in (motion.p_GB, motion.R_GB, motion.v_GB, motion.w_B, motion.q, motion.dq)
    )
    bases = BaseMotion(p, R, v, w)
    slid, rate = np.zeros((2, 0, *robot.legs.foot.shape))
    if motion.give is not None:
        joints, joint_rates, slid, rate = (part[1:] for part in motion.give)
        q, dq = q + joints, dq + joint_rates
    own = robot.legs._replace(foot=robot.legs.foot.copy())
    slip, touching = _soles(own, ground.height_map, robot.foot_radius, bases, q, dq, slid, rate)
    slip[motion.force <= LOADED * robot.mass * GRAVITY] = 0.0
    return slip, ground.friction(touching[..., 0], touching[..., 1])


@kernel(nogil=True)
def _soles(legs, height_map, radius, bases, q, dq, slid, slid_rate):
    """Speeds (N, 4) of the feet's contact points along the ground, and the positions of these (N,
    4, 2).

    Args:
        legs, height_map, radius: of robot and ground, radius (4,) [m]; legs.foot is scratch.
        bases: a BaseMotion of N rows.
        q, dq: (N, 12) rad, rad/s.
        slid, slid_rate: displacement of the feet relative to their links, in the links' frames, and
            its rate (N, 4, 3) [m, m/s]; empty if they are fixed.
    """
    p, R, v, w = bases
    n = len(p)
    speed, touching = np.empty((n, 4)), np.empty((n, 4, 2))
    foot, J, axes, jacobian = np.empty(3), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    place, velocity, spin, up = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    sole_v, on_link, ahead = np.empty(3), legs.foot.copy(), np.empty(3)
    motion = FootMotion(place, velocity, jacobian, spin)
    for k in range(n):
        base = BaseMotion(p[k], R[k], v[k], w[k])
        for leg in range(4):
            own = slice(3 * leg, 3 * leg + 3)
            if len(slid):
                # A foot's place in B is linear in that on its link.
                for a in range(3):
                    legs.foot[leg, a] = on_link[leg, a] + slid[k, leg, a] + slid_rate[k, leg, a]
                leg_forward(legs, leg, q[k], ahead, J, axes)
                for a in range(3):
                    legs.foot[leg, a] = on_link[leg, a] + slid[k, leg, a]
            leg_forward(legs, leg, q[k], foot, J, axes)
            foot_motion(base, dq[k, own], foot, J, axes, motion)
            if len(slid):
                for a in range(3):
                    ahead[a] -= foot[a]
                moved = R[k] @ ahead
                for a in range(3):
                    velocity[a] += moved[a]
            up[0], up[1], up[2] = normal(height_map, place[0], place[1])
            # The contact point lies below the centre along the ground's normal, not along gravity.
            sole_motion(velocity, spin, radius[leg], up, sole_v)
            rise = sole_v[0] * up[0] + sole_v[1] * up[1] + sole_v[2] * up[2]
            square = 0.0
            for a in range(3):
                square += (sole_v[a] - rise * up[a]) ** 2
            speed[k, leg] = np.sqrt(square)
            touching[k, leg, 0] = place[0] - radius[leg] * up[0]
            touching[k, leg, 1] = place[1] - radius[leg] * up[1]
    return speed, touching
