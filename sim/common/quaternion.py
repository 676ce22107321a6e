"""Conversion between unit quaternions (w, x, y, z) and rotation matrices."""

import numpy as np
from scipy.spatial.transform import Rotation, Slerp


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


def check_rotation(R: np.ndarray) -> None:
    """Raise ValueError if a matrix (3, 3) is not a rotation: scaled, skewed or a reflection."""
    if R.shape != (3, 3) or not np.allclose(R @ R.T, np.eye(3), atol=1e-6) or np.linalg.det(R) < 0:
        raise ValueError("R_BI is not a rotation")


def slerp(t: np.ndarray, q: np.ndarray, then: np.ndarray) -> np.ndarray:
    """Interpolate attitudes q (N, 4), given at t (N,) [s], to the times `then` (M,) [s] among these
    (Shoemake 1985).

    Rotates at a constant rate and by the shorter way between neighbours; returns (M, 4) with w >=
    0.
    """
    turned = Slerp(t, Rotation.from_quat(q, scalar_first=True))(then)
    return turned.as_quat(canonical=True, scalar_first=True)


def continuous(q: np.ndarray) -> np.ndarray:
    """Quaternions (N, 4) of the same attitudes, without changes of sign from one to the next."""
    flips = np.cumprod(np.append(1.0, np.where(np.sum(q[1:] * q[:-1], axis=1) < 0.0, -1.0, 1.0)))
    return q * flips[:, None]
