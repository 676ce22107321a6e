"""What every filter takes of a log and gives back, checked."""

import numpy as np

from surefoot.estimator.core.state import numbers
from surefoot.estimator.evaluation.trajectory import Trajectory
from surefoot.sim.common.errors import SurefootError


def imu_arrays(t, gyro, accel, stride):
    """Checked t (N,), gyro (N, 3), accel (N, 3) and the stride, 100 Hz where it is None."""
    t = numbers("t", t, (-1,))
    gyro, accel = numbers("gyro", gyro, (len(t), 3)), numbers("accel", accel, (len(t), 3))
    if len(t) < 2 or not np.all(np.diff(t) > 0):
        raise SurefootError("t: needs two rows or more, strictly increasing")
    if stride is None:
        stride = max(1, round(0.01 / float(np.median(np.diff(t)))))
    if stride < 1:
        raise SurefootError(f"stride: {stride} where a whole number >= 1 is expected")
    return t, gyro, accel, int(stride)


def row_indices(rows, count: int, n: int) -> np.ndarray:
    """Checked row indices (count,), strictly increasing inside [0, n)."""
    rows = np.asarray(rows)
    if rows.shape != (count,):
        raise SurefootError(f"rows: shape {rows.shape} where ({count},) is expected, one a v_I")
    rows = rows.astype(np.int64)
    if count and (rows[0] < 0 or rows[-1] >= n or not np.all(np.diff(rows) > 0)):
        raise SurefootError(f"rows: must increase strictly inside 0..{n - 1}")
    return rows


def outputs(n: int, stride: int) -> tuple[np.ndarray, np.ndarray]:
    """Empty packed means (L, 7, 3) and covariances (L, 15, 15) for every stride-th of n rows."""
    count = (n - 1) // stride + 1
    return np.empty((count, 7, 3)), np.empty((count, 15, 15))


def trajectory(t, mean, covariance, updates) -> Trajectory:
    """The trajectory of packed means (L, 7, 3). Raises SurefootError where a filter diverged."""
    bad = np.flatnonzero(~np.isfinite(mean).all(axis=(1, 2)))
    if len(bad):
        raise SurefootError(f"filter: the estimate is not finite from t = {t[bad[0]]:.3f} s on")
    return Trajectory(
        t, mean[:, :3], mean[:, 3], mean[:, 4], mean[:, 5], mean[:, 6], covariance, updates
    )
