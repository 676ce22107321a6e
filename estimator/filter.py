"""The invariant filter with velocity and coverage updates: one call a sample, or a whole log."""

import numpy as np

from surefoot.estimator.core.arrays import imu_arrays, outputs, row_indices, trajectory
from surefoot.estimator.core.propagation import propagate
from surefoot.estimator.core.quick import quick_predict, quick_velocity
from surefoot.estimator.core.state import EXTRA, FilterNoise, NavState, numbers, spd, spd_3, vector
from surefoot.estimator.evaluation.trajectory import Trajectory, UpdateRecord
from surefoot.estimator.updates.bias_states import (
    EXTRAS,
    NONE,
    PersistentError,
    propagate_bias,
    update_coverage_persistent,
    update_velocity_persistent,
)
from surefoot.estimator.updates.coverage import update_coverage_within
from surefoot.estimator.updates.outliers import ANY
from surefoot.estimator.updates.velocity import update_velocity
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.kernels import kernel


class InvariantFilter:
    """Right-invariant filter on SE_2(3) x R^6 (paper, Sec. II): one call a sample.

    state: NavState; covariance (15, 15) in the error order (rotation, velocity, position, b_a,
    b_g); noise: FilterNoise. `persistent`, where given, describes a part of the
    observer's error that lasts: it becomes three more states, so that a stream of measurements is
    not taken for independent news, and coverage statements are about means (the derivation is in
    `estimator.updates.bias_states`). Raises SurefootError on wrong shapes, values that are not
    finite and
    covariances that are not positive definite.
    """

    def __init__(
        self,
        state: NavState,
        covariance: np.ndarray,
        noise: FilterNoise | None = None,
        persistent: PersistentError | None = None,
    ):
        self._noise = (noise or FilterNoise()).packed()
        self._mean, self._covariance = _start(state, covariance, persistent)
        self._persistent = None if persistent is None else persistent.model()
        self._columns, self._rotation_columns = _work(self._mean)
        self._left_out = np.zeros(2, dtype=np.int64)

    def predict(self, gyro: np.ndarray, accel: np.ndarray, dt: float) -> None:
        """IMU step (eq. covariance_propagation): gyro (3,) [rad/s] and accel (3,) [m/s^2], both in
        I, are means over the dt > 0 [s] that ends now.
        """
        try:
            done = quick_predict(
                self._mean, self._covariance, gyro, accel, dt, self._noise, self._columns,
                self._rotation_columns,
            )  # fmt: skip
        except TypeError:
            done = False
        if not done:
            gyro, accel = numbers("gyro", gyro, (3,)), numbers("accel", accel, (3,))
            if not 0.0 < dt < np.inf:
                raise SurefootError(f"dt: {dt} where a number > 0 is expected")
            propagate(
                self._mean, self._covariance, gyro, accel, float(dt), self._noise, self._columns,
                self._rotation_columns,
            )  # fmt: skip
        if self._persistent:
            propagate_bias(self._mean, self._covariance, *self._persistent[:2], float(dt))

    def update_coverage(
        self, v_I: np.ndarray, epsilon: np.ndarray, gamma: float, iterations: int = 1, reach=None
    ) -> float:
        """Algorithm 1 with P(|v_I - true v_I| <= epsilon) >= gamma, gamma the JOINT level.

        v_I (3,) and epsilon (3,) > 0 in m/s, in I. Returns pi, the prior mass inside the bounds
        (eq. pi_def_error_state); the state changed if pi < gamma. More than one of `iterations`
        repeats the projection, so that the posterior holds closer to gamma. With a persistent part
        epsilon bounds the mean mixing error of a window: pi is nan, and the state unchanged, but
        for the measurement that ends one. Errors beyond reach (3,) [m/s] are outliers and left out,
        where it is given (`estimator.updates.outliers`); a persistent part has its own.
        """
        v_I, epsilon = vector("v_I", v_I), vector("epsilon", epsilon)
        if not min(epsilon.tolist()) > 0:
            _bounds(epsilon, (3,))
        _check_gamma(gamma, iterations)
        reach = ANY if reach is None else _reach(reach, self._persistent)
        if self._persistent:
            return update_coverage_persistent(
                self._mean, self._covariance, v_I, epsilon, float(gamma), int(iterations),
                *self._persistent[2:],
            )  # fmt: skip
        return update_coverage_within(
            self._mean, self._covariance, 0, v_I, epsilon, float(gamma), int(iterations), reach,
            self._left_out,
        )  # fmt: skip

    def update_velocity(self, v_I: np.ndarray, cov: np.ndarray) -> float:
        """Gaussian update with v_I (3,) [m/s] in I and its covariance (3, 3). Returns the squared
        Mahalanobis distance of the innovation. With a persistent part cov is that of the mixing
        error, and the distance is nan where v_I was left out as an outlier.
        """
        if self._persistent:
            v_I, cov = vector("v_I", v_I), spd_3("cov", cov)
            return update_velocity_persistent(
                self._mean, self._covariance, v_I, cov, *self._persistent[2:]
            )
        try:
            distance = quick_velocity(self._mean, self._covariance, 0, v_I, cov)
        except TypeError:
            distance = -1.0
        if distance >= 0.0:
            return distance
        v_I, cov = vector("v_I", v_I), spd_3("cov", cov)
        return update_velocity(self._mean, self._covariance, 0, v_I, cov)

    @property
    def state(self) -> NavState:
        """The estimate (a copy)."""
        return NavState.unpack(self._mean)

    @property
    def covariance(self) -> np.ndarray:
        """Covariance (15, 15) of the error state (a copy)."""
        return self._covariance[:15, :15].copy()

    @property
    def persistent(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Estimate (3,) [m/s] and covariance (3, 3) of the persistent error, None without one."""
        if self._persistent is None:
            return None
        return self._mean[EXTRA].copy(), self._covariance[15:18, 15:18].copy()


def run_imu(t, gyro, accel, state, covariance, noise=None, stride=None) -> Trajectory:
    """Integrate the IMU alone over a log: t (N,), gyro and accel (N, 3); see `run_coverage`."""
    none = np.zeros((0, 3))
    return _run(t, gyro, accel, none[:, 0], none, None, None, 0.0, state, covariance, noise, stride)


def run_velocity(
    t, gyro, accel, rows, v_I, cov, state, covariance, noise=None, stride=None, persistent=None
) -> Trajectory:
    """Gaussian velocity updates over a log; cov (3, 3) or (M, 3, 3), the rest as `run_coverage`."""
    v_I = numbers("v_I", v_I, (-1, 3))
    if np.ndim(cov) == 2:
        cov = np.broadcast_to(spd("cov", cov, 3), (len(v_I), 3, 3))
    cov = numbers("cov", cov, (len(v_I), 3, 3))
    if len(cov) and np.linalg.eigvalsh(cov).min() <= 0:
        raise SurefootError("cov: is not positive definite in every row")
    return _run(
        t, gyro, accel, rows, v_I, None, cov, 0.0, state, covariance, noise, stride, persistent
    )


def run_coverage(
    t, gyro, accel, rows, v_I, epsilon, gamma, state, covariance, noise=None, stride=None,
    persistent=None, iterations: int = 1, reach=None,
) -> Trajectory:  # fmt: skip
    """Coverage updates over a whole log, one compiled loop with the numbers of `InvariantFilter`.

    t (N,) [s], gyro (N, 3) and accel (N, 3): row k holds the means over (t[k-1], t[k]], so row 0
    is where `state` stands and predicts nothing. rows (M,) are the increasing row indices of the
    measurements v_I (M, 3) [m/s], each applied after its row's prediction; epsilon (3,) or (M, 3)
    [m/s], gamma the joint level, `iterations` and `reach` as `InvariantFilter.update_coverage`,
    `persistent` as `InvariantFilter`. Output every `stride` rows, by default at 100 Hz.
    """
    v_I = numbers("v_I", v_I, (-1, 3))
    if np.ndim(epsilon) == 1:
        epsilon = np.broadcast_to(_bounds(epsilon, (3,)), v_I.shape)
    epsilon = _bounds(epsilon, v_I.shape)
    _check_gamma(gamma, iterations)
    return _run(
        t, gyro, accel, rows, v_I, epsilon, None, gamma, state, covariance, noise, stride,
        persistent, iterations, ANY if reach is None else _reach(reach, persistent),
    )  # fmt: skip


def _run(
    t, gyro, accel, rows, v_I, epsilon, cov, gamma, state, covariance, noise, stride,
    persistent=None, iterations=1, reach=ANY,
):  # fmt: skip
    t, gyro, accel, stride = imu_arrays(t, gyro, accel, stride)
    rows = row_indices(rows, len(v_I), len(t))
    mean, P = _start(state, covariance, persistent)
    model = (*NONE[:3], reach, np.zeros(2, dtype=np.int64))
    if persistent is not None:
        model = persistent.model()
    out_mean, out_cov = outputs(len(t), stride)
    pi = np.full(len(rows), np.nan)
    _loop(
        t, gyro, accel, rows, v_I,
        np.zeros((0, 3)) if epsilon is None else epsilon,
        np.zeros((0, 3, 3)) if cov is None else cov,
        float(gamma), int(iterations), mean, P, (noise or FilterNoise()).packed(), *_work(mean),
        stride, out_mean, out_cov, pi,
        persistent is not None, *model,
    )  # fmt: skip
    updates = None
    # Of a window, the record has the measurement that ended it; of velocities, those not left out.
    done = np.isfinite(pi)
    if epsilon is not None:
        updates = UpdateRecord(t[rows[done]], v_I[done], epsilon[done], pi[done], pi[done] < gamma)
    elif cov is not None:
        updates = UpdateRecord(t[rows], v_I, None, None, done)
    return trajectory(t[::stride], out_mean, out_cov, updates)


@kernel
def _loop(
    t, gyro, accel, rows, v_I, epsilon, cov, gamma, iterations, mean, P, noise, columns,
    rotation_columns, stride, out_mean, out_cov, pi, lasting, prior, time_constant, window, reach,
    counts,
):  # fmt: skip
    m = 0
    for k in range(t.shape[0]):
        if k > 0:
            dt = t[k] - t[k - 1]
            propagate(mean, P, gyro[k], accel[k], dt, noise, columns, rotation_columns)
            if lasting:
                propagate_bias(mean, P, prior, time_constant, dt)
        if m < rows.shape[0] and rows[m] == k:
            if epsilon.shape[0] > 0 and lasting:
                pi[m] = update_coverage_persistent(
                    mean, P, v_I[m], epsilon[m], gamma, iterations, window, reach, counts
                )
            elif epsilon.shape[0] > 0:
                pi[m] = update_coverage_within(
                    mean, P, 0, v_I[m], epsilon[m], gamma, iterations, reach, counts
                )
            elif lasting:
                pi[m] = update_velocity_persistent(mean, P, v_I[m], cov[m], window, reach, counts)
            else:
                pi[m] = update_velocity(mean, P, 0, v_I[m], cov[m])
            m += 1
        if k % stride == 0:
            out_mean[k // stride] = mean[:7]
            out_cov[k // stride] = P[:15, :15]


def _start(
    state: NavState, covariance, persistent: PersistentError | None
) -> tuple[np.ndarray, np.ndarray]:
    covariance = spd("covariance", covariance, 15)
    if persistent is None:
        return state.pack(), covariance
    return state.pack(EXTRAS), persistent.enter(covariance)


def _work(mean: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    extras = len(mean) - EXTRA
    return np.zeros((15 + 3 * extras, 6)), np.zeros((3 * extras, 3))


def _bounds(epsilon, shape) -> np.ndarray:
    epsilon = numbers("epsilon", epsilon, shape)
    if not np.all(epsilon > 0):
        raise SurefootError("epsilon: every bound must be > 0 m/s")
    return epsilon


def _reach(reach, persistent) -> np.ndarray:
    reach = numbers("reach", reach, (3,))
    if not np.all(reach > 0):
        raise SurefootError("reach: every one must be > 0 m/s")
    if persistent:
        raise SurefootError("reach: a persistent part has its own")
    return reach


def _check_gamma(gamma: float, iterations: int) -> None:
    if not 0.0 < gamma < 1.0:
        raise SurefootError(f"gamma: {gamma} where a number inside (0, 1) is expected")
    if not 1 <= iterations <= 1000:
        raise SurefootError(f"iterations: {iterations} where a whole number in 1..1000 is expected")
