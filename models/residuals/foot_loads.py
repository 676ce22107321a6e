"""Load on each foot in each row."""

import numpy as np

from surefoot.models.residuals.binning import Bins, ReferenceMotion, at_torques
from surefoot.models.residuals.torques import DynamicsInputs
from surefoot.sim.common.gravity import GRAVITY_G
from surefoot.sim.common.kernels import kernel
from surefoot.sim.log import Log
from surefoot.sim.physics.momentum_balance import once_for_loads
from surefoot.sim.robot import Robot
from surefoot.sim.robot.kinematics import leg_forward


def foot_loads(
    log: Log, robot: Robot, motion: ReferenceMotion, bins: Bins, steps: DynamicsInputs
) -> np.ndarray:
    """Force (N, legs) [N] along the ground's normal on each standing foot, zero on the others.

    J^T f = inverse dynamics - measured torque, the former as means over bins. Without torques, or
    for legs with other than three joints, the standing feet share the weight evenly.

    Args:
        log: the measured log.
        robot: as declared.
        motion: reference motion of the log.
        bins: means over bins of torques and standing feet.
        steps: inputs of inverse dynamics.
    """

    def made() -> np.ndarray:
        stands = log.contact
        if not np.isfinite(bins.tau).any() or not robot.limbs.point_feet:
            weight = -GRAVITY_G[2] * (robot.mass + robot.extras.payload)
            return weight * stands / np.maximum(stands.sum(axis=1, keepdims=True), 1)
        _, taken = robot.dynamics.inverse(steps.q, steps.dq, steps.ddq, steps.base)
        every = np.ones_like(bins.standing)
        from_motion = normal_forces(robot.legs, steps.q, steps.up_B, every, taken)
        up_B = motion.normal_I @ robot.R_BI.T
        motor = normal_forces(robot.legs, at_torques(log.q, motion), up_B, stands, log.tau)
        rows = np.column_stack([np.interp(log.t, bins.t, one) for one in from_motion.T])
        return np.where(stands, np.maximum(rows - motor, 0.0), 0.0)

    given = motion, robot.extras.payload
    return once_for_loads("foot loads along the normal", log, robot, made, *given)


@kernel
def normal_forces(legs, q, up, stands, torque):
    """n . f (N, legs) [N] with J^T f = torque, of standing feet.

    q, torque (N, joints), up (N, 3) in B, stands (N, legs).
    """
    out = np.zeros(stands.shape)
    foot, J, axes = np.empty(3), np.empty((3, 3)), np.empty((3, 3))
    for k in range(len(q)):
        for leg in range(stands.shape[1]):
            if not stands[k, leg]:
                continue
            leg_forward(legs, leg, q[k], foot, J, axes)
            # n . f = torque . J^-1 n, by Cramer's rule.
            volume, along = 0.0, 0.0
            for j in range(3):
                one, two = (j + 1) % 3, (j + 2) % 3
                for a in range(3):
                    b, c = (a + 1) % 3, (a + 2) % 3
                    normal = J[b, one] * J[c, two] - J[c, one] * J[b, two]
                    along += torque[k, legs.joints[leg, j]] * normal * up[k, a]
                    if j == 0:
                        volume += J[a, 0] * normal
            if volume != 0.0:  # a leg so straight that its torques do not depend on its load
                out[k, leg] = along / volume
    return out
