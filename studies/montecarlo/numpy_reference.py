"""The Monte-Carlo study in plain numpy, one trial at a time, for comparison of time and results.

The right-invariant EKF of Hartley et al. (IJRR 2020) and the coverage update of Algorithm 1, step
by step. The mean is propagated to second order in dt with constant samples, the covariance with the
continuous error dynamics A to third order.
"""

import numpy as np
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from studies.montecarlo.settings import MonteCarloStudy
from studies.montecarlo.study import Setting
from studies.montecarlo.trials import Trials, Truth
from surefoot.estimator import hat
from surefoot.extend import GRAVITY

g_G = np.array([0.0, 0.0, -GRAVITY])
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(20)


def numpy_trial(
    study: MonteCarloStudy, truth: Truth, trials: Trials, k: int, setting: Setting
) -> np.ndarray:
    """Distances (L,) [m] of trial k from the truth, at the study's scored instants.

    Args:
        study: rates and noise.
        truth: true motion.
        trials: samples and initial states of all trials.
        k: index of the trial.
        setting: filter and its bounds.
    """
    mean, P = trials.means[k].copy(), trials.covariance.copy()
    R, v, p, b_a, b_g = mean[:3], mean[3], mean[4], mean[5], mean[6]
    dt = 1.0 / study.imu_rate
    A = np.zeros((15, 15))
    A[3:6, :3], A[6:9, 3:6] = hat(g_G), np.eye(3)
    Q = np.diag(np.repeat([study.imu.gyro**2, study.imu.accel**2], 3))
    out = []
    for n in range(1, study.samples + 1):
        w, a = trials.gyro[k, n] - b_g, trials.accel[k, n] - b_a
        A[:3, 12:], A[3:6, 12:], A[6:9, 12:] = -R, -hat(v) @ R, -hat(p) @ R
        A[3:6, 9:12] = -R
        step = A * dt
        Phi = np.eye(15) + step + step @ step / 2.0 + step @ step @ step / 6.0
        B = np.zeros((15, 6))
        B[:9, :3], B[3:6, 3:] = A[:9, 12:], A[3:6, 9:12]
        P = Phi @ (P + B @ Q @ B.T * dt) @ Phi.T
        turned = a + 0.5 * dt * np.cross(w, a)
        p = p + v * dt + 0.5 * dt * dt * (g_G + R @ a)
        v = v + dt * (g_G + R @ turned)
        R = R @ Rotation.from_rotvec(w * dt).as_matrix()
        if n % study.per_update == 0:
            H = np.zeros((3, 15))
            H[:, 3:6] = -R.T
            residual = trials.v_I[k, n // study.per_update - 1] - R.T @ v
            delta, P = _update(P, H, residual, setting)
            xi = np.zeros((5, 5))
            xi[:3, :3], xi[:3, 3], xi[:3, 4] = hat(delta[:3]), delta[3:6], delta[6:9]
            X = np.eye(5)
            X[:3, :3], X[:3, 3], X[:3, 4] = R, v, p
            X = expm(-xi) @ X
            R, v, p = X[:3, :3], X[:3, 3], X[:3, 4]
            b_a, b_g = b_a - delta[9:12], b_g - delta[12:]
        if n % study.per_score == 0:
            out.append(np.linalg.norm(p - truth.p_GI[n]))
    return np.array(out)


def numpy_moments(cov, lower, upper) -> tuple[float, np.ndarray, np.ndarray]:
    """pi, mean (3,) and covariance (3, 3) of N(0, cov) on a box, by 20 nodes per axis.

    Nodes cover the part of the box within 7 standard deviations. The error is 1e-9 for boxes about
    the mean, as in the study, and moderate correlations.
    """
    reach = 7.0 * np.sqrt(np.diag(cov))
    lower, upper = np.maximum(lower, -reach), np.minimum(upper, reach)
    half, centre = 0.5 * (upper - lower), 0.5 * (upper + lower)
    x, y, z = centre[:, None] + half[:, None] * _NODES
    D = np.linalg.inv(cov)
    xy = np.exp(-0.5 * D[0, 0] * x[:, None] ** 2 - D[0, 1] * np.outer(x, y))
    xz = np.exp(-0.5 * D[2, 2] * z**2 - D[0, 2] * np.outer(x, z))
    yz = np.exp(-0.5 * D[1, 1] * y[:, None] ** 2 - D[1, 2] * np.outer(y, z))
    xy *= np.outer(_WEIGHTS, _WEIGHTS)
    # Marginal density of each pair: the third axis is integrated out.
    on_xy = xy * ((xz * _WEIGHTS) @ yz.T)
    on_xz = xz * _WEIGHTS * (xy @ yz)
    on_yz = yz * _WEIGHTS * (xy.T @ xz)
    total = on_xy.sum()
    px, py, pz = on_xy.sum(axis=1) / total, on_xy.sum(axis=0) / total, on_xz.sum(axis=0) / total
    mean = np.array([px @ x, py @ y, pz @ z])
    x, y, z = x - mean[0], y - mean[1], z - mean[2]
    xx, yy, zz = px @ x**2, py @ y**2, pz @ z**2
    cxy, cxz, cyz = x @ on_xy @ y / total, x @ on_xz @ z / total, y @ on_yz @ z / total
    pi = total * np.prod(half) / np.sqrt((2 * np.pi) ** 3 * np.linalg.det(cov))
    return float(pi), mean, np.array([[xx, cxy, cxz], [cxy, yy, cyz], [cxz, cyz, zz]])


def _update(P, H, residual, setting: Setting) -> tuple[np.ndarray, np.ndarray]:
    """delta (15,) and the new P: Gaussian with setting.R, else coverage with its bounds."""
    S = H @ P @ H.T
    if setting.R is not None:
        K = np.linalg.solve(S + setting.R, H @ P).T
        return K @ residual, (np.eye(15) - K @ H) @ P
    assert setting.epsilon is not None
    assert setting.gamma is not None
    pi, mean, cov = numpy_moments(S, residual - setting.epsilon, residual + setting.epsilon)
    if pi >= setting.gamma:
        return np.zeros(15), P
    alpha = (setting.gamma - pi) / (1.0 - pi)
    change = alpha * (cov - S + (1.0 - alpha) * np.outer(mean, mean))
    K = np.linalg.solve(S, H @ P).T
    return K @ (alpha * mean), P + K @ change @ K.T
