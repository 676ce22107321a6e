"""The Gaussian velocity update: the invariant EKF correction with a body velocity."""

import numpy as np

from surefoot.estimator.core.checks import MOST_SPEED, all_within, definite_3, is_sound
from surefoot.estimator.updates.velocity_output import inverse_3, lift, velocity_output
from surefoot.sim.common.kernels import kernel

LEAST_RELATIVE_NOISE = 1e-8
"""Least noise relative to the prior's variances; with less, the remaining variances would result
from a cancellation of eight digits.
"""
ROUNDING = 1e-12
"""Share of the prior's variances that such an update keeps: some thousand roundings, so that the
result stays definite, and at most a ten-thousandth of its value.
"""


@kernel
def update_velocity(mean, covariance, contacts: int, v_I, measurement_cov) -> float:
    """Right-invariant EKF update of the packed state, in place (Hartley 2020, eq. 20).

    Returns the squared Mahalanobis distance of the innovation. In output space the posterior of z
    is N(S (S+R)^-1 r, S (S+R)^-1 R), which is lifted to the state as in the coverage update.

    Args:
        mean: (7+E, 3), the packed mean.
        covariance: (15+3E, 15+3E).
        contacts: number of contact points in the state.
        v_I: (3,) [m/s], measured velocity of the IMU in I.
        measurement_cov: (3, 3) [m^2/s^2], its covariance R.
    """
    n = covariance.shape[0]
    work = np.empty((n + 4, 3))
    PHt, S, residual = work[:n], work[n : n + 3], work[n + 3]
    velocity_output(mean, covariance, contacts, v_I, PHt, S, residual)
    return gaussian_update(mean, covariance, contacts, PHt, S, residual, measurement_cov)


@kernel
def gaussian_update(mean, covariance, contacts: int, PHt, S, residual, measurement_cov) -> float:
    """Kalman update for z = H delta X, in place.

    Returns the squared Mahalanobis distance of the innovation. K (z_cov - S) K^T is -Sigma H^T
    (S+R)^-1 H Sigma: lifting with W = S + R in the place of S, the posterior's covariance at zero
    and its mean at the innovation is the textbook update.

    Args:
        mean: (7+E, 3), the packed mean.
        covariance: (n, n), n = 15+3E.
        contacts: number of contact points in the state.
        PHt: (n, 3), Sigma H^T.
        S: (3, 3), H Sigma H^T.
        residual: (3,), the innovation.
        measurement_cov: (3, 3), covariance R of the measurement, in the unit of S.
    """
    work = np.zeros((3, 3, 3))
    W, information, nothing = work[0], work[1], work[2]
    much = LEAST_RELATIVE_NOISE * (S[0, 0] + S[1, 1] + S[2, 2])
    exact = False
    for i in range(3):
        exact |= measurement_cov[i, i] < much
        for j in range(3):
            W[i, j] = S[i, j] + measurement_cov[i, j]
    before = np.diag(covariance).copy() if exact else residual
    inverse_3(W, information)
    lift(mean, covariance, contacts, PHt, W, residual, nothing)
    if exact:
        for i in range(before.shape[0]):
            covariance[i, i] += ROUNDING * before[i]
    distance = 0.0
    for i in range(3):
        for j in range(3):
            distance += residual[i] * information[i, j] * residual[j]
    return distance


# Checks and update in one call, like `propagate_checked`, for a robot's own loop.
UPDATE_VELOCITY_CHECKED = "f8(f8[:,::1], f8[:,::1], i8, f8[::1], f8[:,::1])"


@kernel
def update_velocity_checked(mean, covariance, contacts, v_I, cov) -> float:
    """`update_velocity` with checks of measurement and state; returns -1, with nothing changed, if
    they fail.

    Args:
        mean: (7+E, 3), the packed mean.
        covariance: (15+3E, 15+3E).
        contacts: number of contact points in the state.
        v_I: (3,) [m/s] in I, within MOST_SPEED.
        cov: (3, 3) [m^2/s^2], positive definite.
    """
    if v_I.shape[0] != 3 or not all_within(v_I, MOST_SPEED):
        return -1.0
    if cov.shape != (3, 3) or not definite_3(cov) or not is_sound(mean, covariance):
        return -1.0
    return update_velocity(mean, covariance, contacts, v_I, cov)
