"""The Gaussian velocity update: the invariant EKF correction with a body velocity."""

import numpy as np
from numba import types

from surefoot.estimator.core.checks import MOST_SPEED, all_within, is_sound, symmetric_definite
from surefoot.estimator.updates.outliers import is_outlier
from surefoot.estimator.updates.velocity_output import (
    inverse_3,
    lift_with,
    no_contacts,
    velocity_output,
)
from surefoot.sim.common.copies import copy_row
from surefoot.sim.common.kernels import GIVEN_1, GIVEN_2, OWN_1, OWN_2, kernel

LEAST_RELATIVE_NOISE = 1e-8
"""Least noise relative to the prior's variances; with less, the remaining variances would result
from a cancellation of eight digits.
"""
ROUNDING = 1e-12
"""Share of the prior's variances that such an update keeps: some thousand roundings, so that the
result stays definite, and at most a ten-thousandth of its value.
"""


@kernel(inline="always")
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


@kernel(inline="always")
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
    work = np.empty((3, 3, 3))
    W, information, nothing = work[0], work[1], work[2]
    much = LEAST_RELATIVE_NOISE * (S[0, 0] + S[1, 1] + S[2, 2])
    exact = False
    for i in range(3):
        exact |= measurement_cov[i, i] < much
        for j in range(3):
            W[i, j] = S[i, j] + measurement_cov[i, j]
            nothing[i, j] = 0.0
    before = np.diag(covariance).copy() if exact else residual
    inverse_3(W, information)
    lift_with(information, mean, covariance, contacts, PHt, W, residual, nothing)
    if exact:
        for i in range(before.shape[0]):
            covariance[i, i] += ROUNDING * before[i]
    distance = 0.0
    for i in range(3):
        for j in range(3):
            distance += residual[i] * information[i, j] * residual[j]
    return distance


@kernel
def update_velocity_unless_outlier(
    mean, covariance, v_I, measurement_cov, max_error, most: int, counts
) -> float:
    """`update_velocity` of a state without contacts, which may have a persistent part; nan, with
    the state unchanged, for an outlier.

    Args:
        mean: (7+E, 3), the packed mean.
        covariance: (15+3E, 15+3E).
        v_I: (3,) [m/s], measured velocity of the IMU in I.
        measurement_cov: (3, 3) [m^2/s^2], its covariance R or, with a persistent part, that of its
            mixing error.
        max_error: beyond which an error is an outlier (3,) [m/s].
        most: number rejected in a row, after which a measurement is accepted.
        counts: of the filter (2,), see `surefoot.estimator.updates.outliers`.
    """
    contacts, n = no_contacts(), covariance.shape[0]
    PHt, S, residual = np.empty((n, 3)), np.empty((3, 3)), np.empty(3)
    velocity_output(mean, covariance, contacts, v_I, PHt, S, residual)
    if is_outlier(S, residual, max_error, most, counts):
        return np.nan
    return gaussian_update(mean, covariance, contacts, PHt, S, residual, measurement_cov)


UPDATE_VELOCITY = types.float64(
    OWN_2, OWN_2, GIVEN_1, GIVEN_2, OWN_1, types.int64, types.int64[::1]
)
"""Signature of `update_velocity_checked`."""


@kernel
def update_velocity_checked(
    mean, covariance, v_I, measurement_cov, max_error, most: int, counts
) -> float:
    """`update_velocity_unless_outlier` for a robot's own loop, in one call.

    Checks measurement and state; returns -1, with nothing changed, if they fail.

    Args:
        mean: (7+E, 3), the packed mean.
        covariance: (15+3E, 15+3E).
        v_I: (3,) [m/s] in I, within MOST_SPEED.
        measurement_cov: (3, 3) [m^2/s^2], positive definite.
        max_error: beyond which an error is an outlier (3,) [m/s].
        most: number rejected in a row, after which a measurement is accepted.
        counts: of the filter (2,), see `surefoot.estimator.updates.outliers`.
    """
    if v_I.shape[0] != 3 or measurement_cov.shape != (3, 3) or not all_within(v_I, MOST_SPEED):
        return -1.0
    given = np.empty((4, 3))
    R, v = given[:3], given[3]
    if not symmetric_definite(measurement_cov, R) or not is_sound(mean, covariance):
        return -1.0
    copy_row(v_I, v)
    return update_velocity_unless_outlier(mean, covariance, v, R, max_error, most, counts)
