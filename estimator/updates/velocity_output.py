"""Output space of the body velocity, and the lift from it to the error state.

The IMU's velocity in I is a right-invariant output (eq. meas_model), y = X^-1 d, with

    H = [0  -R_GI^T  0  0  0],     z = H delta X = v_I - v_I_bar to first order,

and an additional -I on the error of a plain extra vector c where the measurement is v_I + c: the
persistent part of an observer's error, which is three more states.
"""

import numpy as np

from surefoot.estimator.core.state import EXTRA, V, retract
from surefoot.estimator.evaluation.innovation_sums import add_innovation, add_rejected
from surefoot.sim.common.kernels import kernel


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
def note_velocity(mean, covariance, contacts: int, v_I, measurement_cov, note):
    """Innovation of a velocity measurement before its update, for the record of innovations.

    Args:
        mean: (7+E, 3), the packed mean.
        covariance: (n, n), n = 15+3E.
        contacts: number of contact points in the state.
        v_I: (3,) [m/s], measured velocity of the IMU in I.
        measurement_cov: (3, 3) [m^2/s^2], its covariance R.
        note: (7, 3), filled with the residual, S and R, in rows 0, 1 to 3 and 4 to 6.
    """
    persistent = EXTRA + contacts < mean.shape[0]
    at = 15 + 3 * contacts
    residual, S = note[0], note[1:4]
    for j in range(3):
        residual[j] = v_I[j] - (mean[EXTRA + contacts, j] if persistent else 0.0)
        for m in range(3):
            residual[j] -= mean[m, j] * mean[V, m]
        for k in range(3):
            total = covariance[at + j, at + k] if persistent else 0.0
            for m in range(3):
                row = 0.0
                for n in range(3):
                    row += covariance[3 + m, 3 + n] * mean[n, k]
                total += mean[m, j] * row
                if persistent:
                    total += mean[m, j] * covariance[3 + m, at + k]
                    total += covariance[at + j, 3 + m] * mean[m, k]
            S[j, k] = total
            note[4 + j, k] = measurement_cov[j, k]


@kernel
def add_velocity(sums, note, used: bool):
    """Add the innovation of `note_velocity` to its sensor's sums (10,), in place.

    used: False where the update was rejected.
    """
    if not used:
        add_rejected(sums)
        return
    work = np.empty((2, 3, 3))
    for i in range(3):
        for j in range(3):
            work[0, i, j] = note[1 + i, j] + note[4 + i, j]
    inverse_3(work[0], work[1])
    distance = 0.0
    for i in range(3):
        for j in range(3):
            distance += note[0, i] * work[1, i, j] * note[0, j]
    add_innovation(sums, distance, note[0], note[1:4], note[4:7])


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

    Args:
        mean: (7+E, 3), the packed mean.
        covariance: (n, n), n = 15+3E, symmetric.
        contacts: number of contact points in the state.
        PHt: (n, 3), Sigma H^T.
        S: (3, 3), covariance of the prior N(0, S) of z.
        z_mean: (3,), posterior mean of z.
        z_cov: (3, 3), its posterior covariance.
    """
    information = np.empty((3, 3))
    inverse_3(S, information)
    lift_with(information, mean, covariance, contacts, PHt, S, z_mean, z_cov)


@kernel
def lift_with(information, mean, covariance, contacts: int, PHt, S, z_mean, z_cov):
    """`lift` with S^-1 given.

    Args:
        information: (3, 3), S^-1.
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
        own = work[i]
        own[0], own[1], own[2], own[3], own[4], own[5] = k0, k1, k2, d0, d1, d2
        delta[i] = k0 * z_mean[0] + k1 * z_mean[1] + k2 * z_mean[2]
        for j in range(i + 1):
            g = work[j]
            value = covariance[i, j] - (
                (k0 * g[3] + d0 * g[0]) + (k1 * g[4] + d1 * g[1]) + (k2 * g[5] + d2 * g[2])
            )
            covariance[i, j] = value
            covariance[j, i] = value
    retract(mean, delta, contacts)
