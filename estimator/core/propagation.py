"""IMU propagation of mean and covariance, exact for an IMU sample that is constant over its step.

With Gamma_m of `estimator.core.lie`, phi = (gyro - b_g) dt and a = accel - b_a, the mean moves by

    R' = R Gamma_0,   v' = v + g dt + R Gamma_1 a dt,   p' = p + v dt + g dt^2/2 + R Gamma_2 a dt^2

(eq. estimator_dynamics integrated). The right-invariant error moves by xi' = F xi + B delta b,
where F contains gravity and dt alone and the columns of B, for (b_a, b_g), are

    rotation   0,               B_R = -R Gamma_1 dt
    velocity   -R Gamma_1 dt,   [v']x B_R - R d(Gamma_1 a)/dphi dt^2
    position   -R Gamma_2 dt^2, [p']x B_R - R d(Gamma_2 a)/dphi dt^3.

This is Phi of eq. continuous_error_dynamics (Hartley 2020) without a small-step approximation: the
derivative of the discrete step itself. The noise of a sample is constant over the step like the
sample, so Q_d = B (Q/dt) B^T + walks.
"""

import numpy as np
from numba import types

from surefoot.estimator.core.checks import is_sound, is_step
from surefoot.estimator.core.lie import entire, gammas_of
from surefoot.estimator.core.state import B_A, B_G, EXTRA, P, V
from surefoot.sim.common.gravity import GRAVITY
from surefoot.sim.common.kernels import GIVEN_1, OWN_2, kernel


@kernel(inline="always")
def propagate(mean, covariance, gyro, accel, dt: float, noise, columns, rotation_columns):
    """One IMU step of mean (7+E, 3) and covariance (15+3E, 15+3E), in place.

    gyro (3,) [rad/s], accel (3,) [m/s^2]: means over the step of dt [s]; noise (4, 3) as
    `FilterNoise.packed`. columns (15+3E, 6) is work space for B. The caller fills its rows of
    extras, and rotation_columns (3E, 3), the coupling of extras to the rotation error.
    """
    propagate_mean(mean, gyro, accel, dt, columns)
    propagate_covariance(covariance, columns, rotation_columns, dt, noise)


@kernel(inline="always")
def propagate_mean(mean, gyro, accel, dt: float, columns):
    """Propagate the mean in place; fill the rows 0 to 8 of B: rotation, velocity, position.

    Args:
        mean: (7+E, 3), the packed mean.
        gyro: (3,) [rad/s] in I.
        accel: (3,) [m/s^2] in I, specific force.
        dt: the step [s].
        columns: (15+3E, 6), receives B, the derivative by (b_a, b_g).
    """
    # One allocation for all matrices: several are slower than the arithmetic.
    work = np.empty((7, 3, 3))
    G0, G1, G2, D1, D2, R = work[0], work[1], work[2], work[3], work[4], work[5]
    phi, a = work[6, 0], work[6, 1]
    for i in range(3):
        phi[i] = (gyro[i] - mean[B_G, i]) * dt
        a[i] = accel[i] - mean[B_A, i]
        for j in range(3):
            R[i, j] = mean[i, j]
    e = entire(phi[0] ** 2 + phi[1] ** 2 + phi[2] ** 2)
    gammas_of(phi, e, G0, G1, G2)
    gamma_derivatives(phi, a, e, D1, D2)

    for i in range(3):
        dv = 0.0
        dp = 0.0
        for j in range(3):
            s0 = s1 = s2 = d1 = d2 = 0.0
            for m in range(3):
                s0 += R[i, m] * G0[m, j]
                s1 += R[i, m] * G1[m, j]
                s2 += R[i, m] * G2[m, j]
                d1 += R[i, m] * D1[m, j]
                d2 += R[i, m] * D2[m, j]
            mean[i, j] = s0
            dv += s1 * a[j] * dt
            dp += s2 * a[j] * dt * dt
            columns[i, j] = 0.0
            columns[i, 3 + j] = -s1 * dt
            columns[3 + i, j] = -s1 * dt
            columns[3 + i, 3 + j] = -d1 * dt * dt
            columns[6 + i, j] = -s2 * dt * dt
            columns[6 + i, 3 + j] = -d2 * dt * dt * dt
        mean[P, i] += mean[V, i] * dt + dp
        mean[V, i] += dv
    mean[P, 2] -= 0.5 * GRAVITY * dt * dt
    mean[V, 2] -= GRAVITY * dt
    add_cross_columns(mean[V], columns, 3)
    add_cross_columns(mean[P], columns, 6)


@kernel
def add_cross_columns(x, columns, at: int):
    """columns[at:at+3, gyro] += [x]x B_R."""
    for j in range(3, 6):
        columns[at, j] += x[1] * columns[2, j] - x[2] * columns[1, j]
        columns[at + 1, j] += x[2] * columns[0, j] - x[0] * columns[2, j]
        columns[at + 2, j] += x[0] * columns[1, j] - x[1] * columns[0, j]


@kernel(inline="always")
def gamma_derivatives(phi, a, e, d_gamma_1, d_gamma_2):
    """d(Gamma_1(phi) a)/dphi into d_gamma_1 and d(Gamma_2(phi) a)/dphi into d_gamma_2, (3, 3) each.

    e are the values of `entire` at the squared angle.

    From Gamma_m a = a/m! + e_{m+1} u + e_{m+2} w with u = phi x a, w = phi x u, and
    d e_k / dphi = (k e_{k+2} - e_{k+1}) phi^T.
    """
    _, _, e2, e3, e4, e5, e6 = e
    x, y, z = phi[0], phi[1], phi[2]
    u0, u1, u2 = y * a[2] - z * a[1], z * a[0] - x * a[2], x * a[1] - y * a[0]
    w0, w1, w2 = y * u2 - z * u1, z * u0 - x * u2, x * u1 - y * u0
    dot = x * a[0] + y * a[1] + z * a[2]
    s2, s3, s4 = 2.0 * e4 - e3, 3.0 * e5 - e4, 4.0 * e6 - e5
    for i, u, w in ((0, u0, w0), (1, u1, w1), (2, u2, w2)):
        t1, t2 = s2 * u + s3 * w, s3 * u + s4 * w
        for j in range(3):
            # w = phi (phi . a) - a |phi|^2
            dw = phi[i] * a[j] - 2.0 * a[i] * phi[j]
            d_gamma_1[i, j] = e3 * dw + t1 * phi[j]
            d_gamma_2[i, j] = e4 * dw + t2 * phi[j]
        d_gamma_1[i, i] += e3 * dot
        d_gamma_2[i, i] += e4 * dot
    # du/dphi = -[a]x for u = phi x a.
    for d, s in ((d_gamma_1, e2), (d_gamma_2, e3)):
        d[0, 1] += s * a[2]
        d[1, 0] -= s * a[2]
        d[1, 2] += s * a[0]
        d[2, 1] -= s * a[0]
        d[2, 0] += s * a[1]
        d[0, 2] -= s * a[1]


@kernel(inline="always")
def propagate_covariance(covariance, columns, rotation_columns, dt: float, noise):
    """Sigma' = Phi Sigma Phi^T + Q_d (eq. covariance_propagation), in place.

    Phi = [F B; 0 I] is applied by row additions, since F is sparse. Only one half of (Phi Sigma)
    Phi^T is computed: row i of Phi Sigma is read for the last time then, so element (i, j) may be
    stored at (j, i), whose row is finished. The noise Q/dt of B is added with the bias columns.

    Args:
        covariance: (15+3E, 15+3E).
        columns: (15+3E, 6), B of `propagate_mean`.
        rotation_columns: (3E, 3), coupling of the extras to the rotation error.
        dt: the step [s].
        noise: (4, 3), `FilterNoise.packed`.
    """
    n = covariance.shape[0]
    _add_rows(covariance, columns, rotation_columns, dt)
    speed, fall = GRAVITY * dt, 0.5 * GRAVITY * dt * dt
    a0, a1, a2 = noise[0, 0] / dt, noise[0, 1] / dt, noise[0, 2] / dt
    g0, g1, g2 = noise[1, 0] / dt, noise[1, 1] / dt, noise[1, 2] / dt
    for p in range(n - 6):
        i = p if p < 9 else p + 6
        row, b = covariance[i], columns[i]
        e0, e1, e2 = row[9] + b[0] * a0, row[10] + b[1] * a1, row[11] + b[2] * a2
        e3, e4, e5 = row[12] + b[3] * g0, row[13] + b[4] * g1, row[14] + b[5] * g2
        r0, r1, r2 = row[0], row[1], row[2]
        for j in range(min(i, 8) + 1):
            d = columns[j]
            covariance[j, i] = row[j] + (
                e0 * d[0] + e1 * d[1] + e2 * d[2] + e3 * d[3] + e4 * d[4] + e5 * d[5]
            )
        for j in range(15, i + 1):
            c, d = rotation_columns[j - 15], columns[j]
            covariance[j, i] = row[j] + (
                r0 * c[0] + r1 * c[1] + r2 * c[2] + e3 * d[3] + e4 * d[4] + e5 * d[5]
            )
        if i > 2:
            covariance[3, i] += speed * r1
        if i > 3:
            covariance[4, i] -= speed * r0
        if i > 5:
            covariance[6, i] += dt * row[3] + fall * r1
        if i > 6:
            covariance[7, i] += dt * row[4] - fall * r0
        if i > 7:
            covariance[8, i] += dt * row[5]
    for i in range(n):
        for j in range(i):
            if 8 < j < 15 < i + 1:
                covariance[j, i] = covariance[i, j]
            else:
                covariance[i, j] = covariance[j, i]
    for m in range(3):
        covariance[9 + m, 9 + m] += noise[2, m] * dt
        covariance[12 + m, 12 + m] += noise[3, m] * dt


@kernel(inline="always")
def _add_rows(M, columns, rotation_columns, dt: float):
    """M <- Phi M in place. Position uses the old velocity and rotation, and velocity the old
    rotation, which determines the order.
    """
    n = M.shape[0]
    fall = 0.5 * GRAVITY * dt * dt
    for j in range(n):
        M[6, j] += dt * M[3, j] + fall * M[1, j]
        M[7, j] += dt * M[4, j] - fall * M[0, j]
        M[8, j] += dt * M[5, j]
        M[3, j] += GRAVITY * dt * M[1, j]
        M[4, j] -= GRAVITY * dt * M[0, j]
    for i in range(15, n):
        c, b = rotation_columns[i - 15], columns[i]
        c0, c1, c2, b3, b4, b5 = c[0], c[1], c[2], b[3], b[4], b[5]
        # Extra rows without coupling, of swinging feet or plain vectors, are unchanged.
        if c0 != 0.0 or c1 != 0.0 or c2 != 0.0 or b3 != 0.0 or b4 != 0.0 or b5 != 0.0:
            for j in range(n):
                M[i, j] += c0 * M[0, j] + c1 * M[1, j] + c2 * M[2, j]
                M[i, j] += b3 * M[12, j] + b4 * M[13, j] + b5 * M[14, j]
    for i in range(3):
        b3, b4, b5 = columns[i, 3], columns[i, 4], columns[i, 5]
        for j in range(n):
            M[i, j] += b3 * M[12, j] + b4 * M[13, j] + b5 * M[14, j]
    for i in range(3, 9):
        b0, b1, b2 = columns[i, 0], columns[i, 1], columns[i, 2]
        b3, b4, b5 = columns[i, 3], columns[i, 4], columns[i, 5]
        for j in range(n):
            M[i, j] += b0 * M[9, j] + b1 * M[10, j] + b2 * M[11, j]
            M[i, j] += b3 * M[12, j] + b4 * M[13, j] + b5 * M[14, j]


PREDICT = types.boolean(OWN_2, OWN_2, OWN_2, GIVEN_1, GIVEN_1, types.float64)
"""Signature of `predict_checked`."""


@kernel
def predict_checked(vectors, covariance, columns, gyro, accel, dt) -> bool:
    """`propagate` for a robot's own loop, of a state without contacts.

    A call from Python costs as much as the arithmetic of a step, and checks in Python would cost
    more: this one checks sample and state, and returns False, with nothing changed, if they fail.

    Args:
        vectors: (13+4E, 3), in place: mean, noise, space for the sample, coupling of the extras.
        covariance: (15+3E, 15+3E), in place.
        columns: (15+3E, 6), work space for B; its rows of extras are zero.
        gyro: (3,) [rad/s] in I.
        accel: (3,) [m/s^2] in I, specific force.
        dt: the step [s].
    """
    if not is_step(gyro, accel, dt) or not is_sound(vectors, covariance):
        return False
    n = EXTRA + (covariance.shape[0] - 15) // 3
    mean, noise = vectors[:n], vectors[n : n + 4]
    sample, coupling = vectors[n + 4 : n + 6], vectors[n + 6 :]
    for i in range(3):
        sample[0, i], sample[1, i] = gyro[i], accel[i]
    propagate(mean, covariance, sample[0], sample[1], dt, noise, columns, coupling)
    return True
