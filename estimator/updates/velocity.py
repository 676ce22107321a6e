"""Measured body velocities: output space, outliers, lift to the error state, Gaussian update.

The IMU's velocity in I is a right-invariant output (eq. meas_model), y = X^-1 d, with

    H = [0  -R_GI^T  0  0  0],     z = H delta X = v_I - v_I_bar to first order,

and an additional -I on the error of a plain extra vector c where the measurement is v_I + c: the
persistent part of an observer's error, which is three more states.

Outliers are errors larger than any in the calibration. As pi -> 0, Theorem 1 moves gamma of the
mass into a box however far away: the statement overrides the prior. The covariance grows with the
square of the distance, so outliers that are proportional to it (40 of the filter's own deviations,
twice within a second) amplify each other, and the biases, without bound. Yet an error larger than
all of n calibration samples (`max_error`) had a probability of at most 1/(n+1) there, about which
gamma says nothing. A measurement is rejected if no state within 3.3 deviations of the estimate
explains it by an error within max_error, unless this continues: then the estimate is wrong. This
goes beyond the paper.
"""

from typing import NamedTuple

import numpy as np
from numba import types

from surefoot.estimator.core.checks import MOST_SPEED, all_within, is_sound, symmetric_definite
from surefoot.estimator.core.state import EXTRA, V, retract
from surefoot.estimator.evaluation.innovation_sums import LEFT_OUT, add_innovation
from surefoot.sim.common.copies import copy_row
from surefoot.sim.common.kernels import GIVEN_1, GIVEN_2, OWN_1, OWN_2, kernel

SIGMAS = 3.3
"""Deviations of the estimate that are allowed before a measurement is an outlier."""
UNLIMITED = np.full(3, np.inf)
"""A max_error that rejects nothing."""
LEAST_RELATIVE_NOISE = 1e-8
"""Least noise relative to the prior's variances; with less, the remaining variances would result
from a cancellation of eight digits.
"""
ROUNDING = 1e-12
"""Share of the prior's variances that such an update keeps: some thousand roundings, so that the
result stays definite, and at most a ten-thousandth of its value.
"""

GATHERED, REJECTED = 0, 1
"""Indices into `VelocityMemory.counts`: measurements in the window so far, and rejected in a row.
"""


class VelocityMemory(NamedTuple):
    """State of a filter's velocity updates, and the sizes that they depend on.

    Attributes:
        max_error: error (3,) [m/s] beyond which a measurement is an outlier.
        window: number of measurements in a window; as many are rejected in a row at most.
        counts: (2,), see GATHERED and REJECTED, in place.
        innovation: (4, 3), in place: H Sigma H^T of the last measurement, and its residual.
    """

    max_error: np.ndarray
    window: int
    counts: np.ndarray
    innovation: np.ndarray


def velocity_memory(max_error: np.ndarray = UNLIMITED, window: int = 1) -> VelocityMemory:
    """Memory of a filter without measurements."""
    return VelocityMemory(max_error, window, np.zeros(2, dtype=np.int64), np.zeros((4, 3)))


@kernel
def is_outlier(S, residual, memory) -> bool:
    """Whether to reject a measurement; updates the counts of the VelocityMemory.

    Args:
        S: prior covariance (3, 3) of the measured velocity, [m^2/s^2].
        residual: measured minus predicted (3,) [m/s].
        memory: of the filter.
    """
    counts = memory.counts
    for i in range(3):
        if abs(residual[i]) > memory.max_error[i] + SIGMAS * np.sqrt(S[i, i]):
            counts[REJECTED] += 1
            return counts[REJECTED] <= memory.window
    counts[REJECTED] = 0
    return False


@kernel(inline="always")
def no_contacts() -> np.int64:
    """Number of contact points in a state without any.

    A kernel that is called with the literal 0 is compiled once more, for that number.
    """
    return np.int64(0)


@kernel
def velocity_output(mean, covariance, contacts: int, v_I, PHt, S, residual):
    """Predicted output of a velocity measurement, with a persistent part where the state has one.

    Args:
        mean: (7+E, 3), the packed mean.
        covariance: (n, n), n = 15+3E.
        contacts: number of contact points in the state.
        v_I: (3,) [m/s], measured velocity of the IMU in I.
        PHt: (n, 3), filled with Sigma H^T.
        S: (3, 3) [m^2/s^2], filled with H Sigma H^T.
        residual: (3,) [m/s], filled with v_I - v_I_bar, minus the persistent part.
    """
    n = covariance.shape[0]
    persistent = EXTRA + contacts < mean.shape[0]
    at = 15 + 3 * contacts
    for i in range(n):
        for j in range(3):
            total = 0.0
            for m in range(3):
                total -= covariance[i, 3 + m] * mean[m, j]
            if persistent:
                total -= covariance[i, at + j]
            PHt[i, j] = total
    for j in range(3):
        residual[j] = v_I[j]
        for m in range(3):
            residual[j] -= mean[m, j] * mean[V, m]
        if persistent:
            residual[j] -= mean[EXTRA + contacts, j]
        for k in range(3):
            total = 0.0
            for m in range(3):
                total -= mean[m, j] * PHt[3 + m, k]
            if persistent:
                total -= PHt[at + j, k]
            S[j, k] = total
    for j in range(3):
        for k in range(j):
            S[j, k] = S[k, j] = 0.5 * (S[j, k] + S[k, j])


@kernel
def add_velocity(sums, memory, measurement_cov):
    """Add the last measurement to its sensor's sums (10,), in place.

    An outlier after too many in a row was used, but still counts as left out.

    Args:
        sums: of the sensor (10,).
        memory: VelocityMemory.
        measurement_cov: (3, 3) [m^2/s^2], covariance R of the measurement.
    """
    if memory.counts[REJECTED] > 0:
        sums[LEFT_OUT] += 1.0
        return
    S, residual = memory.innovation[:3], memory.innovation[3]
    work = np.empty((2, 3, 3))
    for i in range(3):
        for j in range(3):
            work[0, i, j] = S[i, j] + measurement_cov[i, j]
    inverse_3(work[0], work[1])
    add_innovation(sums, squared_size(residual, work[1]), residual, S, measurement_cov)


@kernel
def squared_size(x, information) -> float:
    """Squared Mahalanobis length of x (3,), by the inverse (3, 3) of its covariance."""
    total = 0.0
    for i in range(3):
        for j in range(3):
            total += x[i] * information[i, j] * x[j]
    return total


@kernel
def inverse_3(S, out):
    """out = S^-1 for a symmetric positive definite S (3, 3), independent of the scale of its axes.

    By S = L D L^T: two nearly dependent axes leave 1e-20 of the determinant, which cofactors lose.
    """
    s0, s1, s2 = 1.0 / np.sqrt(S[0, 0]), 1.0 / np.sqrt(S[1, 1]), 1.0 / np.sqrt(S[2, 2])
    a, b, c = S[0, 1] * s0 * s1, S[0, 2] * s0 * s2, S[1, 2] * s1 * s2
    d1 = 1.0 - a * a
    l21 = (c - a * b) / d1
    d2 = 1.0 - b * b - l21 * l21 * d1
    m20 = a * l21 - b
    w1, w2 = 1.0 / d1, 1.0 / d2
    out[0, 0] = (1.0 + a * a * w1 + m20 * m20 * w2) * s0 * s0
    out[1, 1] = (w1 + l21 * l21 * w2) * s1 * s1
    out[2, 2] = w2 * s2 * s2
    out[0, 1] = out[1, 0] = -(a * w1 + m20 * l21 * w2) * s0 * s1
    out[0, 2] = out[2, 0] = m20 * w2 * s0 * s2
    out[1, 2] = out[2, 1] = -l21 * w2 * s1 * s2


@kernel
def lift(mean, covariance, contacts: int, PHt, S, z_mean, z_cov):
    """Eqs. lift_mean and lift_cov with K = Sigma H^T S^-1, then the on-manifold update, in place.

    Returns S^-1 (3, 3).

    Args:
        mean: (7+E, 3), the packed mean.
        covariance: (n, n), n = 15+3E, symmetric.
        contacts: number of contact points in the state.
        PHt: (n, 3), Sigma H^T.
        S: (3, 3), covariance of the prior N(0, S) of z.
        z_mean: (3,), posterior mean of z.
        z_cov: (3, 3), its posterior covariance.
    """
    n = covariance.shape[0]
    # One allocation for all arrays: several are slower than the arithmetic.
    work = np.empty((n + 3, 7))
    delta, H = work[:n, 6], work[n:]
    information = np.empty((3, 3))
    inverse_3(S, information)
    for i in range(3):
        for j in range(3):
            H[i, j] = 0.5 * (S[i, j] + z_cov[i, j])
    # Sigma + K (z_cov - S) K^T in Joseph's form, with rows k of K and d = PHt - k (S + z_cov)/2: so
    # it is stationary in K, and an error of K, from inverting a nearly singular S, enters
    # quadratically.
    for i in range(n):
        p0, p1, p2 = PHt[i, 0], PHt[i, 1], PHt[i, 2]
        k0 = p0 * information[0, 0] + p1 * information[1, 0] + p2 * information[2, 0]
        k1 = p0 * information[0, 1] + p1 * information[1, 1] + p2 * information[2, 1]
        k2 = p0 * information[0, 2] + p1 * information[1, 2] + p2 * information[2, 2]
        d0 = p0 - k0 * H[0, 0] - k1 * H[1, 0] - k2 * H[2, 0]
        d1 = p1 - k0 * H[0, 1] - k1 * H[1, 1] - k2 * H[2, 1]
        d2 = p2 - k0 * H[0, 2] - k1 * H[1, 2] - k2 * H[2, 2]
        row = work[i]
        row[0], row[1], row[2], row[3], row[4], row[5] = k0, k1, k2, d0, d1, d2
        delta[i] = k0 * z_mean[0] + k1 * z_mean[1] + k2 * z_mean[2]
        for j in range(i + 1):
            g = work[j]
            value = covariance[i, j] - (
                (k0 * g[3] + d0 * g[0]) + (k1 * g[4] + d1 * g[1]) + (k2 * g[5] + d2 * g[2])
            )
            covariance[i, j] = value
            covariance[j, i] = value
    retract(mean, delta, contacts)
    return information


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
    work = np.empty((2, 3, 3))
    W, nothing = work[0], work[1]
    much = LEAST_RELATIVE_NOISE * (S[0, 0] + S[1, 1] + S[2, 2])
    exact = False
    for i in range(3):
        exact |= measurement_cov[i, i] < much
        for j in range(3):
            W[i, j] = S[i, j] + measurement_cov[i, j]
            nothing[i, j] = 0.0
    before = np.diag(covariance).copy() if exact else residual
    information = lift(mean, covariance, contacts, PHt, W, residual, nothing)
    if exact:
        for i in range(before.shape[0]):
            covariance[i, i] += ROUNDING * before[i]
    return squared_size(residual, information)


@kernel
def update_velocity(mean, covariance, contacts: int, v_I, measurement_cov, memory) -> float:
    """Right-invariant EKF update of the packed state, in place (Hartley 2020, eq. 20).

    Returns the squared Mahalanobis distance of the innovation; nan, with the state unchanged, for
    an outlier. In output space the posterior of z is N(S (S+R)^-1 r, S (S+R)^-1 R), which is lifted
    to the state as in the coverage update.

    Args:
        mean: (7+E, 3), the packed mean.
        covariance: (15+3E, 15+3E).
        contacts: number of contact points in the state.
        v_I: (3,) [m/s], measured velocity of the IMU in I.
        measurement_cov: (3, 3) [m^2/s^2], its covariance R or, with a persistent part, that of its
            mixing error.
        memory: VelocityMemory.
    """
    S, residual = memory.innovation[:3], memory.innovation[3]
    PHt = np.empty((covariance.shape[0], 3))
    velocity_output(mean, covariance, contacts, v_I, PHt, S, residual)
    if is_outlier(S, residual, memory):
        return np.nan
    return gaussian_update(mean, covariance, contacts, PHt, S, residual, measurement_cov)


LIMITS = OWN_1, types.int64, types.int64[::1]
"""Types of the first three of a VelocityMemory: a whole one would cost a microsecond in a call."""
UPDATE_VELOCITY = types.float64(OWN_2, OWN_2, types.int64, GIVEN_1, GIVEN_2, *LIMITS)
"""Signature of `update_velocity_checked`."""


@kernel
def update_velocity_checked(
    mean, covariance, contacts: int, v_I, measurement_cov, max_error, window: int, counts
) -> float:
    """`update_velocity` for a robot's own loop, in one call.

    Checks measurement and state; returns -1, with nothing changed, if they fail.

    Args:
        mean: (7+E, 3), the packed mean.
        covariance: (15+3E, 15+3E).
        contacts: number of contact points in the state.
        v_I: (3,) [m/s] in I, within MOST_SPEED.
        measurement_cov: (3, 3) [m^2/s^2], positive definite.
        max_error: of the VelocityMemory, as are window and counts.
        window: likewise.
        counts: likewise.
    """
    if v_I.shape[0] != 3 or measurement_cov.shape != (3, 3) or not all_within(v_I, MOST_SPEED):
        return -1.0
    given = np.empty((8, 3))
    R, v = given[:3], given[3]
    if not symmetric_definite(measurement_cov, R) or not is_sound(mean, covariance):
        return -1.0
    copy_row(v_I, v)
    memory = VelocityMemory(max_error, window, counts, given[4:])
    return update_velocity(mean, covariance, contacts, v, R, memory)
