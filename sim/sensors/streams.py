"""Sensor readings of a simulated motion."""

from dataclasses import dataclass, fields, replace
from typing import NamedTuple

import numpy as np
import pandas as pd

from surefoot.sim.common.errors import check_within
from surefoot.sim.common.gravity import GRAVITY_G
from surefoot.sim.common.kernels import kernel
from surefoot.sim.common.quaternion import continuous
from surefoot.sim.common.series import (
    SHORTEST_TIME,
    GaussMarkov,
    deferred_normals,
    interpolate_rows,
    low_pass_from,
)
from surefoot.sim.robot import Robot

SLOWEST = 20.0
"""Rate below which a log does not resolve a stride [Hz]."""
FASTEST_LOG = 1e4
"""Rate beyond that of any robot's sensor [Hz]."""
LARGEST_ERROR = 1e6
"""Largest size of any sensor error, in SI units: far beyond any sensor."""
RANGES = {
    **dict.fromkeys(("force_noise", "contact_missed", "contact_false"), (0.0, 1.0)),
    "instability_time": (SHORTEST_TIME, LARGEST_ERROR),
}
"""Ranges of errors; others only have their usual limit."""


@dataclass(frozen=True)
class Sensors:
    """Sensor errors, in SI units.

    IMU: VectorNav VN-100, product brief and https://www.vectornav.com/products/detail/vn-100
    (accelerometer 0.14 mg/rtHz, < 0.04 mg in-run bias, +-15 g; gyro 0.0035 deg/s/rtHz, 5 deg/h
    in-run bias, +-2000 deg/s; 16 bits). It states no turn-on bias: Xsens states +-0.5 deg/s for its
    gyros between turn-ons within a year (https://base.xsens.com/hc/en-us/articles/203307252); a
    sixth of that, and 3 mg, were chosen for the rest after a robot has stood still. It states no
    correlation time of the in-run bias either: 300 s was chosen.
    Encoders: ams AS5047P data sheet, 14 bits; integral nonlinearity is assumed to be calibrated.
    Joint velocity: such an encoder on the motor's side of a gear of 8, differenced over 2 ms, has
    an error of sqrt(1/6) 3.83e-4 rad / 8 / 2 ms = 0.01 rad/s.
    Torque and foot force: no published figure was found; chosen as some 0.2 % of the largest torque
    of a robot of 40 kg, and 0.5 % of the weight. The threshold of contact was chosen, too.
    An IMU without a bandwidth averages over each row (VN-100 manual: coning and sculling
    integrals); with one it is filtered and then sampled, with aliasing from above half the rate
    (VN-100: 256 Hz gyro, 260 Hz accelerometer).
    """

    gyro_noise: float = 6.1e-5  # rad/s/rtHz
    accel_noise: float = 1.37e-3  # m/s^2/rtHz
    gyro_instability: float = 2.4e-5  # rad/s
    accel_instability: float = 3.9e-4  # m/s^2
    instability_time: float = 300.0  # s, correlation time of the in-run bias
    gyro_turn_on: float = 1.5e-3  # rad/s, standard deviation
    accel_turn_on: float = 0.03  # m/s^2, standard deviation
    gyro_range: float = 34.9  # rad/s
    accel_range: float = 147.0  # m/s^2
    encoder_step: float = 3.83e-4  # rad
    velocity_noise: float = 0.01  # rad/s
    torque_noise: float = 0.1  # N m
    force_noise: float = 0.005  # of the robot's weight
    contact_threshold: float = 0.08  # of the robot's weight, on one foot
    imu_bandwidth: float = 0.0  # Hz, of the IMU's first-order low-pass; 0: it averages a sample
    rate: float = 0.0  # Hz, rows a second of the log; 0: a row a timestep
    encoder_noise: float = 0.0  # rad, standard deviation in each row, beyond the rounding to steps
    encoder_offset: float = 0.0  # rad, standard deviation, drawn once a joint
    contact_delay: float = 0.0  # s, until a change of contact is reported
    contact_missed: float = 0.0  # share of samples of a foot in contact that report none
    contact_false: float = 0.0  # share of samples of a lifted foot that report contact

    def __post_init__(self):
        rate = {"rate": (SLOWEST, FASTEST_LOG)} if self.rate else {}
        check_within(vars(self), RANGES | rate, LARGEST_ERROR)


class SpringDeflection(NamedTuple):
    """Deflection of springs: of the joints relative to their motors, and of the feet in the frames
    of the legs' last links.
    """

    q: np.ndarray  # (N, J) rad
    dq: np.ndarray  # (N, J) rad/s
    foot: np.ndarray  # (N, L, 3) m
    foot_rate: np.ndarray  # (N, L, 3) m/s


@dataclass(frozen=True)
class Motion:
    """A recorded motion: N + 1 states one time step apart, and the torques and forces between them.

    Joint angles are those of the motors; `give` has the deflection of springs.
    """

    t: np.ndarray  # (N + 1,) s
    p_GB: np.ndarray  # (N + 1, 3) m
    R_GB: np.ndarray  # (N + 1, 3, 3)
    v_GB: np.ndarray  # (N + 1, 3) m/s
    w_B: np.ndarray  # (N + 1, 3) rad/s
    q: np.ndarray  # (N + 1, 12) rad
    dq: np.ndarray  # (N + 1, 12) rad/s
    tau: np.ndarray  # (N, 12) N m, over each step
    command: np.ndarray  # (N, 12) N m, that the motors were asked for
    force: np.ndarray  # (N, 4) N, normal foot force over each step
    give: SpringDeflection | None = None  # of a robot with springs

    def after(self, time: float) -> "Motion":
        """The motion from `time` [s] on, with that as time zero."""
        first = int(np.searchsorted(self.t, time))
        names = [f.name for f in fields(self) if f.name != "give"]
        parts = {name: getattr(self, name)[first:] for name in names}
        give = self.give and SpringDeflection(*(part[first:] for part in self.give))
        return Motion(**parts | {"t": self.t[first:] - self.t[first]}, give=give)


@dataclass(frozen=True)
class Streams:
    """Readings of perfect sensors. Row k of the IMU covers (t[k-1], t[k]]; the others are at
    t[k].
    """

    t: np.ndarray  # (N,) s
    gyro: np.ndarray  # (N, 3) rad/s
    accel: np.ndarray  # (N, 3) m/s^2
    q: np.ndarray  # (N, 12) rad
    dq: np.ndarray  # (N, 12) rad/s
    tau: np.ndarray  # (N, 12) N m
    tau_ff: np.ndarray  # (N, 12) N m, commanded
    force: np.ndarray  # (N, 4) N
    contact_threshold: float = Sensors.contact_threshold  # of the robot's weight, on one foot

    @property
    def rate(self) -> float:
        """Sampling rate [Hz]."""
        return float(1.0 / np.median(np.diff(self.t)))


@dataclass(frozen=True)
class Reference:
    """Measured motion of the nominal IMU frame, at the rows of the streams."""

    t: np.ndarray  # (N,) s
    R_GI: np.ndarray  # (N, 3, 3)
    p_GI: np.ndarray  # (N, 3) m
    v_GI: np.ndarray  # (N, 3) m/s


def reference_of(motion: Motion, robot: Robot) -> Reference:
    """The true motion as a reference without errors."""
    R_GI, p_GI, v_GI = imu_motion(motion, robot)
    return Reference(motion.t[1:], R_GI[1:], p_GI[1:], v_GI[1:])


def imu_motion(motion: Motion, robot: Robot) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """R_GI (N, 3, 3), p_GI (N, 3) [m], v_GI (N, 3) [m/s] of the nominal IMU mounting."""
    R_GI = motion.R_GB @ robot.R_BI
    p_GI = motion.p_GB + motion.R_GB @ robot.p_BI
    v_GI = motion.v_GB + np.einsum("nij,nj->ni", motion.R_GB, np.cross(motion.w_B, robot.p_BI))
    return R_GI, p_GI, v_GI


def ideal_streams(motion: Motion, robot: Robot) -> Streams:
    """Readings of perfect sensors, one row per step.

    An IMU integrates between its samples, so its rows are the constant rate and specific force that
    take the attitude and velocity of one state exactly to those of the next.
    """
    R_GI, _, v_GI = imu_motion(motion, robot)
    gyro, accel = imu_between_states(motion.t, R_GI, v_GI)
    return Streams(
        t=motion.t[1:],
        gyro=gyro,
        accel=accel,
        q=motion.q[1:],
        dq=motion.dq[1:],
        tau=motion.tau,
        tau_ff=motion.command,
        force=motion.force,
    )


def imu_between_states(
    t: np.ndarray, R_GI: np.ndarray, v_GI: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Angular rates [rad/s] and specific forces [m/s^2] (N, 3) in I, constant between states, that
    lead exactly through attitudes R_GI (N + 1, 3, 3) and velocities v_GI (N + 1, 3) [m/s] at the
    times t (N + 1,) [s]. The rotation between two states is less than pi.
    """
    dt = np.diff(t)[:, None]
    turn = _rotation_steps(R_GI)
    felt = np.einsum("nji,nj->ni", R_GI[:-1], np.diff(v_GI, axis=0) / dt - GRAVITY_G)
    return turn / dt, _before_turning(turn, felt)


class SensorErrors:
    """Errors of all sensors over a walk, contacts included, whose readings may come in pieces; the
    numbers do not depend on the pieces.

    A sensed contact is the measured force compared with a threshold, delayed, and wrong in samples
    drawn at random.
    """

    def __init__(
        self,
        sensors: Sensors,
        rng: np.random.Generator,
        shape: tuple[int, int, int],
        rate: float,
        weight: float,
    ):
        """Draw what is of the whole walk.

        Args:
            sensors: sizes of the errors; noise is a density, per rtHz.
            rng: random generator, drawn from as pieces are read, too.
            shape: numbers of rows, joints and legs.
            rate: sampling rate [Hz].
            weight: of the robot [N].
        """
        s, (n, joints, legs) = sensors, shape
        self._gyro, self._accel = (_ImuErrors(s, name, rng, n, rate) for name in ("gyro", "accel"))
        force_noise = s.force_noise * weight
        noises = (joints, s.velocity_noise), (joints, s.torque_noise), (legs, force_noise)
        self._dq, self._tau, self._force = (
            (deferred_normals(rng, n * columns), size) for columns, size in noises
        )
        self._offset, self._step = rng.normal(0.0, s.encoder_offset, joints), s.encoder_step
        drawn = n * joints if s.encoder_noise else 0
        self._q = deferred_normals(rng, drawn), s.encoder_noise
        self._sensors, self._rng, self._weight = sensors, rng, weight
        self._late = round(s.contact_delay * rate)
        self._before: np.ndarray | None = None  # the last contacts of the piece before

    def apply(self, streams: Streams) -> tuple[Streams, np.ndarray]:
        """The next piece of perfect readings with errors, and the sensed contacts (N, L)."""

        def noisy(reading: np.ndarray, of: tuple[np.random.Generator, float]) -> np.ndarray:
            return reading + of[0].normal(0.0, of[1], reading.shape)

        q = streams.q + self._offset
        if self._q[1]:
            q = noisy(q, self._q)
        if self._step:
            q = np.round(q / self._step) * self._step
        read = replace(
            streams,
            gyro=self._gyro.apply(streams.gyro),
            accel=self._accel.apply(streams.accel),
            q=q,
            dq=noisy(streams.dq, self._dq),
            tau=noisy(streams.tau, self._tau),
            force=np.maximum(noisy(streams.force, self._force), 0.0),
        )
        return read, self._contact(read.force)

    def _contact(self, force: np.ndarray) -> np.ndarray:
        stands = force > self._sensors.contact_threshold * self._weight
        if self._before is None:
            self._before = np.repeat(stands[:1], self._late, axis=0)
        known = np.concatenate([self._before, stands])
        stands, self._before = known[: len(stands)], known[len(stands) :]
        wrong = np.where(stands, self._sensors.contact_missed, self._sensors.contact_false)
        return stands ^ (self._rng.random(stands.shape) < wrong)


class _ImuErrors:
    """Bias, noise, bandwidth and resolution of three axes."""

    def __init__(self, sensors: Sensors, name: str, rng: np.random.Generator, n: int, rate: float):
        """Advances `rng` past all draws of these axes.

        Args:
            sensors: sizes of the errors; the range has 16 bits.
            name: gyro or accel.
            rng: random generator.
            n: number of rows.
            rate: sampling rate [Hz].
        """
        density, turn_on, instability, self._range = (
            getattr(sensors, f"{name}_{size}")
            for size in ("noise", "turn_on", "instability", "range")
        )
        self._turn_on = rng.normal(0.0, turn_on, 3)
        self._bias = GaussMarkov(rng, n, instability, sensors.instability_time, rate)
        self._noise, self._sigma = deferred_normals(rng, 3 * n), density * np.sqrt(rate)
        self._rate, self._bandwidth = rate, sensors.imu_bandwidth
        self._filtered: np.ndarray | None = None

    def apply(self, reading: np.ndarray) -> np.ndarray:
        """Add the errors to the next true values in I (N, 3)."""
        bias = self._turn_on + self._bias.next(len(reading))
        noisy = reading + bias + self._noise.normal(0.0, self._sigma, reading.shape)
        if self._bandwidth:
            time = 1.0 / (2.0 * np.pi * self._bandwidth)
            noisy, self._filtered = low_pass_from(self._filtered, noisy, time, self._rate)
        step = self._range / 2**15
        return np.clip(np.round(noisy / step) * step, -self._range, self._range)


@kernel(nogil=True)
def _rotation_steps(R):
    """Rotation vectors (N, 3) [rad] between successive attitudes (N + 1, 3, 3), below pi."""
    turn = np.empty((len(R) - 1, 3))
    for k in range(len(turn)):
        A, B = R[k], R[k + 1]
        trace = 0.0
        turn[k] = 0.0
        for i in range(3):
            for c in range(3):
                trace += A[i, c] * B[i, c]
                # Half the antisymmetric part of A^T B, as a vector: axis times sine.
                a, b = (c + 1) % 3, (c + 2) % 3
                turn[k, c] += 0.5 * (A[i, b] * B[i, a] - A[i, a] * B[i, b])
        sine = np.sqrt(turn[k, 0] ** 2 + turn[k, 1] ** 2 + turn[k, 2] ** 2)
        if sine > 0.0:
            longer = np.arctan2(sine, 0.5 * (trace - 1.0)) / sine
            for c in range(3):
                turn[k, c] *= longer
    return turn


@kernel(nogil=True)
def _before_turning(turn, felt):
    """The constant force (N, 3) whose mean is `felt` in a frame that rotates by `turn` (N, 3)
    [rad].

    Solves Gamma_1(turn) x = felt, where Gamma_1 is the mean of exp(s turn) over s in (0, 1)
    (Hartley et al. 2020). The inverse is 1 - W / 2 + c W W.
    """
    x = np.empty_like(felt)
    for k in range(len(turn)):
        a, b = turn[k], felt[k]
        square = a[0] * a[0] + a[1] * a[1] + a[2] * a[2]
        # By its series where the closed form would cancel.
        if square < 0.01:
            c = 1 / 12 + square * (1 / 720 + square * (1 / 30240 + square * (1 / 1209600)))
        else:
            half = 0.5 * np.sqrt(square)
            c = (1.0 - half / np.tan(half)) / square
        along = c * (a[0] * b[0] + a[1] * b[1] + a[2] * b[2])
        keep = 1.0 - c * square
        x[k, 0] = keep * b[0] - 0.5 * (a[1] * b[2] - a[2] * b[1]) + along * a[0]
        x[k, 1] = keep * b[1] - 0.5 * (a[2] * b[0] - a[0] * b[2]) + along * a[1]
        x[k, 2] = keep * b[2] - 0.5 * (a[0] * b[1] - a[1] * b[0]) + along * a[2]
    return x


def sampled(frame: pd.DataFrame, rate: float, averages: bool) -> pd.DataFrame:
    """The columns of a simulated log at `rate` [Hz], which is below the simulated one.

    Angles, forces and reference are interpolated to the new times, contacts keep their last value.
    If `averages`, the IMU gives means over the new samples, which avoids aliasing and keeps
    integrals; else its filtered reading at that time.
    """
    t = frame["t"].to_numpy()
    before = 2.0 * t[0] - t[1]
    then = before + np.arange(1, int(np.floor((t[-1] - before) * rate + 1e-6)) + 1) / rate
    held = np.searchsorted(t, then + 1e-9, side="right") - 1
    edges, first = np.append(before, then), np.append(before, t)
    columns: dict[str, np.ndarray] = {"t": then}
    for name in map(str, frame.columns[1:]):
        x = frame[name].to_numpy()
        if name.startswith("contact_"):
            columns[name] = x[held]
        elif averages and name.startswith(("gyro_", "accel_")):
            # A row is the mean since the one before it, so the integral is exact at the rows.
            integral = np.append(0.0, np.cumsum(x * np.diff(first)))
            columns[name] = np.diff(np.interp(edges, first, integral)) * rate
        else:
            columns[name] = np.interp(then, t, x)
    found = pd.DataFrame(columns)
    q = [f"ref_q_{axis}" for axis in "wxyz"]
    # A quaternion's sign may change from row to row: the row before decides.
    turned = interpolate_rows(then, t, continuous(frame[q].to_numpy()))
    found[q] = turned / np.linalg.norm(turned, axis=1, keepdims=True)
    return found
