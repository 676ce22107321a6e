"""Innovations of velocity measurements: measured minus expected velocity, and its covariance."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from surefoot.estimator.evaluation.trajectory import Trajectory, TrajectoryError
from surefoot.sim.common.gravity import GRAVITY_G
from surefoot.sim.log import Log


@dataclass(frozen=True)
class Innovations:
    """Innovations of velocity updates.

    Attributes:
        t: time (M,) [s].
        z: measured minus expected v_I (M, 3) [m/s].
        S: R^T P_vv R (M, 3, 3) [m^2/s^2], the filter's covariance of its own velocity in I, without
            the noise of the measurement.
    """

    t: np.ndarray
    z: np.ndarray
    S: np.ndarray

    @property
    def squared(self) -> np.ndarray:
        """z^T S^-1 z / 3 (M,)."""
        whitened = np.linalg.solve(self.S, self.z[:, :, None])[:, :, 0]
        return np.einsum("mi,mi->m", self.z, whitened) / 3


def innovations(log: Log, trajectory: Trajectory) -> Innovations:
    """Innovations of a filter's velocity updates, from its output and the log's IMU.

    The estimate before an update is the last one stored before it, propagated by the IMU; S is
    taken where it was stored, a few samples earlier at most. Raises TrajectoryError where the
    trajectory has no updates or no covariance.
    """
    if trajectory.updates is None or trajectory.covariance is None:
        raise TrajectoryError("innovations take a filter's trajectory with velocity updates")
    t, gyro, accel = log.t, log.gyro, log.accel
    rows = np.searchsorted(t, trajectory.updates.t - 1e-9)
    at = np.searchsorted(trajectory.t, trajectory.updates.t - 1e-9) - 1
    known = at >= 0
    rows, at = rows[known], at[known]
    R, v = trajectory.R_GI[at], trajectory.v_GI[at]
    S = R.transpose(0, 2, 1) @ trajectory.covariance[at][:, 3:6, 3:6] @ R
    first = np.searchsorted(t, trajectory.t[at] + 1e-9)
    for ahead in range(int((rows - first).max(initial=0)) + 1):
        row = np.minimum(first + ahead, rows)
        dt = np.where(first + ahead <= rows, t[row] - t[row - 1], 0.0)[:, None]
        f_G = np.einsum("mij,mj->mi", R, accel[row] - trajectory.b_a[at])
        v = v + (f_G + GRAVITY_G) * dt
        R = R @ Rotation.from_rotvec((gyro[row] - trajectory.b_g[at]) * dt).as_matrix()
    z = trajectory.updates.v_I[known] - np.einsum("mji,mj->mi", R, v)
    return Innovations(trajectory.updates.t[known], z, S)
