"""Contact points in the state: how they roll, enter, leave and correct (Hartley 2020, Sec. IV-V).

Extra k of the packed state is the centre d of foot k in G while the foot stands, zero with a zero
covariance while it swings. Leg kinematics measure f = R_GI^T (d - p), a right-invariant output with

    H = R_GI^T [0 0 I ... -I ...] on (position, that contact).

A spherical foot of radius r that rolls without slipping on ground of normal e_z (G) moves its
centre at omega x r e_z, with omega = R_GI (gyro - b_g + rate of the foot relative to the body).
With W = omega dt the error of the contact point follows

    xi_d' = xi_d + r [W]x [e_z]x xi_R + ([d']x - r [e_z]x) B_R delta b_g.
"""

import numpy as np

from surefoot.estimator.core.propagation import (
    add_cross_columns,
    propagate_covariance,
    propagate_mean,
)
from surefoot.estimator.core.state import B_G, EXTRA, P
from surefoot.estimator.updates.velocity import gaussian_update
from surefoot.sim.common.kernels import kernel

MEMORY = 0.1
"""Weight of the newest innovation in the running mean: about 20 updates, 40 ms at 500 Hz."""
HOLD = 50
"""Updates for which a foot that slipped is left out, 0.1 s at 500 Hz."""


@kernel
def propagate_contacts(
    mean, covariance, standing, gyro, accel, dt: float, noise, contact_noise, rolling_noise: float,
    radius, rates, columns, rotation_columns,
):  # fmt: skip
    """One IMU step with the contact points rolling, in place.

    standing (K,) bool; radius (K,) [m]; rates (K, 3) [rad/s], the feet's angular velocity relative
    to the body over the step, in I; contact_noise (3,) squared densities [m^2/s] along G's axes;
    rolling_noise [rad^2/s] the squared density of the rates' error; the rest as `propagate`.
    """
    omega = np.empty(3)
    W = np.empty(3)
    for i in range(3):
        omega[i] = gyro[i] - mean[B_G, i]
    propagate_mean(mean, gyro, accel, dt, columns)
    for k in range(standing.shape[0]):
        at = 15 + 3 * k
        rotation_columns[3 * k : 3 * k + 3] = 0.0
        columns[at : at + 3] = 0.0
        if not standing[k]:
            continue
        r = radius[k]
        for i in range(3):
            # -B_R turns a rate in I into an angle in G, over the step's mean attitude.
            W[i] = 0.0
            for m in range(3):
                W[i] -= columns[i, 3 + m] * (omega[m] + rates[k, m])
        mean[EXTRA + k, 0] += r * W[1]
        mean[EXTRA + k, 1] -= r * W[0]
        rotation_columns[3 * k, 0] = -r * W[2]
        rotation_columns[3 * k + 1, 1] = -r * W[2]
        rotation_columns[3 * k + 2, 0] = r * W[0]
        rotation_columns[3 * k + 2, 1] = r * W[1]
        add_cross_columns(mean[EXTRA + k], columns, at)
        for j in range(3, 6):
            columns[at, j] += r * columns[1, j]
            columns[at + 1, j] -= r * columns[0, j]
    propagate_covariance(covariance, columns, rotation_columns, dt, noise)
    for k in range(standing.shape[0]):
        if standing[k]:
            for i in range(3):
                roll = radius[k] ** 2 * rolling_noise if i < 2 else 0.0
                covariance[15 + 3 * k + i, 15 + 3 * k + i] += (contact_noise[i] + roll) * dt


@kernel
def update_contacts(
    mean, covariance, standing, feet_I, in_contact, measurement_cov, gate: float, drift, held
):
    """Contacts leave, correct the state and enter, in this order, in place.

    feet_I (K, 3) [m] and measurement_cov (K, 3, 3) [m^2] in I; in_contact (K,) bool. A foot found
    slipping (see `_slips`, drift (K, 3)) leaves the state and stays out for HOLD updates, counted
    down in held (K,), or until it lifts off.
    """
    feet = standing.shape[0]
    n = covariance.shape[0]
    PHt, S, residual = np.empty((n, 3)), np.empty((3, 3)), np.empty(3)
    for k in range(feet):
        held[k] = max(held[k] - 1, 0) if in_contact[k] else 0
        if standing[k] and not in_contact[k]:
            _remove(mean, covariance, k)
            standing[k] = False
    for k in range(feet):
        if not standing[k]:
            continue
        contact_output(mean, covariance, k, feet_I[k], PHt, S, residual)
        if np.isfinite(gate) and _slips(S, measurement_cov[k], residual, gate, drift[k]):
            _remove(mean, covariance, k)
            standing[k] = False
            held[k] = HOLD
        else:
            gaussian_update(mean, covariance, feet, PHt, S, residual, measurement_cov[k])
    for k in range(feet):
        if in_contact[k] and not standing[k] and held[k] == 0:
            _insert(mean, covariance, k, feet_I[k], measurement_cov[k])
            standing[k] = True
            for i in range(3):
                drift[k, i] = 0.0


@kernel
def _slips(S, measurement_cov, residual, gate: float, drift) -> bool:
    """Chi-square test (3 degrees of freedom) of one innovation and of their running mean.

    Innovations of a consistent filter are white with covariance S + R. A slip of half a metre a
    second moves a foot by only a millimetre an update, which no single innovation shows; it does
    show in the exponential mean `drift` of the whitened ones, of variance MEMORY / (2 - MEMORY).
    """
    L = np.zeros((3, 3))
    white = np.empty(3)
    single = 0.0
    running = 0.0
    for i in range(3):
        white[i] = residual[i]
        for j in range(i + 1):
            total = S[i, j] + measurement_cov[i, j]
            for m in range(j):
                total -= L[i, m] * L[j, m]
            L[i, j] = np.sqrt(total) if i == j else total / L[j, j]
            if j < i:
                white[i] -= L[i, j] * white[j]
        white[i] /= L[i, i]
        drift[i] += MEMORY * (white[i] - drift[i])
        single += white[i] ** 2
        running += drift[i] ** 2 * (2.0 - MEMORY) / MEMORY
    return max(single, running) > gate


@kernel
def contact_output(mean, covariance, k: int, foot_I, PHt, S, residual):
    """Sigma H^T (n, 3), H Sigma H^T (3, 3) and f - R^T (d - p) (3,) of foot k."""
    at = 15 + 3 * k
    for i in range(covariance.shape[0]):
        for j in range(3):
            PHt[i, j] = 0.0
            for m in range(3):
                PHt[i, j] += (covariance[i, 6 + m] - covariance[i, at + m]) * mean[m, j]
    for j in range(3):
        residual[j] = foot_I[j]
        for m in range(3):
            residual[j] -= mean[m, j] * (mean[EXTRA + k, m] - mean[P, m])
        for i in range(j + 1):
            S[i, j] = 0.0
            for m in range(3):
                S[i, j] += mean[m, i] * (PHt[6 + m, j] - PHt[at + m, j])
            S[j, i] = S[i, j]


@kernel
def _remove(mean, covariance, k: int):
    """Foot k leaves: its row, and its rows and columns of the covariance, become zero."""
    at = 15 + 3 * k
    mean[EXTRA + k] = 0.0
    covariance[at : at + 3, :] = 0.0
    covariance[:, at : at + 3] = 0.0


@kernel
def _insert(mean, covariance, k: int, foot_I, measurement_cov):
    """Foot k enters at d = p + R f, so xi_d = xi_p + R n_f (Hartley 2020, eq. 32)."""
    at = 15 + 3 * k
    n = covariance.shape[0]
    for i in range(3):
        mean[EXTRA + k, i] = mean[P, i]
        for m in range(3):
            mean[EXTRA + k, i] += mean[i, m] * foot_I[m]
    for i in range(3):
        for j in range(n):
            covariance[at + i, j] = covariance[6 + i, j]
    for i in range(3):
        for j in range(n):
            covariance[j, at + i] = covariance[j, 6 + i]
    for i in range(3):
        for j in range(3):
            for a in range(3):
                for b in range(3):
                    covariance[at + i, at + j] += mean[i, a] * measurement_cov[a, b] * mean[j, b]
