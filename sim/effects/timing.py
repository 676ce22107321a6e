"""Effects of timing: delays, and clocks with different rates; streams, references and logs as they
were at other times.

Tan et al., "Sim-to-Real: Learning Agile Locomotion for Quadruped Robots", RSS 2018, draw latencies
of 0 to 40 ms for their robot; Haarnoja et al., "Learning Agile Soccer Skills for a Bipedal Robot",
Science Robotics 2024, 10 to 50 ms. The bounds include these ranges.
"""

from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import ClassVar, NamedTuple

import mujoco
import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, Slerp

from surefoot.sim.common.quaternion import continuous
from surefoot.sim.common.series import interpolate_rows
from surefoot.sim.effects.base import Effect, Prior, Traced, declared_on
from surefoot.sim.log import Log
from surefoot.sim.log.schema import named_columns
from surefoot.sim.physics.scene import TIMESTEP
from surefoot.sim.robot import Robot
from surefoot.sim.sensors.streams import Reference, Streams

STREAMS = {
    "imu": ("gyro", "accel"),
    "joints": ("q", "dq", "tau", "foot"),
    "feet": ("force", "contact"),
    "reference": ("ref",),
}
"""Readings of each stream, by the first word of a log's columns; positions of the feet belong to
the joints, and contacts to the feet's forces, from which they are derived.
"""


def streams_at(streams: Streams, names: tuple[str, ...], then: np.ndarray) -> Streams:
    """The streams with the readings `names`, as far as they have them, as they were at the times
    `then` (N,) [s].

    Linear interpolation would low-pass an IMU, unlike a delay, and would begin each contact early.
    """
    t = streams.t
    then = np.clip(then, t[0], t[-1])
    moved = {}
    for name in [name for name in names if hasattr(streams, name)]:
        x = getattr(streams, name)
        if name in STREAMS["imu"]:
            moved[name] = CubicSpline(t, x)(then)
        elif name in STREAMS["feet"]:
            moved[name] = x[_nearest(t, then)]
        else:
            moved[name] = interpolate_rows(then, t, x)
    return replace(streams, **moved)


def reference_at(reference: Reference, names: tuple[str, ...], then: np.ndarray) -> Reference:
    """The reference as it was at the times `then` (N,) [s], if `names` of readings have it."""
    if "ref" not in names:
        return reference
    t = reference.t
    then = np.clip(then, t[0], t[-1])
    turned = Slerp(t, Rotation.from_matrix(reference.R_GI))(then)
    p_GI, v_GI = (interpolate_rows(then, t, x) for x in (reference.p_GI, reference.v_GI))
    return Reference(t, turned.as_matrix(), p_GI, v_GI)


def log_at(log: Log, kinds: tuple[str, ...], then: np.ndarray) -> Log:
    """The log with the columns of these kinds resampled at the times `then` (N,) [s].

    A spline keeps the noise at any fraction of a sample, while linear interpolation would smooth it
    halfway between two. Flags are those of the nearest row.
    """
    t = log.t
    then = np.clip(then, t[0], t[-1])
    commands = "q_des_", "dq_des_", "tau_ff_"
    names = [n for n in log.columns if n.split("_")[0] in kinds and not n.startswith(commands)]
    flags = [n for n in names if n.startswith(("contact_", "ref_ok"))]
    turns = [n for n in names if n.startswith("ref_q_")]
    smooth = [n for n in names if n not in flags and n not in turns]
    columns = {}
    for kind in dict.fromkeys(name.split("_")[0] for name in smooth):
        of_kind = [n for n in smooth if n.split("_")[0] == kind]
        values = _spline(log, kind, of_kind)(then)
        columns |= dict(zip(of_kind, values.T, strict=True))
    columns |= {name: log.columns[name][_nearest(t, then)] for name in flags}
    if turns:
        values = CubicSpline(t, continuous(log.ref_q))(then)
        values /= np.linalg.norm(values, axis=1, keepdims=True)
        columns |= named_columns("ref_q", values, "wxyz")
    return log.with_columns(columns)


KEPT_ROWS = 100_000
"""Rows up to which a log keeps its splines: those of twelve joints then take a tenth of a GB."""


def _spline(log: Log, kind: str, names: list[str]) -> CubicSpline:
    """Spline through the columns of one kind: the delays and the clock of a stream are tried one
    after the other.
    """

    def made() -> CubicSpline:
        return CubicSpline(log.t, np.column_stack([log.columns[name] for name in names]))

    return log.once(f"spline of {kind}", names, made) if len(log.t) <= KEPT_ROWS else made()


def _nearest(t: np.ndarray, then: np.ndarray) -> np.ndarray:
    """Index of the row nearest to each time in `then` (N,) [s]."""
    return np.searchsorted(0.5 * (t[1:] + t[:-1]), then)


LAG_PIECE = 4.0
"""Length of the pieces of a log over which the lag of a stream is taken to be constant [s]: a few
strides.
"""


FEWEST_LAGS = 6
"""Least number of lags for a drift: three meaningless lags look like a drift in a third of all
draws, six in 2 %.
"""


def reference_lag(log: Log, most: float) -> float:
    """Delay [s] of the reference's rotation relative to the gyro, up to +-`most`.

    Where their correlation is largest, to the row.
    """
    return _turning_lag(_turning(log), most)


class _Turning(NamedTuple):
    """Rotation of a body by its reference and by its gyro, in the K steps between rows.

    Attributes:
        duration: of each step (K,) [s].
        reference: angular rate by the reference (K, 3) [rad/s].
        gyro: angular rate by the gyro (K, 3) [rad/s].
    """

    duration: np.ndarray
    reference: np.ndarray
    gyro: np.ndarray

    def steps(self, which: slice) -> "_Turning":
        return _Turning(*(x[which] for x in self))


def _turning(log: Log) -> _Turning:
    turning, steps = Rotation.from_quat(log.ref_q, scalar_first=True), np.diff(log.t)
    turned = (turning[:-1].inv() * turning[1:]).as_rotvec() / steps[:, None]
    return _Turning(steps, turned, 0.5 * (log.gyro[1:] + log.gyro[:-1]))


def _turning_lag(turning: _Turning, most: float) -> float:
    from scipy.signal import fftconvolve  # which takes half a second to import

    turned, gyro = (x - x.mean(axis=0) for x in (turning.reference, turning.gyro))
    shared = fftconvolve(turned, gyro[::-1], axes=0).sum(axis=1)
    lags = np.arange(1 - len(gyro), len(turned)) * float(np.mean(turning.duration))
    near = np.abs(lags) <= most
    return float(lags[near][np.argmax(shared[near])])


def reference_lag_drift(log: Log, most: float) -> float:
    """Drift [s/s] of the reference's delay relative to the gyro, up to +-`most`.

    Median slope of the lags of pieces of the log (Theil-Sen). 0 if its 95 % interval contains 0, as
    it does if the pieces rotate too little to show a lag.
    """
    from scipy.stats import theilslopes  # which takes half a second to import

    duration = log.t[-1] - log.t[0]
    pieces = max(FEWEST_LAGS, round(duration / LAG_PIECE))
    ends = np.linspace(0, len(log.t), pieces + 1).round().astype(int)
    parts = [(i, j) for i, j in pairwise(ends) if j - i > 2]
    if len(parts) < FEWEST_LAGS:
        return 0.0
    turning = _turning(log)
    lags = [_turning_lag(turning.steps(slice(i, j - 1)), most * duration) for i, j in parts]
    line = theilslopes(lags, [log.t[i:j].mean() for i, j in parts])
    return float(line.slope) if line.low_slope * line.high_slope > 0.0 else 0.0


NONLINEAR = 0.008
"""Delay up to which the residual is about linear [s]: a walk shakes the body at 10 Hz and more, and
a sine is linear over an eighth of its period.
"""


_lagging = partial(Traced, step=1e-3, belongs_to="sensor", lossy=True)


class Delay(Effect):
    """Some readings arrive late by a constant time."""

    delayed: ClassVar[tuple[str, ...]]
    """The readings that are late: some of gyro, accel, q, dq, tau, foot (positions of the feet that
    were computed from the joints), force and contact, or ref, the reference.
    """
    unit = "s"
    bounds = (-0.05, 0.05)
    targets = ("all",)
    traced = _lagging()

    def alter_streams(self, streams: Streams, robot: Robot) -> Streams:
        return streams_at(streams, self.delayed, streams.t - self.value)

    def alter_reference(self, reference: Reference) -> Reference:
        return reference_at(reference, self.delayed, reference.t - self.value)

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        return log_at(log, self.delayed, log.t + self.value), robot

    @classmethod
    def shift_in(cls, span: float) -> float:
        return 1.0

    @classmethod
    def starts_on(cls, target: str, log: Log) -> tuple[float, ...]:
        # The rotations of gyro and reference tell a lag between these beyond the linear range.
        sign = ("ref" in cls.delayed) - ("gyro" in cls.delayed)
        if cls.traced.starts or not (sign and log.has("imu") and log.has("reference")):
            return super().starts_on(target, log)
        lag = sign * reference_lag(log, cls.bounds[1])
        return (cls.traced.step, lag) if abs(lag) > NONLINEAR else (cls.traced.step,)

    @classmethod
    def is_within_rows(cls) -> bool:
        """Whether some of the readings of one sensor are late relative to its others."""
        return any(set(cls.delayed) < set(stream) for stream in STREAMS.values())


LATENCY = Prior(0.04, "Tan et al., RSS 2018: latencies of 0 to 40 ms")


class JointDelay(Delay):
    """Joint positions, rates and torques arrive late by a constant time, and so do positions of the
    feet that were computed from them.
    """

    delayed = STREAMS["joints"]
    traced = _lagging(
        channels=("leg_velocity", "foot_height", "base_wrench", "joint_torque"),
        needs=("reference",),
        on_given_feet=True,
        # Longer than a row, so that noise is not differentiated as the slope of torques and rates.
        # Delays of 1 and 6 ms are found to 0.01 ms with any step from 0.5 to 4 ms; started from
        # zero, the longest step comes closest.
        step=4e-3,
        # Nothing but the residual tells a lag beyond the linear range.
        starts=(4e-3, 0.03, -0.03),
        prior=LATENCY,
        motion="swing the joints fast and slowly: a delay's error grows with their rate",
    )


class ImuDelay(Delay):
    """Angular rates and specific forces arrive late by a constant time."""

    delayed = STREAMS["imu"]
    traced = _lagging(
        channels=("imu_gyro", "imu_accel", "leg_velocity"),
        needs=("imu",),
        on_given_feet=True,
        chain_rule="readings",
        prior=LATENCY,
        motion="shake the body at several frequencies: a delay's error grows with them",
    )


class TorqueDelay(Delay):
    """Joint torques alone arrive late by a constant time."""

    delayed = ("tau",)
    traced = _lagging(
        channels=("joint_torque", "base_wrench", "command"),
        chain_rule="readings",
        prior=LATENCY,
    )


class RateDelay(Delay):
    """Joint rates arrive late relative to the angles by a constant time.

    Drives that differentiate and filter the angles cause this.
    """

    delayed = ("dq",)
    traced = _lagging(
        channels=("joint_rate", "leg_velocity", "joint_torque", "base_wrench"),
        needs=("dq",),
        # Longer than a row, so that noise is not differentiated as the slope of rates.
        step=4e-3,
        prior=LATENCY,
        motion="swing the joints faster: a delay's error grows with the acceleration",
    )


class ReferenceDelay(Delay):
    """The reference arrives late by a constant time: its rows show where the robot was."""

    bounds = (-0.2, 0.2)
    delayed = STREAMS["reference"]
    traced = _lagging(
        channels=("imu_gyro", "imu_accel", "leg_velocity", "foot_height"),
        belongs_to="run",
        needs=("reference",),
        on_given_feet=True,
        prior=Prior(0.05, "no figure found: motion capture, a few frames at 100 Hz late"),
        motion="change speed often: a delay's error grows with the acceleration",
    )


class CommandDelay(Effect):
    """Motors deliver the commanded torques late by a constant time.

    MuJoCo can delay a motor by whole time steps only. A shorter delay is modelled by a first-order
    low-pass with that mean lag: a share of each command comes a time step late.
    """

    unit = "s"
    bounds = (0.0, 0.05)
    targets = ("all",)
    traced = Traced(
        channels=("command",),
        # The smallest delay that is fitted. Commands are linear within a row, so any step gives
        # their slope; at 0.1 N m of noise per row, a minute of torques resolves a few microseconds.
        step=1e-6,
        chain_rule="mass",
        needs=("tau",),
        prior=Prior(0.05, "Haarnoja et al., Science Robotics 2024: 10 to 50 ms"),
        motion="change the commanded torques fast",
    )

    def edit_spec(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        for motor in spec.actuators:
            lag = self.value + motor.delay + _lag(motor)
            motor.set_to_motor()
            motor.delay = lag if lag >= TIMESTEP else 0.0
            if motor.delay:
                # Interpolate linearly between the stored samples.
                motor.nsample, motor.interp = int(np.ceil(motor.delay / TIMESTEP)) + 2, 1
            elif lag:
                motor.dyntype, motor.actearly = mujoco.mjtDyn.mjDYN_FILTEREXACT, True
                motor.dynprm[0] = TIMESTEP / np.log1p(TIMESTEP / lag)

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        return log, declared_on(robot, command_late=self.value)


def _lag(motor: mujoco.MjsActuator) -> float:
    """Mean lag [s] of a motor's discrete low-pass; 0 if it has none."""
    if motor.dyntype != mujoco.mjtDyn.mjDYN_FILTEREXACT:
        return 0.0
    return TIMESTEP / float(np.expm1(TIMESTEP / motor.dynprm[0]))


_OF_JOINTS = {f"contact from {one}" for one in ("torque", "kinematics", "gait")}
"""Contacts that are computed from the joints, and so have their clock."""


class ClockScale(Effect):
    """One stream's clock runs slow against the others: its sample period is longer by this share.

    A row at the time t since the log began shows (1 + value) t. Past the end of the walk the last
    sample is held. Quartz oscillators are off by tens of parts per million (1e-5).
    """

    unit = "ratio"
    bounds = (-0.02, 0.02)
    targets = tuple(STREAMS)
    traced = Traced(
        channels=("imu_gyro", "imu_accel", "leg_velocity", "contact_timing"),
        step=1e-4,
        belongs_to="run",
        needs=("reference",),
        on_given_feet=True,
        lossy=True,
        prior=Prior(0.005, "no figure found: oscillators without quartz, some per mille"),
        motion="record a longer log: the difference of the clocks keeps growing",
    )

    def alter_streams(self, streams: Streams, robot: Robot) -> Streams:
        return streams_at(streams, STREAMS[self.target], self._then(streams.t))

    def alter_reference(self, reference: Reference) -> Reference:
        return reference_at(reference, STREAMS[self.target], self._then(reference.t))

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        t = log.t
        then = t[0] + (t - t[0]) / (1.0 + self.value)
        return log_at(log, STREAMS[self.target], then), robot

    @classmethod
    def traced_at(cls, target: str) -> Traced:
        if target != "feet":
            return cls.traced
        # Other channels would contain samples of a foot in the air, far outside the linear range;
        # contacts move by whole rows, so a small step would not change them.
        return replace(cls.traced, channels=("contact_timing",), step=10 * cls.traced.step)

    @classmethod
    def is_compensated_on(cls, log: Log, target: str) -> bool:
        there = super().is_compensated_on(log, target)
        return there and (target != "feet" or _OF_JOINTS.isdisjoint(log.meta.derived))

    @classmethod
    def shift_in(cls, span: float) -> float:
        return 0.25 * span

    @classmethod
    def starts_on(cls, target: str, log: Log) -> tuple[float, ...]:
        step = cls.traced_at(target).step
        if target not in ("imu", "reference") or not (log.has("imu") and log.has("reference")):
            return (step,)
        drift = reference_lag_drift(log, cls.bounds[1])
        drift = drift if target == "imu" else -drift
        far = abs(drift) * (log.t[-1] - log.t[0]) > NONLINEAR
        return (step, float(np.clip(drift, *cls.bounds))) if far else (step,)

    def _then(self, t: np.ndarray) -> np.ndarray:
        return t[0] + (1.0 + self.value) * (t - t[0])
