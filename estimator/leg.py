"""The leg filter: contact-aided right-invariant EKF (Hartley 2020) with feet that roll."""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from surefoot.estimator.core.checks import (
    MOST_RATE,
    MOST_REACH,
    SampleError,
    all_within,
    amounts,
    check_sound,
    check_step,
    numbers,
    spd,
)
from surefoot.estimator.core.state import EXTRA, FilterNoise, NavState
from surefoot.estimator.evaluation.innovation_sums import empty_sums
from surefoot.estimator.evaluation.trajectory import Trajectory
from surefoot.estimator.run import (
    NO_VELOCITIES,
    ImuSamples,
    NavigationFilter,
    Velocities,
    empty_estimates,
    trajectory,
)
from surefoot.estimator.updates.contact import (
    PREDICT_CONTACTS,
    UPDATE_CONTACTS,
    ContactModel,
    contact_memory,
    predict_contacts,
    propagate_contacts,
    update_contacts,
    update_contacts_checked,
)
from surefoot.estimator.updates.velocity import add_velocity, update_velocity, velocity_memory
from surefoot.sim.common.copies import copy_corner
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.kernels import compiled, kernel


class LegSamples(NamedTuple):
    """Leg kinematics of each row.

    Attributes:
        feet_I: foot centres in I (N, K, 3) [m].
        contact: feet in stance (N, K) bool.
        covariance: of the centres (N, K, 3, 3) [m^2].
        rates_I: angular velocity of the feet relative to the body, in I (N, K, 3) [rad/s].
    """

    feet_I: np.ndarray
    contact: np.ndarray
    covariance: np.ndarray
    rates_I: np.ndarray


@dataclass(frozen=True)
class LegNoise:
    """Noise of the leg filter.

    Attributes:
        imu: the IMU's densities.
        contact: velocity noise of a standing foot along G's axes, one number or three
            [m/s/sqrt(Hz)]. 0.02 lets a foot creep by about 1 cm in a stance of 0.3 s (Hartley 2020
            uses 0.1 m/s a step for feet that deform).
        rolling: error of the angular velocity with which a foot rolls [rad/s/sqrt(Hz)]; it acts
            through the foot's radius.
    """

    imu: FilterNoise = field(default_factory=FilterNoise)
    contact: float | np.ndarray = 0.02
    rolling: float = 0.1

    def packed(self) -> tuple[np.ndarray, float]:
        """Squared densities of the contact (3,) and of the rolling."""
        contact = amounts("noise: contact", self.contact, 3)
        if not 0.0 <= self.rolling < np.inf:
            raise SurefootError("noise: rolling must be a finite number >= 0")
        return contact**2, float(self.rolling) ** 2


class LegFilter(NavigationFilter):
    """Contact-aided invariant EKF, called once per sample.

    state, covariance (15, 15) as for `InvariantFilter`; noise: LegNoise. foot_radius [m]: 0 for
    point feet, or one value for each foot (K,); `feet` is K. slip_gate, if given, is the squared
    Mahalanobis distance (3 degrees of freedom; 16.27 is exceeded by chance once in 1000) of an
    innovation, or of their running mean, beyond which a foot slips and is left out (`leg_slip`). If
    all feet fail the test for long, the filter increases its covariance and admits them again.
    Raises like `InvariantFilter`.
    """

    def __init__(
        self,
        state: NavState,
        covariance: np.ndarray,
        noise: LegNoise | None = None,
        foot_radius: float | np.ndarray = 0.0,
        feet: int = 4,
        slip_gate: float | None = None,
    ):
        noise = noise or LegNoise()
        P = np.zeros((15 + 3 * feet, 15 + 3 * feet))
        P[:15, :15] = spd("covariance", covariance, 15)
        radius = amounts("foot_radius", foot_radius, feet)
        gate = np.inf if slip_gate is None else float(slip_gate)
        if not gate > 0:
            raise SurefootError(f"slip_gate: {slip_gate} where a number > 0 is expected")
        self._model = ContactModel(noise.imu.packed(), *noise.packed(), radius, gate)
        self._memory = contact_memory(state.pack(feet), P)
        self._contacts = feet
        self._velocity = velocity_memory()
        self.t = np.nan

    def predict(
        self, gyro: np.ndarray, accel: np.ndarray, dt: float, foot_rates_I: np.ndarray | None = None
    ) -> None:
        """IMU step over the dt > 0 [s] that ends now; gyro (3,) and accel (3,) are its means, in I.

        foot_rates_I (K, 3) [rad/s]: angular velocity of each foot relative to the body now, in I,
        averaged with the last call's over the step. Not needed for feet of radius 0.
        """
        memory, rates = self._memory, foot_rates_I
        if rates is None:
            rates = self._rates(None)
        try:
            given = np.array(gyro, dtype=float), np.array(accel, dtype=float), float(dt)
            rates = np.array(rates, dtype=float, order="C")
            done = compiled(predict_contacts, PREDICT_CONTACTS)(memory, self._model, *given, rates)
        except (TypeError, ValueError):  # not numbers of these shapes
            done = False
        if not done:
            check_step(gyro, accel, dt)
            if not all_within(self._rates(foot_rates_I).reshape(-1), MOST_RATE):
                raise SampleError(f"foot_rates_I: beyond {MOST_RATE:g} rad/s")
            check_sound(memory.mean, memory.covariance)

    def _rates(self, foot_rates_I, rows: tuple[int, ...] = ()) -> np.ndarray:
        """Checked rates (*rows, K, 3) of the feet, zero if not needed."""
        shape = (*rows, len(self._model.radius), 3)
        if foot_rates_I is None:
            if self._model.radius.any():
                raise SurefootError("foot_rates_I: needed, as foot_radius is not 0")
            return np.zeros(shape)
        return numbers("foot_rates_I", foot_rates_I, shape)

    def update_contacts(
        self, foot_positions_I: np.ndarray, in_contact: np.ndarray, covariance: np.ndarray
    ) -> np.ndarray:
        """Update with the leg kinematics.

        foot_positions_I (K, 3) [m]: foot centres in I; in_contact (K,): feet in stance; covariance
        (K, 3, 3) [m^2] of the positions. Returns (K,) bool: feet found slipping.
        """
        memory, standing = self._memory, np.array(in_contact, dtype=np.bool_)
        try:
            given = np.array(foot_positions_I, dtype=float, order="C"), standing
            noise = np.array(covariance, dtype=float, order="C")
            update = compiled(update_contacts_checked, UPDATE_CONTACTS)
            done = update(memory, self._model.gate, *given, noise)
        except (TypeError, ValueError):  # not numbers of these shapes
            done = False
        if not done:
            self._check_contacts(foot_positions_I, in_contact, covariance)
        return memory.held > 0

    def _check_contacts(self, foot_positions_I, in_contact, covariance) -> None:
        """Say why an update was refused."""
        feet = len(self._model.radius)
        positions = numbers("foot_positions_I", foot_positions_I, (feet, 3))
        cov = numbers("covariance", covariance, (feet, 3, 3))
        if not all_within(positions.reshape(-1), MOST_REACH):
            raise SampleError(f"foot_positions_I: beyond {MOST_REACH:g} m")
        for k in np.flatnonzero(_flags(in_contact, (feet,))):
            spd(f"covariance of foot {k}", cov[k], 3)
        check_sound(self._memory.mean, self._memory.covariance)

    @property
    def contacts(self) -> dict[int, np.ndarray]:
        """Foot index -> estimated centre (3,) [m] in G of each standing foot."""
        standing = np.flatnonzero(self._memory.standing)
        return {int(k): self._memory.mean[EXTRA + k].copy() for k in standing}

    def legs(self, feet_I, contact, covariance, foot_rates_I=None) -> LegSamples:
        """Checked samples of the legs for `run`.

        Args:
            feet_I: foot centres (N, K, 3) [m] in I.
            contact: which feet stand (N, K).
            covariance: of the centres (N, K, 3, 3) [m^2].
            foot_rates_I: angular velocities of the feet (N, K, 3) [rad/s]; point feet need none.
        """
        feet_I = numbers("feet_I", feet_I, (-1, len(self._model.radius), 3))
        n, feet = feet_I.shape[:2]
        contact = _flags(contact, (n, feet))
        cov = numbers("cov", covariance, (n, feet, 3, 3))
        if contact.any() and np.linalg.eigvalsh(cov[contact]).min() <= 0:
            raise SurefootError("cov: is not positive definite for every standing foot")
        return LegSamples(feet_I, contact, cov, self._rates(foot_rates_I, (n,)))

    def run(
        self,
        imu: ImuSamples,
        legs: LegSamples,
        velocities: Velocities = NO_VELOCITIES,
        rows: np.ndarray | None = None,
    ) -> Trajectory:
        """Process the next rows of a log in one compiled loop.

        The result is the same as with one call per row, however a log is divided into pieces.

        Args:
            imu: the samples, from `imu_samples`.
            legs: at the same rows, from `legs`.
            velocities: additional measurements, by a radar say, from `gaussian_velocities`.
            rows: of these samples, whose estimates are returned; at 100 Hz by default.
        """
        found = empty_estimates(imu.t, rows)
        if len(legs.contact) != len(imu.t):
            raise SurefootError(f"feet_I: {len(legs.contact)} rows where t has {len(imu.t)}")
        sums, window = empty_sums(imu.t, len(self._model.radius) + 1)
        start = self._memory, self._velocity, self._model, self.t
        _run(imu, legs, velocities, *start, found, window, sums.sums)
        self.t = float(imu.t[-1])
        return trajectory(imu.t, found, innovations=sums)


@kernel
def _run(imu, legs, velocities, memory, measured, model, before, found, window, sums):
    """Run a leg filter over rows of a log.

    Args:
        imu: ImuSamples.
        legs: LegSamples.
        velocities: Velocities with covariances.
        memory: ContactMemory.
        measured: VelocityMemory.
        model: ContactModel.
        before: stamp of the row before the first [s], nan where there is none.
        found: Estimates to fill.
        window: index of each row's window in `sums` (N,).
        sums: sums to fill (W, K+1, 10).
    """
    feet = model.radius.shape[0]
    m = out = 0
    for k in range(imu.t.shape[0]):
        now = sums[window[k]]
        if not np.isnan(before):
            dt = imu.t[k] - before
            propagate_contacts(memory, model, imu.gyro[k], imu.accel[k], dt, legs.rates_I[k])
        before = imu.t[k]
        feet_I, contact, covariance = legs.feet_I[k], legs.contact[k], legs.covariance[k]
        update_contacts(memory, model.gate, feet_I, contact, covariance, now)
        if m < velocities.rows.shape[0] and velocities.rows[m] == k:
            v_I, cov = velocities.v_I[m], velocities.cov[m]
            update_velocity(memory.mean, memory.covariance, feet, v_I, cov, measured)
            add_velocity(now[feet], measured, cov)
            m += 1
        if out < found.rows.shape[0] and found.rows[out] == k:
            copy_corner(memory.mean, found.mean[out])
            copy_corner(memory.covariance, found.covariance[out])
            out += 1


def encoder_covariance(jacobian_I: np.ndarray, encoder: float, kinematics: float) -> np.ndarray:
    """Covariance (..., 3, 3) [m^2] of foot positions: J J^T encoder^2 + I kinematics^2.

    jacobian_I (..., 3, 3) [m/rad] with respect to the leg's joints; encoder [rad]: error of a joint
    angle (noise, backlash, calibration); kinematics [m]: that of links, mounts and the foot's
    shape.
    """
    J = np.asarray(jacobian_I, dtype=float)
    return J @ np.swapaxes(J, -1, -2) * encoder**2 + np.eye(3) * kinematics**2


def _flags(contact, shape) -> np.ndarray:
    contact = np.asarray(contact)
    if contact.shape != shape:
        raise SurefootError(f"contact: shape {contact.shape} where {shape} is expected")
    return np.ascontiguousarray(contact, dtype=np.bool_)
