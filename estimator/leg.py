"""The leg filter: contact-aided right-invariant EKF (Hartley 2020) with feet that roll."""

from dataclasses import dataclass, field

import numpy as np

from surefoot.estimator.core.arrays import imu_arrays, outputs, row_indices, trajectory
from surefoot.estimator.core.state import EXTRA, FilterNoise, NavState, numbers, spd, spd_3, vector
from surefoot.estimator.evaluation.trajectory import Trajectory
from surefoot.estimator.updates.contact import propagate_contacts, update_contacts
from surefoot.estimator.updates.velocity import update_velocity
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.kernels import kernel


@dataclass(frozen=True)
class LegNoise:
    """Noise of the leg filter.

    imu: the IMU's densities. contact [m/s/sqrt(Hz)]: velocity noise of a standing foot along G's
    axes, one number or three; 0.02 lets a foot creep by about 1 cm in a stance of 0.3 s (Hartley
    2020 uses 0.1 m/s a step for feet that deform). rolling [rad/s/sqrt(Hz)]: error of the angular
    velocity with which a foot rolls; it acts through the foot's radius.
    """

    imu: FilterNoise = field(default_factory=FilterNoise)
    contact: float | np.ndarray = 0.02
    rolling: float = 0.1

    def packed(self) -> tuple[np.ndarray, float]:
        """Squared densities of the contact (3,) and of the rolling."""
        contact = np.asarray(self.contact, dtype=float)
        if contact.shape not in ((), (3,)) or not np.all((contact >= 0) & (contact < np.inf)):
            raise SurefootError("noise: contact must be one or three finite numbers >= 0")
        if not 0.0 <= self.rolling < np.inf:
            raise SurefootError("noise: rolling must be a finite number >= 0")
        return np.broadcast_to(contact**2, 3).copy(), float(self.rolling) ** 2


class LegFilter:
    """Contact-aided invariant EKF: one call a sample.

    state, covariance (15, 15) as `InvariantFilter`; noise: LegNoise. foot_radius [m]: 0 for point
    feet, or one value a foot (K,); `feet` is K. slip_gate, where given, is the squared Mahalanobis
    distance (3 degrees of freedom; 16.27 is passed by chance once in 1000) of an innovation, or of
    their running mean, beyond which a foot is held to slip and left out (`leg_slip`). Raises
    SurefootError on bad input.
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
        self._imu_noise = noise.imu.packed()
        self._contact_noise, self._rolling_noise = noise.packed()
        self._radius = _radius(foot_radius, feet)
        self._gate = _gate(slip_gate)
        self._mean, self._covariance = _start(state, covariance, feet)
        self._columns, self._rotation_columns = (
            np.zeros((15 + 3 * feet, 6)),
            np.zeros((3 * feet, 3)),
        )
        self._standing = np.zeros(feet, dtype=np.bool_)
        self._drift, self._held = np.zeros((feet, 3)), np.zeros(feet, dtype=np.int64)
        self._rates: np.ndarray | None = None

    def predict(
        self, gyro: np.ndarray, accel: np.ndarray, dt: float, foot_rates_I: np.ndarray | None = None
    ) -> None:
        """IMU step over the dt > 0 [s] that ends now; gyro (3,) and accel (3,) are its means, in I.

        foot_rates_I (K, 3) [rad/s]: angular velocity of each foot relative to the body now, in I;
        over the step the mean with the last call's is taken. Feet of radius 0 need none.
        """
        gyro, accel = vector("gyro", gyro), vector("accel", accel)
        if not 0.0 < dt < np.inf:
            raise SurefootError(f"dt: {dt} where a number > 0 is expected")
        if foot_rates_I is None:
            if self._radius.any():
                raise SurefootError("foot_rates_I: needed, as foot_radius is not 0")
            foot_rates_I = np.zeros((len(self._radius), 3))
        rates = numbers("foot_rates_I", foot_rates_I, (len(self._radius), 3))
        before = rates if self._rates is None else self._rates
        propagate_contacts(
            self._mean, self._covariance, self._standing, gyro, accel, float(dt), self._imu_noise,
            self._contact_noise, self._rolling_noise, self._radius, 0.5 * (before + rates),
            self._columns, self._rotation_columns,
        )  # fmt: skip
        self._rates = rates

    def update_contacts(
        self, foot_positions_I: np.ndarray, in_contact: np.ndarray, covariance: np.ndarray
    ) -> np.ndarray:
        """Leg kinematics now: foot centres (K, 3) [m] in I, which of them stand (K,), and the
        covariances (K, 3, 3) [m^2] of the positions. Returns (K,) bool: feet held to slip.
        """
        feet = len(self._radius)
        positions = numbers("foot_positions_I", foot_positions_I, (feet, 3))
        cov = numbers("covariance", covariance, (feet, 3, 3))
        in_contact = _flags(in_contact, (feet,))
        for k in np.flatnonzero(in_contact):
            spd_3(f"covariance of foot {k}", cov[k])
        update_contacts(
            self._mean, self._covariance, self._standing, positions, in_contact, cov, self._gate,
            self._drift, self._held,
        )  # fmt: skip
        return self._held > 0

    def update_velocity(self, v_I: np.ndarray, cov: np.ndarray) -> float:
        """Gaussian update with a velocity (3,) [m/s] in I, as `InvariantFilter.update_velocity`."""
        v_I, cov = vector("v_I", v_I), spd_3("cov", cov)
        return update_velocity(self._mean, self._covariance, len(self._radius), v_I, cov)

    @property
    def state(self) -> NavState:
        """The estimate (a copy)."""
        return NavState.unpack(self._mean)

    @property
    def covariance(self) -> np.ndarray:
        """Covariance (15, 15) of the error state without the contacts (a copy)."""
        return self._covariance[:15, :15].copy()

    @property
    def contacts(self) -> dict[int, np.ndarray]:
        """Foot index -> estimated centre (3,) [m] in G of each standing foot."""
        return {int(k): self._mean[EXTRA + k].copy() for k in np.flatnonzero(self._standing)}


def run_leg(
    t, gyro, accel, feet_I, contact, cov, state, covariance, noise=None,
    foot_radius: float | np.ndarray = 0.0,
    foot_rates_I=None, slip_gate=None, stride=None, rows=None, v_I=None, v_cov=None,
) -> Trajectory:  # fmt: skip
    """The leg filter over a whole log in one compiled loop, with the numbers of `LegFilter`.

    t (N,), gyro (N, 3), accel (N, 3), stride as `run_coverage`; feet_I (N, K, 3) [m], contact
    (N, K), cov (N, K, 3, 3) [m^2] and foot_rates_I (N, K, 3) [rad/s] at t[k], every row an update.
    Velocities measured besides (a radar's, say) come as rows (M,), v_I (M, 3), v_cov (M, 3, 3).
    """
    t, gyro, accel, stride = imu_arrays(t, gyro, accel, stride)
    n = len(t)
    feet_I = numbers("feet_I", feet_I, (n, -1, 3))
    feet = feet_I.shape[1]
    contact = _flags(contact, (n, feet))
    cov = numbers("cov", cov, (n, feet, 3, 3))
    if contact.any() and np.linalg.eigvalsh(cov[contact]).min() <= 0:
        raise SurefootError("cov: is not positive definite for every standing foot")
    radius = _radius(foot_radius, feet)
    if foot_rates_I is None:
        if radius.any():
            raise SurefootError("foot_rates_I: needed, as foot_radius is not 0")
        foot_rates_I = np.zeros((n, feet, 3))
    rates = numbers("foot_rates_I", foot_rates_I, (n, feet, 3))
    v_I = numbers("v_I", np.zeros((0, 3)) if v_I is None else v_I, (-1, 3))
    v_cov = numbers("v_cov", np.zeros((0, 3, 3)) if v_cov is None else v_cov, (len(v_I), 3, 3))
    rows = row_indices(np.zeros(0, int) if rows is None else rows, len(v_I), n)
    noise = noise or LegNoise()
    contact_noise, rolling_noise = noise.packed()
    mean, P = _start(state, covariance, feet)
    out_mean, out_cov = outputs(n, stride)
    _loop(
        t, gyro, accel, feet_I, contact, cov, rates, radius, rows, v_I, v_cov, mean, P,
        noise.imu.packed(), contact_noise, rolling_noise, _gate(slip_gate), stride, out_mean,
        out_cov,
    )  # fmt: skip
    return trajectory(t[::stride], out_mean, out_cov, None)


@kernel
def _loop(
    t, gyro, accel, feet_I, contact, cov, rates, radius, rows, v_I, v_cov, mean, P,
    noise, contact_noise, rolling_noise, gate, stride, out_mean, out_cov,
):  # fmt: skip
    feet = radius.shape[0]
    standing = np.zeros(feet, dtype=np.bool_)
    drift, held = np.zeros((feet, 3)), np.zeros(feet, dtype=np.int64)
    columns, rotation_columns = np.zeros((15 + 3 * feet, 6)), np.zeros((3 * feet, 3))
    m = 0
    for k in range(t.shape[0]):
        if k > 0:
            before = rates[k - 1] if k > 1 else rates[k]
            propagate_contacts(
                mean, P, standing, gyro[k], accel[k], t[k] - t[k - 1], noise, contact_noise,
                rolling_noise, radius, 0.5 * (before + rates[k]), columns, rotation_columns,
            )  # fmt: skip
        update_contacts(mean, P, standing, feet_I[k], contact[k], cov[k], gate, drift, held)
        if m < rows.shape[0] and rows[m] == k:
            update_velocity(mean, P, feet, v_I[m], v_cov[m])
            m += 1
        if k % stride == 0:
            out_mean[k // stride] = mean[:7]
            out_cov[k // stride] = P[:15, :15]


def encoder_covariance(jacobian_I: np.ndarray, encoder: float, kinematics: float) -> np.ndarray:
    """Covariance (..., 3, 3) [m^2] of foot positions: J J^T encoder^2 + I kinematics^2.

    jacobian_I (..., 3, 3) [m/rad] by the leg's joints; encoder [rad] the error of a joint angle
    (noise, backlash, calibration); kinematics [m] that of links, mounts and the foot's shape.
    """
    J = np.asarray(jacobian_I, dtype=float)
    return J @ np.swapaxes(J, -1, -2) * encoder**2 + np.eye(3) * kinematics**2


def _start(state: NavState, covariance, feet: int) -> tuple[np.ndarray, np.ndarray]:
    P = np.zeros((15 + 3 * feet, 15 + 3 * feet))
    P[:15, :15] = spd("covariance", covariance, 15)
    return state.pack(feet), P


def _radius(radius, feet: int) -> np.ndarray:
    radius = np.asarray(radius, dtype=float)
    if radius.shape not in ((), (feet,)) or not np.all((radius >= 0) & (radius < np.inf)):
        raise SurefootError(f"foot_radius: one or {feet} finite numbers >= 0 are expected")
    return np.broadcast_to(radius, feet).copy()


def _gate(gate: float | None) -> float:
    if gate is None:
        return np.inf
    if not gate > 0:
        raise SurefootError(f"slip_gate: {gate} where a number > 0 is expected")
    return float(gate)


def _flags(contact, shape) -> np.ndarray:
    contact = np.asarray(contact)
    if contact.shape != shape:
        raise SurefootError(f"contact: shape {contact.shape} where {shape} is expected")
    return np.ascontiguousarray(contact, dtype=np.bool_)
