"""Contribution of the IMU's mounting tolerance to an estimate's covariance.

A filter estimates the attitude R_GS of the axes along which the IMU measures, whose tilt gravity
reveals. A reference gives the attitude of the nominal frame I in the body, R_GI = R_GS exp(-d^),
where d is small, constant, and not part of the filter. Alignment cannot remove the two components
of d across the vertical; it does remove the one about it, as it does yaw.
"""

from dataclasses import replace

import numpy as np

from surefoot.estimator.core.lie import hats
from surefoot.estimator.evaluation.trajectory import Trajectory

ACROSS = np.diag([1.0, 1.0, 0.0])
"""Axes of I about which a mounting error appears as tilt, for an upright body."""


def with_mounting(estimate: Trajectory, std: float) -> Trajectory:
    """The same estimate with the covariance for the nominal frame I; std [rad] of d about x and y.

    Velocity and position are unchanged: p_bar - p = xi_p - [p_bar]x xi_R to first order, so the
    right-invariant error moves by (d_G, [v]x d_G, [p]x d_G) with d_G = R_GI d.
    """
    if estimate.covariance is None or std == 0.0:
        return estimate
    D = std**2 * estimate.R_GI @ ACROSS @ np.swapaxes(estimate.R_GI, 1, 2)
    unit = np.broadcast_to(np.eye(3), D.shape)
    J = np.concatenate([unit, hats(estimate.v_GI), hats(estimate.p_GI)], axis=1)
    covariance = estimate.covariance.copy()
    covariance[:, :9, :9] += J @ D @ np.swapaxes(J, 1, 2)
    return replace(estimate, covariance=covariance)
