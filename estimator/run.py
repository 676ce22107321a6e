"""What the filters share: rows of a log for the compiled loops, estimates, and the trajectory.

Row k of a log holds gyro and accel as means over (t[k-1], t[k]]. The first row is therefore the
time of the filter's initial state and predicts nothing; every later row predicts, then updates.
"""

from typing import Any, NamedTuple

import numpy as np

from surefoot.estimator.core.checks import (
    check_sound,
    check_velocity,
    numbers,
    row_indices,
    spd,
)
from surefoot.estimator.core.state import B_A, B_G, NavState, P, V
from surefoot.estimator.evaluation.innovation_sums import InnovationSums
from surefoot.estimator.evaluation.trajectory import Trajectory, UpdateRecord
from surefoot.estimator.updates.velocity import (
    UPDATE_VELOCITY,
    VelocityMemory,
    update_velocity_checked,
)
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.kernels import compiled

FLOAT = np.dtype(float)
"""The type of numbers; `float` itself takes longer to convert to."""
OUTPUT_PERIOD = 0.01
"""Default interval between stored estimates [s]."""


class ImuSamples(NamedTuple):
    """IMU samples: t (N,) [s]; gyro (N, 3) [rad/s] and accel (N, 3) [m/s^2] in I, means over
    (t[k-1], t[k]].
    """

    t: np.ndarray
    gyro: np.ndarray
    accel: np.ndarray


class Velocities(NamedTuple):
    """Measured velocities of the IMU, each used after the prediction of its row.

    rows (M,), increasing; v_I (M, 3) [m/s] in I. A coverage update uses the bounds epsilon (M, 3)
    [m/s], a Gaussian one the covariances cov (M, 3, 3) [m^2/s^2]; the other is empty.
    """

    rows: np.ndarray
    v_I: np.ndarray
    epsilon: np.ndarray
    cov: np.ndarray


class Estimates(NamedTuple):
    """Packed means (L, 7, 3) and covariances (L, 15, 15) at some rows (L,) of the log."""

    rows: np.ndarray
    mean: np.ndarray
    covariance: np.ndarray


NO_VELOCITIES = Velocities(
    np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3, 3))
)


def imu_samples(t, gyro, accel, after: float | None = None) -> ImuSamples:
    """Checked samples of a whole log, or of a piece that follows the stamp `after`.

    Raises SurefootError naming what is wrong.

    Args:
        t: strictly increasing (N,) [s]; at least two rows for a whole log.
        gyro: (N, 3) [rad/s] in I.
        accel: (N, 3) [m/s^2] in I.
        after: None for a whole log, NaN for its first piece.
    """
    t = numbers("t", t, (-1,))
    gyro, accel = numbers("gyro", gyro, (len(t), 3)), numbers("accel", accel, (len(t), 3))
    if len(t) < (2 if after is None else 1) or not np.all(np.diff(t) > 0):
        raise SurefootError("t: needs two rows or more, strictly increasing")
    if after is not None and t[0] <= after:
        raise SurefootError(f"t: {t[0]} does not follow {after}")
    return ImuSamples(t, gyro, accel)


def gaussian_velocities(rows, v_I, cov, n: int) -> Velocities:
    """Checked velocities at `rows` of n, with their covariance (3, 3) or covariances (M, 3, 3)."""
    v_I = numbers("v_I", v_I, (-1, 3))
    cov = np.broadcast_to(cov, (len(v_I), 3, 3)) if np.ndim(cov) == 2 else cov
    cov = numbers("cov", cov, (len(v_I), 3, 3))
    if len(cov) and np.linalg.eigvalsh(cov).min() <= 0:
        raise SurefootError("cov: is not positive definite in every row")
    return Velocities(row_indices(rows, len(v_I), n), v_I, np.zeros((0, 3)), cov)


def bounded_velocities(rows, v_I, epsilon, n: int) -> Velocities:
    """Checked velocities at `rows` of n, with their bounds (3,) or (M, 3) [m/s]."""
    v_I = numbers("v_I", v_I, (-1, 3))
    epsilon = np.broadcast_to(epsilon, v_I.shape) if np.ndim(epsilon) == 1 else epsilon
    epsilon = numbers("epsilon", epsilon, v_I.shape)
    return Velocities(row_indices(rows, len(v_I), n), v_I, epsilon, np.zeros((0, 3, 3)))


def output_stride(t: np.ndarray) -> int:
    """Rows between estimates that are stored by default, at OUTPUT_PERIOD; t (N,) [s]."""
    period = float(np.median(np.diff(t))) if len(t) > 1 else OUTPUT_PERIOD
    return max(1, round(OUTPUT_PERIOD / period))


def every_row(t: np.ndarray) -> np.ndarray:
    """Rows whose estimates are stored by default."""
    return np.arange(0, len(t), output_stride(t))


def empty_estimates(t: np.ndarray, rows: np.ndarray | None) -> Estimates:
    """Estimates at these rows of t (N,) [s], by default `every_row`, to be filled."""
    rows = every_row(t) if rows is None else rows
    return Estimates(rows, np.empty((len(rows), 7, 3)), np.empty((len(rows), 15, 15)))


def trajectory(
    t: np.ndarray,
    found: Estimates,
    updates: UpdateRecord | None = None,
    innovations: InnovationSums | None = None,
) -> Trajectory:
    """Trajectory of estimates at rows of t, up to the first that is not finite.

    Args:
        t: stamps (N,) [s] of all rows.
        found: the estimates at some of them.
        updates: their record.
        innovations: their sums.
    """
    t, mean = t[found.rows], found.mean
    good = np.isfinite(mean).all(axis=(1, 2)) & np.isfinite(found.covariance).all(axis=(1, 2))
    end = len(t) if good.all() else int(np.argmin(good))
    t, mean, covariance = t[:end], mean[:end], found.covariance[:end]
    diverged = end < len(found.rows)
    return Trajectory(t, *state_parts(mean), covariance, updates, innovations, diverged)


def state_parts(
    mean: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """R_GI (L, 3, 3), v_GI, p_GI, b_a and b_g (L, 3) of packed means (L, 7, 3)."""
    return mean[:, :3], mean[:, V], mean[:, P], mean[:, B_A], mean[:, B_G]


class NavigationFilter:
    """What the filters have in common: the state that they carry from sample to sample, and the
    Gaussian update with a velocity.

    Attributes:
        t: stamp [s] of the last sample, NaN before the first; `run` continues from there.
    """

    t: float
    _memory: Any  # FilterMemory or ContactMemory
    _contacts: int = 0  # contact points in the state
    _velocity: VelocityMemory

    @property
    def state(self) -> NavState:
        """The estimate (a copy)."""
        return NavState.unpack(self._memory.mean)

    @property
    def covariance(self) -> np.ndarray:
        """Covariance (15, 15) of the error state, without extras (a copy)."""
        return self._memory.covariance[:15, :15].copy()

    def update_velocity(self, v_I: np.ndarray, cov: np.ndarray) -> float:
        """Gaussian update with v_I (3,) [m/s] in I and its covariance (3, 3), or in a
        PersistentFilter that of its mixing error.

        Returns the squared Mahalanobis distance of the innovation; nan where v_I was rejected as an
        outlier.
        """
        update, state = compiled(update_velocity_checked, UPDATE_VELOCITY), self._memory[:2]
        try:
            given = np.ascontiguousarray(v_I, FLOAT), np.ascontiguousarray(cov, FLOAT)
            distance = update(*state, self._contacts, *given, *self._velocity[:3])
        except (TypeError, ValueError):  # not numbers of these shapes
            distance = -1.0
        if distance < 0.0:
            check_velocity(v_I)
            spd("cov", cov, 3)
            check_sound(*state)
        return distance
