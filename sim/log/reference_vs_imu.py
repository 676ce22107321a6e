"""Poses of a reference relative to the integrals of the IMU.

The integrated gyro gives the attitude up to an initial value and a drift; the specific force,
rotated by it and with gravity added, gives the path up to an initial position, a velocity and a
drift. The difference of the poses from both varies slowly if IMU and reference match. It reveals a
clock offset, a displacement of the tracked point, a bias, and the noise of each sample.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from surefoot.sim.common.gravity import GRAVITY_G
from surefoot.sim.common.kernels import kernel
from surefoot.sim.common.series import interpolate_rows
from surefoot.sim.log.derived import local_quadratic
from surefoot.sim.log.reference import Poses

_DRIFT_WINDOW = 0.5
"""Time constant for which the gyro is trusted relative to the poses [s]: its noise rotates it by
less than 0.01 degrees in this time, and the poses' noise averages out.
"""


@dataclass(frozen=True)
class ReferenceVsImu:
    """K poses relative to the IMU's integrals.

    Attributes:
        t: times (K,) [s].
        turn: rotation vector in G from the integrated attitude to the pose's (K, 3) [rad].
        drift: slow part of `turn` (K, 3) [rad].
        path: position minus the twice integrated specific force (K, 3) [m].
        R_GI: attitudes by the gyro, corrected for the drift (K, 3, 3), without the poses' noise
            between samples.
        omega: angular rate in I (K, 3) [rad/s].
    """

    t: np.ndarray
    turn: np.ndarray
    drift: np.ndarray
    path: np.ndarray
    R_GI: np.ndarray
    omega: np.ndarray


def compare_with_imu(
    t: np.ndarray, gyro: np.ndarray, accel: np.ndarray, poses: Poses
) -> ReferenceVsImu:
    """Compare poses of the IMU frame with the integrals of the IMU.

    The poses must lie within the times t (N,) [s] of the IMU's rows; gyro (N, 3) [rad/s] and accel
    (N, 3) [m/s^2] are means over the step before each row.
    """
    dt = np.diff(t)
    turned = _integrated(gyro[1:] * dt[:, None])
    row = np.clip(np.searchsorted(t, poses.t, side="right") - 1, 0, len(t) - 2)
    after = (poses.t - t[row])[:, None]
    omega = gyro[row + 1]
    at_poses = turned[row] @ Rotation.from_rotvec(omega * after).as_matrix()
    correction = Rotation.from_matrix(poses.R @ np.swapaxes(at_poses, 1, 2))
    mean = correction.mean()
    turn = (correction * mean.inv()).as_rotvec()
    drift = local_quadratic(poses.t, turn, _DRIFT_WINDOW)[0]
    R_GI = (Rotation.from_rotvec(drift) * mean).as_matrix() @ at_poses
    at_rows = interpolate_rows(t, poses.t, drift)
    R_rows = (Rotation.from_rotvec(at_rows) * mean).as_matrix() @ turned
    midway = R_rows[:-1] @ Rotation.from_rotvec(0.5 * gyro[1:] * dt[:, None]).as_matrix()
    force = np.einsum("nij,nj->ni", midway, accel[1:]) + GRAVITY_G
    zero = np.zeros((1, 3))
    velocity = np.concatenate([zero, np.cumsum(force * dt[:, None], axis=0)])
    steps = velocity[:-1] * dt[:, None] + 0.5 * force * dt[:, None] ** 2
    travelled = np.concatenate([zero, np.cumsum(steps, axis=0)])
    travelled = travelled[row] + velocity[row] * after + 0.5 * force[row] * after**2
    return ReferenceVsImu(poses.t, turn, drift, poses.p - travelled, R_GI, omega)


@kernel
def _integrated(turns):
    """Attitudes (N + 1, 3, 3) after successive rotation vectors (N, 3) [rad], starting from I."""
    n = len(turns)
    R = np.empty((n + 1, 3, 3))
    # As a quaternion, which is easily kept normalised; products of matrices lose orthogonality.
    w, x, y, z = 1.0, 0.0, 0.0, 0.0
    R[0] = np.eye(3)
    for k in range(n):
        a, b, c = turns[k]
        half = 0.5 * np.sqrt(a * a + b * b + c * c)
        share = 0.5 * (np.sin(half) / half if half > 1e-9 else 1.0)
        d, a, b, c = np.cos(half), share * a, share * b, share * c
        w, x, y, z = (
            w * d - x * a - y * b - z * c,
            w * a + x * d + y * c - z * b,
            w * b - x * c + y * d + z * a,
            w * c + x * b - y * a + z * d,
        )
        size = np.sqrt(w * w + x * x + y * y + z * z)
        w, x, y, z = w / size, x / size, y / size, z / size
        R[k + 1, 0] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
        R[k + 1, 1] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
        R[k + 1, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    return R
