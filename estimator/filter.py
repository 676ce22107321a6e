"""The invariant filter with velocity and coverage updates, sample by sample or for a whole log."""

from typing import NamedTuple

import numpy as np
from scipy.special import ndtri

from surefoot.estimator.core.checks import (
    check_sound,
    check_step,
    check_velocity,
    numbers,
    spd,
    spd_3,
    vector,
)
from surefoot.estimator.core.propagation import PROPAGATE_CHECKED, propagate, propagate_checked
from surefoot.estimator.core.state import EXTRA, FilterNoise, NavState
from surefoot.estimator.evaluation.innovation_sums import empty_sums, windows_of
from surefoot.estimator.evaluation.trajectory import Trajectory, UpdateRecord
from surefoot.estimator.run import (
    NO_VELOCITIES,
    ImuSamples,
    Velocities,
    bounded_velocities,
    empty_estimates,
    every_row,
    gaussian_velocities,
    imu_samples,
    trajectory,
)
from surefoot.estimator.updates.bias_states import (
    BIAS_AT,
    EXTRAS,
    NOT_PERSISTENT,
    PersistentError,
    propagate_bias,
    update_coverage_persistent,
    update_velocity_persistent,
)
from surefoot.estimator.updates.coverage import update_coverage_within
from surefoot.estimator.updates.outliers import REJECTED, UNLIMITED, fresh_counts
from surefoot.estimator.updates.velocity import (
    UPDATE_VELOCITY_CHECKED,
    update_velocity,
    update_velocity_checked,
)
from surefoot.estimator.updates.velocity_output import add_velocity, no_contacts, note_velocity
from surefoot.sim.common.copies import copy_corner
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.kernels import compile_for, kernel


class CoverageSettings(NamedTuple):
    """Settings of coverage updates.

    Attributes:
        gamma: joint level of the bounds.
        iterations: of the projection.
        max_error: error (3,) [m/s] beyond which a measurement is an outlier.
    """

    gamma: float = 0.0
    iterations: int = 1
    max_error: np.ndarray = UNLIMITED


class FilterMemory(NamedTuple):
    """State that a filter carries from sample to sample, changed in place by the kernels.

    Attributes:
        mean: (7+E, 3), see `surefoot.estimator.core.state`.
        covariance: (15+3E, 15+3E).
        columns: (15+3E, 6), work space of `propagate`.
        rotation_columns: (3E, 3), work space of `propagate`.
        counts: (2,), see `surefoot.estimator.updates.outliers`.
    """

    mean: np.ndarray
    covariance: np.ndarray
    columns: np.ndarray
    rotation_columns: np.ndarray
    counts: np.ndarray


class InvariantFilter:
    """Right-invariant filter on SE_2(3) x R^6 (paper, Sec. II), called once per sample.

    state: NavState; covariance (15, 15) in the error order (rotation, velocity, position, b_a,
    b_g); noise: FilterNoise. `persistent`, where given, models the persistent part of the
    observer's error by additional states, so that successive measurements are not treated as
    independent, and coverage statements are about means (derived in
    `surefoot.estimator.updates.bias_states`).

    Raises SurefootError on wrong shapes, values that are not finite and covariances that are not
    positive definite; its subclass SampleError for steps and readings that no sensor gives;
    DivergedError once the state has diverged. In each case the filter is unchanged.
    """

    def __init__(
        self,
        state: NavState,
        covariance: np.ndarray,
        noise: FilterNoise | None = None,
        persistent: PersistentError | None = None,
    ):
        compile_for(propagate_checked, PROPAGATE_CHECKED)
        compile_for(update_velocity_checked, UPDATE_VELOCITY_CHECKED)
        self._noise = (noise or FilterNoise()).packed()
        covariance = spd("covariance", covariance, 15)
        self._persistent = None if persistent is None else persistent.model()
        self._mean = state.pack(0 if persistent is None else EXTRAS)
        self._covariance = covariance if persistent is None else persistent.enter(covariance)
        extras = len(self._mean) - EXTRA
        self._columns = np.zeros((15 + 3 * extras, 6))
        self._rotation_columns = np.zeros((3 * extras, 3))
        self._counts = fresh_counts()
        self.t = np.nan
        """Stamp [s] of the last sample, NaN before the first; `run` continues from there."""

    def predict(self, gyro: np.ndarray, accel: np.ndarray, dt: float) -> None:
        """IMU step (eq. covariance_propagation).

        gyro (3,) [rad/s] and accel (3,) [m/s^2], both in I, are means over the dt > 0 [s] that ends
        now.
        """
        # One compiled call checks and propagates. What it refuses is converted or reported below.
        try:
            done = propagate_checked(
                self._mean,
                self._covariance,
                gyro,
                accel,
                dt,
                self._noise,
                self._columns,
                self._rotation_columns,
            )
        except TypeError:
            done = False
        if not done:
            gyro, accel, dt = check_step(gyro, accel, dt)
            check_sound(self._mean, self._covariance)
            propagate(
                self._mean,
                self._covariance,
                gyro,
                accel,
                dt,
                self._noise,
                self._columns,
                self._rotation_columns,
            )
        if self._persistent:
            propagate_bias(self._mean, self._covariance, self._persistent, float(dt))

    def update_coverage(
        self,
        v_I: np.ndarray,
        epsilon: np.ndarray,
        gamma: float,
        iterations: int = 1,
        max_error: np.ndarray | None = None,
    ) -> float:
        """Algorithm 1 with P(|v_I - true v_I| <= epsilon) >= gamma, gamma the JOINT level.

        Returns pi, the prior mass inside the bounds (eq. pi_def_error_state); the state changes if
        pi < gamma. With a persistent part, epsilon bounds the mean mixing error of a window: pi is
        nan, and the state unchanged, except for the measurement that ends one.

        Args:
            v_I: measured velocity (3,) [m/s] in I.
            epsilon: its bounds (3,) > 0 [m/s].
            gamma: their joint level.
            iterations: of the projection; more than one bring the posterior's mass closer to gamma.
            max_error: errors beyond (3,) [m/s] are rejected as outliers
                (`surefoot.estimator.updates.outliers`); a persistent part has its own.
        """
        v_I, epsilon = check_velocity(v_I), vector("epsilon", epsilon)
        if not min(epsilon.tolist()) > 0:
            raise SurefootError("epsilon: every bound must be > 0 m/s")
        _check_level(gamma, iterations)
        limit = UNLIMITED if max_error is None else _limit(max_error, self._persistent is not None)
        mean, covariance, counts = self._mean, self._covariance, self._counts
        check_sound(mean, covariance)
        if self._persistent:
            return update_coverage_persistent(
                mean,
                covariance,
                v_I,
                epsilon,
                float(gamma),
                int(iterations),
                self._persistent,
                counts,
            )
        return update_coverage_within(
            mean, covariance, 0, v_I, epsilon, float(gamma), int(iterations), limit, counts
        )

    def update_velocity(self, v_I: np.ndarray, cov: np.ndarray) -> float:
        """Gaussian update with v_I (3,) [m/s] in I and its covariance (3, 3).

        Returns the squared Mahalanobis distance of the innovation. With a persistent part, cov is
        that of the mixing error, and the distance is nan where v_I was rejected as an outlier.
        """
        if self._persistent:
            v_I, cov = check_velocity(v_I), spd_3("cov", cov)
            check_sound(self._mean, self._covariance)
            return update_velocity_persistent(
                self._mean, self._covariance, v_I, cov, self._persistent, self._counts
            )
        # As in `predict`: the compiled check first.
        try:
            distance = update_velocity_checked(self._mean, self._covariance, 0, v_I, cov)
        except TypeError:
            distance = -1.0
        if distance >= 0.0:
            return distance
        v_I, cov = check_velocity(v_I), spd_3("cov", cov)
        check_sound(self._mean, self._covariance)
        return update_velocity(self._mean, self._covariance, 0, v_I, cov)

    def run(
        self,
        imu: ImuSamples,
        velocities: Velocities = NO_VELOCITIES,
        rows: np.ndarray | None = None,
        settings: CoverageSettings | None = None,
    ) -> Trajectory:
        """Process the next rows of a log in one compiled loop.

        The result is the same as with one call per row, however a log is divided into pieces.
        Updates are coverage updates where `velocities` have bounds and Gaussian ones where they
        have covariances. The record contains the coverage updates made, of a window the one at its
        end, and all Gaussian measurements, of which rejected ones are not `active`.

        Args:
            imu: the samples, from `imu_samples`.
            velocities: measured at some rows, from `bounded_velocities` or `gaussian_velocities`.
            rows: of these samples, whose estimates are returned; at 100 Hz by default.
            settings: of coverage updates.
        """
        settings = settings or CoverageSettings()
        found = empty_estimates(every_row(imu.t, None) if rows is None else rows)
        pi = np.full(len(velocities.rows), np.nan)
        memory = FilterMemory(
            self._mean, self._covariance, self._columns, self._rotation_columns, self._counts
        )
        model, persistent = self._persistent or NOT_PERSISTENT, self._persistent is not None
        window = windows_of(imu.t)
        sums = empty_sums(window, 1)
        share = _deviation_share(settings.gamma, model.window)
        _run(
            imu, velocities, settings, memory, self._noise, model, persistent, self.t, found, pi,
            window, sums.sums, share,
        )  # fmt: skip
        self.t = float(imu.t[-1])
        done, updates = np.isfinite(pi), None
        t, v_I, epsilon = imu.t[velocities.rows], velocities.v_I, velocities.epsilon
        if len(epsilon):
            active = pi[done] < settings.gamma
            updates = UpdateRecord(t[done], v_I[done], epsilon[done], pi[done], active)
        elif len(v_I):
            updates = UpdateRecord(t, v_I, None, None, done)
        return trajectory(imu.t, found, updates, sums)

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
        """Estimate (3,) [m/s] and covariance (3, 3) of the persistent error; None without one."""
        if self._persistent is None:
            return None
        return self._mean[EXTRA].copy(), self._covariance[BIAS_AT:, BIAS_AT:][:3, :3].copy()


@kernel
def _run(
    imu, velocities, settings, memory, noise, model, persistent, before, found, values, window,
    sums, share,
):  # fmt: skip
    """Run a filter over rows of a log; values (M,) receive what each update returns.

    Args:
        imu: ImuSamples.
        velocities: Velocities.
        settings: CoverageSettings.
        memory: FilterMemory.
        noise: from `FilterNoise.packed`.
        model: PersistentModel.
        persistent: whether the state has a persistent part.
        before: stamp of the row before the first [s], nan where there is none.
        found: Estimates to fill.
        values: pi of coverage updates, squared distances of Gaussian ones.
        window: index of each row's window (N,).
        sums: of the updates in each window, to fill (W, 1, 10).
        share: deviation of a measurement as a share of its bound, from `_deviation_share`.
    """
    mean, P, counts = memory.mean, memory.covariance, memory.counts
    columns, rotation_columns = memory.columns, memory.rotation_columns
    note, R = np.empty((7, 3)), np.zeros((3, 3))
    contacts = no_contacts()
    m = out = w = 0
    for k in range(imu.t.shape[0]):
        if k > 0 and window[k] != window[k - 1]:
            w += 1
        if not np.isnan(before):
            dt = imu.t[k] - before
            propagate(mean, P, imu.gyro[k], imu.accel[k], dt, noise, columns, rotation_columns)
            if persistent:
                propagate_bias(mean, P, model, dt)
        before = imu.t[k]
        if m < velocities.rows.shape[0] and velocities.rows[m] == k:
            v_I = velocities.v_I[m]
            rejected = counts[REJECTED]
            if velocities.epsilon.shape[0] > 0:
                epsilon, gamma, iterations = (
                    velocities.epsilon[m],
                    settings.gamma,
                    settings.iterations,
                )
                for i in range(3):
                    R[i, i] = (share * epsilon[i]) ** 2
                note_velocity(mean, P, contacts, v_I, R, note)
                if persistent:
                    values[m] = update_coverage_persistent(
                        mean, P, v_I, epsilon, gamma, iterations, model, counts
                    )
                else:
                    values[m] = update_coverage_within(
                        mean,
                        P,
                        contacts,
                        v_I,
                        epsilon,
                        gamma,
                        iterations,
                        settings.max_error,
                        counts,
                    )
            else:
                note_velocity(mean, P, contacts, v_I, velocities.cov[m], note)
                if persistent:
                    values[m] = update_velocity_persistent(
                        mean, P, v_I, velocities.cov[m], model, counts
                    )
                else:
                    values[m] = update_velocity(mean, P, contacts, v_I, velocities.cov[m])
            # An outlier after too many in a row is used, but still counted.
            add_velocity(sums[w, 0], note, counts[REJECTED] <= rejected)
            m += 1
        if out < found.rows.shape[0] and found.rows[out] == k:
            copy_corner(mean, found.mean[out])
            copy_corner(P, found.covariance[out])
            out += 1


def _deviation_share(gamma: float, window: int) -> float:
    """Standard deviation of a measurement as a share of its bound, for the record of innovations.

    A Gaussian error is within its bound on each axis with probability gamma^(1/3). Bounds of a mean
    over a window correspond to errors sqrt(window) times as large, if these are independent.
    """
    if gamma == 0.0:
        return 0.0
    return float(np.sqrt(window) / ndtri(0.5 + 0.5 * gamma ** (1 / 3)))


def coverage_settings(
    gamma: float, iterations: int, max_error, persistent: bool
) -> CoverageSettings:
    """Checked settings; raises SurefootError for values out of range.

    max_error (3,) [m/s] or None, which it must be for a filter with a persistent part.
    """
    _check_level(gamma, iterations)
    limit = UNLIMITED if max_error is None else _limit(max_error, persistent)
    return CoverageSettings(float(gamma), int(iterations), limit)


def _check_level(gamma: float, iterations: int) -> None:
    if not 0.0 < gamma < 1.0:
        raise SurefootError(f"gamma: {gamma} where a number inside (0, 1) is expected")
    if not 1 <= iterations <= 1000:
        raise SurefootError(f"iterations: {iterations} where a whole number in 1..1000 is expected")


def _limit(max_error, persistent: bool) -> np.ndarray:
    max_error = numbers("max_error", max_error, (3,))
    if not np.all(max_error > 0):
        raise SurefootError("max_error: every one must be > 0 m/s")
    if persistent:
        raise SurefootError("max_error: a persistent part has its own")
    return max_error


def run_imu(t, gyro, accel, state, covariance, noise=None, stride=None) -> Trajectory:
    """Integrate the IMU alone over a log.

    Args:
        t: (N,) [s].
        gyro: (N, 3) [rad/s] in I.
        accel: (N, 3) [m/s^2] in I, specific force.
        state: the initial state.
        covariance: of its error.
        noise: FilterNoise, or None for the defaults.
        stride: rows between returned estimates; 100 Hz by default.
    """
    imu = imu_samples(t, gyro, accel)
    return InvariantFilter(state, covariance, noise).run(imu, rows=every_row(imu.t, stride))


def run_velocity(
    t, gyro, accel, rows, v_I, cov, state, covariance, noise=None, stride=None, persistent=None
) -> Trajectory:
    """Gaussian velocity updates over a log.

    Args:
        t: (N,) [s].
        gyro: (N, 3) [rad/s] in I.
        accel: (N, 3) [m/s^2] in I, specific force.
        rows: (M,), the IMU rows of the updates.
        v_I: (M, 3) [m/s], measured velocity of the IMU in I.
        cov: (3, 3) or (M, 3, 3) [m^2/s^2], its covariance.
        state: the initial state.
        covariance: of its error.
        noise: FilterNoise, or None for the defaults.
        stride: rows between returned estimates; 100 Hz by default.
        persistent: as for `run_coverage`.
    """
    imu = imu_samples(t, gyro, accel)
    velocities = gaussian_velocities(rows, v_I, cov, len(imu.t))
    one = InvariantFilter(state, covariance, noise, persistent)
    return one.run(imu, velocities, every_row(imu.t, stride))


def run_coverage(
    t,
    gyro,
    accel,
    rows,
    v_I,
    epsilon,
    gamma,
    state,
    covariance,
    noise=None,
    stride=None,
    persistent=None,
    iterations: int = 1,
    max_error=None,
) -> Trajectory:
    """Coverage updates over a whole log, in one compiled loop equivalent to `InvariantFilter`.

    Args:
        t: stamps (N,) [s].
        gyro: (N, 3) [rad/s] in I; row k is the mean over (t[k-1], t[k]], so `state` is at row 0,
            which predicts nothing.
        accel: (N, 3) [m/s^2] in I, likewise.
        rows: increasing row indices (M,) of the measurements, each used after its row's prediction.
        v_I: measured velocities (M, 3) [m/s] in I.
        epsilon: bounds (3,) or (M, 3) [m/s].
        gamma: their joint level.
        state: NavState at t[0].
        covariance: (15, 15) of its error.
        noise: FilterNoise.
        stride: rows between returned estimates; 100 Hz by default.
        persistent: PersistentError, as for `InvariantFilter`.
        iterations: as for `InvariantFilter.update_coverage`.
        max_error: likewise.
    """
    imu = imu_samples(t, gyro, accel)
    velocities = bounded_velocities(rows, v_I, epsilon, len(imu.t))
    settings = coverage_settings(gamma, iterations, max_error, persistent is not None)
    one = InvariantFilter(state, covariance, noise, persistent)
    return one.run(imu, velocities, every_row(imu.t, stride), settings)
