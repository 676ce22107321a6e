"""The invariant filters with velocity and coverage updates, by sample or for a whole log."""

from typing import NamedTuple

import numpy as np
from scipy.special import ndtri

from surefoot.estimator.core.checks import (
    check_bounds,
    check_sound,
    check_step,
    check_velocity,
    numbers,
    spd,
)
from surefoot.estimator.core.propagation import PREDICT, predict_checked, propagate
from surefoot.estimator.core.state import EXTRA, FilterNoise, NavState
from surefoot.estimator.evaluation.innovation_sums import empty_sums
from surefoot.estimator.evaluation.trajectory import Trajectory, UpdateRecord
from surefoot.estimator.run import (
    FLOAT,
    NO_VELOCITIES,
    ImuSamples,
    NavigationFilter,
    Velocities,
    empty_estimates,
    trajectory,
)
from surefoot.estimator.updates.bias_states import (
    BIAS_AT,
    EXTRAS,
    PersistentError,
    propagate_bias,
)
from surefoot.estimator.updates.coverage import (
    UPDATE_COVERAGE,
    update_coverage,
    update_coverage_checked,
)
from surefoot.estimator.updates.velocity import (
    add_velocity,
    no_contacts,
    update_velocity,
    velocity_memory,
)
from surefoot.sim.common.copies import copy_corner
from surefoot.sim.common.kernels import compiled, kernel

_array = np.ascontiguousarray


class CoverageSettings(NamedTuple):
    """Settings of coverage updates.

    Attributes:
        gamma: joint level of the bounds.
        iterations: of the projection.
    """

    gamma: float = 0.0
    iterations: int = 1


class FilterMemory(NamedTuple):
    """State that a filter carries from sample to sample, changed in place by the kernels.

    Attributes:
        mean: (7+E, 3), see `surefoot.estimator.core.state`.
        covariance: (15+3E, 15+3E).
        noise: (4, 3), from `FilterNoise.packed`.
        columns: (15+3E, 6), work space of `propagate`.
        coupling: (3E, 3), zeros, of the extras to the rotation error.
        prior: of a persistent error about the course's (3, 3) [m^2/s^2]; zero without one.
        time_constant: of the persistent error [s].
    """

    mean: np.ndarray
    covariance: np.ndarray
    noise: np.ndarray
    columns: np.ndarray
    coupling: np.ndarray
    prior: np.ndarray
    time_constant: float


class InvariantFilter(NavigationFilter):
    """Right-invariant filter on SE_2(3) x R^6 (paper, Sec. II), called once per sample.

    state: NavState; covariance (15, 15) in the error order (rotation, velocity, position, b_a,
    b_g); noise: FilterNoise; persistent: error of an observer to be estimated as well, see
    `PersistentFilter`.

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
        compiled(predict_checked, PREDICT)
        covariance, extras = spd("covariance", covariance, 15), 0
        prior, time_constant = np.zeros((3, 3)), np.inf
        self._velocity = velocity_memory()
        if persistent is not None:
            covariance, extras = persistent.enter(covariance), EXTRAS
            prior, time_constant = persistent.covariance, float(persistent.time_constant)
            self._velocity = velocity_memory(persistent.max_error, int(persistent.window))
        n = EXTRA + extras
        # What a prediction takes lies in few arrays: each costs 40 ns in a call.
        self._vectors = np.zeros((n + 6 + 3 * extras, 3))
        self._vectors[:n] = state.pack(extras)
        self._vectors[n : n + 4] = (noise or FilterNoise()).packed()
        self._memory = FilterMemory(
            self._vectors[:n],
            covariance,
            self._vectors[n : n + 4],
            np.zeros((15 + 3 * extras, 6)),
            self._vectors[n + 6 :],
            prior,
            time_constant,
        )
        self.t = np.nan

    def predict(self, gyro: np.ndarray, accel: np.ndarray, dt: float) -> None:
        """IMU step (eq. covariance_propagation).

        gyro (3,) [rad/s] and accel (3,) [m/s^2], both in I, are means over the dt > 0 [s] that ends
        now.
        """
        memory = self._memory
        try:
            omega, force = _array(gyro, FLOAT), _array(accel, FLOAT)
            work = self._vectors, memory.covariance, memory.columns
            done = predict_checked(*work, omega, force, float(dt))
        except (TypeError, ValueError):  # not three numbers
            done = False
        if not done:
            check_step(gyro, accel, dt)
            check_sound(*memory[:2])
        if memory.time_constant < np.inf:
            propagate_bias(*memory[:2], memory.prior, memory.time_constant, float(dt))

    def update_coverage(
        self, v_I: np.ndarray, epsilon: np.ndarray, gamma: float, iterations: int = 1
    ) -> float:
        """Algorithm 1 with P(|v_I - true v_I| <= epsilon) >= gamma, gamma the JOINT level.

        A PersistentFilter counts the measurement instead and, at the end of a window, updates with
        P(|mean mixing error| <= epsilon) >= gamma.

        Returns pi, the prior mass inside the bounds (eq. pi_def_error_state); the state changes if
        pi < gamma. nan where v_I was rejected as an outlier, and within a window.

        Args:
            v_I: measured velocity (3,) [m/s] in I.
            epsilon: its bounds (3,) > 0 [m/s] or, of a window, those of the mean mixing error.
            gamma: their joint level.
            iterations: of the projection; more than one bring the posterior's mass closer to gamma.
        """
        update, state = compiled(update_coverage_checked, UPDATE_COVERAGE), self._memory[:2]
        try:
            given = _array(v_I, FLOAT), _array(epsilon, FLOAT), float(gamma), int(iterations)
            pi = update(*state, *given, *self._velocity[:3])
        except (TypeError, ValueError):  # not three numbers
            pi = -1.0
        if pi < 0.0:
            check_velocity(v_I)
            check_bounds(numbers("epsilon", epsilon, (3,)), gamma, iterations)
            check_sound(*state)
        return pi

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
        if len(velocities.epsilon):
            check_bounds(velocities.epsilon, settings.gamma, settings.iterations)
        found = empty_estimates(imu.t, rows)
        pi = np.full(len(velocities.rows), np.nan)
        sums, window = empty_sums(imu.t, 1)
        share = _deviation_share(settings.gamma, self._velocity.window)
        start = self._memory, self._velocity, self.t
        _run(imu, velocities, settings, *start, found, pi, window, sums.sums, share)
        self.t = float(imu.t[-1])
        done, updates = np.isfinite(pi), None
        t, v_I, epsilon = imu.t[velocities.rows], velocities.v_I, velocities.epsilon
        if len(epsilon):
            active = pi[done] < settings.gamma
            updates = UpdateRecord(t[done], v_I[done], epsilon[done], pi[done], active)
        elif len(v_I):
            updates = UpdateRecord(t, v_I, None, None, done)
        return trajectory(imu.t, found, updates, sums)


class PersistentFilter(InvariantFilter):
    """The invariant filter with the persistent part of an observer's error as additional states.

    Successive measurements are then not treated as independent, and coverage statements are about
    means (derived in `surefoot.estimator.updates.bias_states`). Arguments and errors are those of
    `InvariantFilter`; persistent: the model of the error.
    """

    def __init__(
        self,
        state: NavState,
        covariance: np.ndarray,
        persistent: PersistentError,
        noise: FilterNoise | None = None,
    ):
        super().__init__(state, covariance, noise, persistent)

    @property
    def persistent(self) -> tuple[np.ndarray, np.ndarray]:
        """Estimate (3,) [m/s] and covariance (3, 3) of the persistent error (copies)."""
        mean, covariance = self._memory[:2]
        return mean[EXTRA].copy(), covariance[BIAS_AT:, BIAS_AT:][:3, :3].copy()


@kernel
def _run(
    imu, velocities, settings, memory, measured, before, found, values, window, sums, share
):  # fmt: skip
    """Run a filter over rows of a log; values (M,) receive what each update returns.

    Args:
        imu: ImuSamples.
        velocities: Velocities.
        settings: CoverageSettings.
        memory: FilterMemory; a state with extras has a persistent part.
        measured: VelocityMemory.
        before: stamp of the row before the first [s], nan where there is none.
        found: Estimates to fill.
        values: pi of coverage updates, squared distances of Gaussian ones.
        window: index of each row's window (N,).
        sums: of the updates in each window, to fill (W, 1, 10).
        share: deviation of a measurement as a share of its bound, from `_deviation_share`.
    """
    mean, P, noise = memory.mean, memory.covariance, memory.noise
    columns, coupling = memory.columns, memory.coupling
    gamma, iterations = settings.gamma, settings.iterations
    persistent = mean.shape[0] > EXTRA
    R, contacts = np.zeros((3, 3)), no_contacts()
    m = out = 0
    for k in range(imu.t.shape[0]):
        if not np.isnan(before):
            dt = imu.t[k] - before
            propagate(mean, P, imu.gyro[k], imu.accel[k], dt, noise, columns, coupling)
            if persistent:
                propagate_bias(mean, P, memory.prior, memory.time_constant, dt)
        before = imu.t[k]
        if m < velocities.rows.shape[0] and velocities.rows[m] == k:
            v_I = velocities.v_I[m]
            if velocities.epsilon.shape[0] > 0:
                epsilon = velocities.epsilon[m]
                for i in range(3):
                    R[i, i] = (share * epsilon[i]) ** 2
                values[m] = update_coverage(mean, P, v_I, epsilon, gamma, iterations, measured)
            else:
                copy_corner(velocities.cov[m], R)
                values[m] = update_velocity(mean, P, contacts, v_I, R, measured)
            add_velocity(sums[window[k], 0], measured, R)
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
