"""How an IMU is mounted is known to a tolerance only; what that adds to an estimate's covariance.

A filter estimates the attitude of the axes along which the IMU measures, R_GS: gravity shows it
their tilt. What is asked for, and what a reference gives, is the attitude of the nominal frame I in
the body, R_GI = R_GS exp(-d^), whose d is small, constant, and nowhere in the filter. Its two
components across the vertical are lost in no alignment; the one about it is, as is yaw.
"""

from dataclasses import replace

import numpy as np

from surefoot.estimator.core.lie import hats
from surefoot.estimator.evaluation.trajectory import Trajectory

ACROSS = np.diag([1.0, 1.0, 0.0])
"""The axes of I about which a turned sensor shows as tilt, for a body that walks upright."""


def with_mounting(estimate: Trajectory, std: float) -> Trajectory:
    """The same estimate, its covariance that of the nominal frame I; std [rad] of d about x and y.

    Velocity and position stay what they are: p_bar - p = xi_p - [p_bar]x xi_R to first order, so
    the right-invariant error moves by (d_G, [v]x d_G, [p]x d_G) with d_G = R_GI d.
    """
    if estimate.covariance is None or std == 0.0:
        return estimate
    D = std**2 * estimate.R_GI @ ACROSS @ np.swapaxes(estimate.R_GI, 1, 2)
    unit = np.broadcast_to(np.eye(3), D.shape)
    J = np.concatenate([unit, hats(estimate.v_GI), hats(estimate.p_GI)], axis=1)
    covariance = estimate.covariance.copy()
    covariance[:, :9, :9] += J @ D @ np.swapaxes(J, 1, 2)
    return replace(estimate, covariance=covariance)
