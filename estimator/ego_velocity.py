"""Ego velocity from one frame of a radar, by least squares on Doppler robust to outliers.

A static point in the unit direction u from the sensor changes its range at the rate d = -u . v,
where v is the sensor's velocity: one linear equation per return, n equations for three unknowns.
Multipath ghosts and moving objects violate some, so the loss is truncated,

    min_v sum_i min((d_i + u_i . v)^2, c^2),     c = 3 noise,

and minimised by graduated non-convexity, which needs neither sampling nor an initial guess (Yang,
Antonante, Tzoumas, Carlone, Graduated Non-Convexity for Robust Spatial Perception, RA-L 2020):
weighted least squares while the loss goes from convex (mu small) to truncated (mu large). The usual
alternative is RANSAC on three returns, followed by least squares on the inliers (Doer and Trommer,
An EKF Based Approach to Radar Inertial Odometry, MFI 2020).

Directions are measured too, the elevation only to within degrees. Errors in the regressors bias
least squares: with Sigma_i the covariance of a measured direction, sum u u^T is too large by sum
Sigma_i on average, and a mean direction too short by the factor k below. Both are corrected over
the inliers (bias-compensated least squares; orthogonal distance regression is an alternative).
"""

import numpy as np

from surefoot.estimator.core.checks import numbers
from surefoot.estimator.updates.velocity import inverse_3
from surefoot.sim.common.copies import copy_corner
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.kernels import kernel

ENOUGH = 6
"""Least number of returns, and of inliers, in a frame: twice the unknowns."""
AGREED = 0.4
"""Least share of inliers among a frame's returns; fewer may agree on a ghost."""
_GROW, _ROUNDS = 1.4, 100


def ego_velocities(
    frame: np.ndarray,
    direction: np.ndarray,
    doppler: np.ndarray,
    frames: int,
    noise: float,
    angle_noise: tuple[float, float] = (0.0, 0.0),
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Velocity of the sensor from each frame that has one: at least ENOUGH inliers, AGREED of all
    returns, and a spread of directions. The covariance scales with the larger of `noise` and the
    inliers' residuals. Raises SurefootError on wrong shapes, values that are not finite and noise
    out of range.

    Returns the indices (R,) of the frames with a result, their velocities (R, 3) [m/s] in the
    sensor's axes and the covariances (R, 3, 3) [m^2/s^2].

    Args:
        frame: (n,), index of each return's frame, ascending, below `frames`.
        direction: (n, 3), unit vectors to the returns in the sensor's frame.
        doppler: (n,) [m/s], radial velocities.
        frames: number of frames.
        noise: standard deviation of a Doppler [m/s].
        angle_noise: standard deviations of azimuth and elevation [rad].
    """
    direction = numbers("direction", direction, (-1, 3))
    doppler = numbers("doppler", doppler, (len(direction),))
    if not 0.0 < noise < np.inf:
        raise SurefootError(f"noise: {noise} where a number > 0 is expected")
    noises = numbers("angle_noise", [noise, *angle_noise], (3,))
    if noises.min() < 0:
        raise SurefootError("angle_noise: two numbers >= 0 are expected")
    ends = np.searchsorted(frame, np.arange(frames + 1))
    velocities, covariances = np.empty((frames, 3)), np.empty((frames, 3, 3))
    good = np.zeros(frames, dtype=bool)
    for k in range(frames):
        of_frame = slice(ends[k], ends[k + 1])
        u, d, inlier = direction[of_frame], doppler[of_frame], np.empty(ends[k + 1] - ends[k], bool)
        good[k] = _ego_velocity(u, d, noises, velocities[k], covariances[k], inlier)
    rows = np.flatnonzero(good)
    return rows, velocities[rows], covariances[rows]


@kernel
def _ego_velocity(u, d, noises, v, cov, inlier) -> bool:
    """Robust velocity of one frame; False where too few returns agree or they do not determine it.

    Args:
        u: (n, 3), unit vectors to the returns.
        d: (n,) [m/s], their Dopplers.
        noises: (3,), standard deviations of Doppler [m/s], azimuth and elevation [rad].
        v: (3,) [m/s], filled.
        cov: (3, 3) [m^2/s^2], filled.
        inlier: (n,) bool, filled.
    """
    n, none = len(d), np.zeros(3)
    if n < ENOUGH:
        return False
    weight, c2 = np.ones(n), (3.0 * noises[0]) ** 2
    if not _solve(u, d, weight, none, v, cov):
        return False
    residual = _residuals(u, d, v)
    worst = np.max(residual)
    mu = c2 / (2.0 * worst - c2) if 2.0 * worst > c2 else np.inf
    rounds = 0
    while mu < 1e6 and rounds < _ROUNDS:
        low, high = mu / (mu + 1.0) * c2, (mu + 1.0) / mu * c2
        for i in range(n):
            if residual[i] >= high:
                weight[i] = 0.0
            elif residual[i] <= low:
                weight[i] = 1.0
            else:
                weight[i] = np.sqrt(c2 * mu * (mu + 1.0) / residual[i]) - mu
        if not _solve(u, d, weight, none, v, cov):
            return False
        residual = _residuals(u, d, v)
        mu *= _GROW
        rounds += 1
    count, total = 0, 0.0
    for i in range(n):
        inlier[i] = residual[i] <= c2
        weight[i] = 1.0 if inlier[i] else 0.0
        count += inlier[i]
    if count < ENOUGH or count < AGREED * n or not _solve(u, d, weight, noises, v, cov):
        return False
    residual = _residuals(u, d, v)
    for i in range(n):
        total += weight[i] * residual[i]
    cov *= max(noises[0] ** 2, total / (count - 3))
    return True


@kernel
def _residuals(u, d, v):
    out = np.empty(len(d))
    for i in range(len(d)):
        out[i] = (d[i] + u[i, 0] * v[0] + u[i, 1] * v[1] + u[i, 2] * v[2]) ** 2
    return out


@kernel
def _solve(u, d, weight, noises, v, spread) -> bool:
    """Weighted least squares for the velocity; False if singular.

    Args:
        u: (n, 3), unit vectors to the returns.
        d: (n,) [m/s], their Dopplers.
        weight: (n,), of each return.
        noises: (3,); noises[1:] are the angles', whose effect on the normal equations is removed.
        v: (3,) [m/s], filled.
        spread: (3, 3), filled with the covariance of the estimate for Dopplers of unit variance.
    """
    A, C, b = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3)
    tangent, rise = np.zeros(3), np.zeros(3)
    for i in range(len(d)):
        x, y, z = u[i, 0], u[i, 1], u[i, 2]
        flat = max(np.sqrt(x * x + y * y), 1e-9)
        tangent[0], tangent[1] = -y, x  # by azimuth, |tangent| = flat
        rise[0], rise[1], rise[2] = -z * x / flat, -z * y / flat, flat
        for j in range(3):
            b[j] -= weight[i] * u[i, j] * d[i]
            for k in range(3):
                A[j, k] += weight[i] * u[i, j] * u[i, k]
                C[j, k] += weight[i] * (
                    noises[1] ** 2 * tangent[j] * tangent[k] + noises[2] ** 2 * rise[j] * rise[k]
                )
    trace = A[0, 0] + A[1, 1] + A[2, 2]
    if trace <= 0.0:
        return False
    W = A - C
    # Two of the three leading minors, then the determinant: W must be positive definite.
    if W[0, 0] <= 1e-9 * trace or W[0, 0] * W[1, 1] - W[0, 1] ** 2 <= 1e-9 * trace**2:
        return False
    if np.linalg.det(W / trace) < 1e-9:
        return False
    inverse = np.empty((3, 3))
    inverse_3(W, inverse)
    k = 1.0 - 0.5 * (noises[1] ** 2 + noises[2] ** 2)
    for j in range(3):
        v[j] = k * (inverse[j, 0] * b[0] + inverse[j, 1] * b[1] + inverse[j, 2] * b[2])
    copy_corner(inverse @ A @ inverse, spread)
    return True
