"""Unit quaternions (w, x, y, z) to rotation matrices and back: the only place that converts."""

import numpy as np
from scipy.spatial.transform import Rotation


def matrix_from_quaternion(q: np.ndarray) -> np.ndarray:
    """Rotation matrices (..., 3, 3) of the quaternions q (..., 4), ordered w, x, y, z."""
    q = np.asarray(q, dtype=float)
    R = Rotation.from_quat(q.reshape(-1, 4), scalar_first=True).as_matrix()
    return R.reshape(*q.shape[:-1], 3, 3)


def quaternion_from_matrix(R: np.ndarray) -> np.ndarray:
    """Quaternions (..., 4), ordered w, x, y, z with w >= 0, of the rotations R (..., 3, 3)."""
    R = np.asarray(R, dtype=float)
    q = Rotation.from_matrix(R.reshape(-1, 3, 3)).as_quat(canonical=True, scalar_first=True)
    return q.reshape(*R.shape[:-2], 4)
