"""Effects of timing: delays, and clocks with different rates.

Tan et al., "Sim-to-Real: Learning Agile Locomotion for Quadruped Robots", RSS 2018, draw latencies
of 0 to 40 ms for their robot; Haarnoja et al., "Learning Agile Soccer Skills for a Bipedal Robot",
Science Robotics 2024, 10 to 50 ms. The bounds include these ranges.
"""

import operator
from dataclasses import replace
from itertools import pairwise
from typing import ClassVar, NamedTuple

import mujoco
import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, Slerp

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.gravity import GRAVITY
from surefoot.sim.common.quaternion import slerp
from surefoot.sim.common.series import convolve
from surefoot.sim.effects.base import Effect, declared_on
from surefoot.sim.log import Log
from surefoot.sim.physics.scene import TIMESTEP
from surefoot.sim.robot import Robot
from surefoot.sim.robot.limbs import Limbs
from surefoot.sim.sensors.pad import begin_early, late_contacts
from surefoot.sim.sensors.stances import swings
from surefoot.sim.sensors.streams import Reference, Streams

NONLINEAR = 0.008
"""Delay up to which the residual is about linear [s]: a walk shakes the body at 10 Hz and more, and
a sine is linear over an eighth of its period.
"""
LAG_PIECE = 4.0
"""Length of the pieces of a log over which the lag of a stream is taken to be constant [s]: a few
strides.
"""
FEWEST_LAGS = 6
"""Least number of lags for a drift: three meaningless lags look like a drift in a third of all
draws, six in 2 %.
"""
_TURNING = ("gyro_x", "gyro_y", "gyro_z", "ref_q_w", "ref_q_x", "ref_q_y", "ref_q_z")
STREAMS = {"imu": ("gyro", "accel"), "joints": ("q", "dq", "tau"), "feet": ("force",)}
STREAM_COLUMNS = {
    **STREAMS,
    "joints": (*STREAMS["joints"], "foot"),
    "feet": ("force", "contact"),
    "reference": ("ref",),
}
"""A log's columns of each stream; positions of the feet belong to the joints, and contacts to the
feet's forces, from which they are derived.
"""


class _Delay(Effect):
    """Some streams of the sensors arrive late by a constant time."""

    delayed: ClassVar[tuple[str, ...]]
    """The streams that are late."""
    unit = "s"
    bounds = (-0.05, 0.05)
    targets = ("all",)
    lossy = True

    def alter_streams(self, streams: Streams, robot: Robot) -> Streams:
        return _at(streams, self.delayed, streams.t - self.value)

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        return _moved(log, self.delayed, log.t + self.value), robot


class JointDelay(_Delay):
    """Joint positions, rates and torques arrive late by a constant time, and so do positions of the
    feet that were computed from them.
    """

    name = "joint_delay"
    delayed = STREAMS["joints"]
    channels = ("leg_velocity", "foot_height", "base_wrench", "joint_torque")
    needs = ("reference",)
    on_given_feet = True
    # Longer than a row, so that noise is not differentiated as the slope of torques and rates.
    # Delays of 1 and 6 ms are found to 0.01 ms with any step from 0.5 to 4 ms; started from zero,
    # the longest step comes closest.
    step = 4e-3
    # Nothing but the residual tells a lag beyond the linear range.
    starts = (4e-3, 0.03, -0.03)

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        return _moved(log, STREAM_COLUMNS["joints"], log.t + self.value), robot


class ImuDelay(_Delay):
    """Angular rates and specific forces arrive late by a constant time."""

    name = "imu_delay"
    delayed = STREAMS["imu"]
    channels = ("imu_gyro", "imu_accel", "leg_velocity")
    needs = ("imu",)
    on_given_feet = True
    step = 1e-3
    chain_rule = "readings"

    @classmethod
    def starts_on(cls, target: str, log: Log) -> tuple[float, ...]:
        return _starts(cls, log, -1.0)


class TorqueDelay(_Delay):
    """Joint torques alone arrive late by a constant time."""

    name = "torque_delay"
    delayed = ("tau",)
    channels = ("joint_torque", "base_wrench", "command")
    step = 1e-3
    chain_rule = "readings"


class RateDelay(_Delay):
    """Joint rates arrive late relative to the angles by a constant time.

    Drives that differentiate and filter the angles cause this.
    """

    name = "rate_delay"
    delayed = ("dq",)
    channels = ("joint_rate", "leg_velocity", "joint_torque", "base_wrench")
    needs = ("dq",)
    # Longer than a row, so that noise is not differentiated as the slope of rates.
    step = 4e-3


class CommandDelay(Effect):
    """Motors deliver the commanded torques late by a constant time.

    MuJoCo can delay a motor by whole time steps only. A shorter delay is modelled by a first-order
    low-pass with that mean lag: a share of each command comes a time step late.
    """

    name = "command_delay"
    unit = "s"
    bounds = (0.0, 0.05)
    channels = ("command",)
    targets = ("all",)
    needs = ("tau",)
    # The smallest delay that is fitted. Commands are linear within a row, so any step gives their
    # slope; at 0.1 N m of noise per row, a minute of torques resolves a few microseconds.
    step = 1e-6
    chain_rule = "mass"

    def edit_spec(self, spec: mujoco.MjSpec, robot: Robot) -> None:
        for motor in spec.actuators:
            late = self.value + motor.delay + _lag(motor)
            motor.set_to_motor()
            motor.delay = late if late >= TIMESTEP else 0.0
            if motor.delay:
                # Interpolate linearly between the stored samples.
                motor.nsample, motor.interp = int(np.ceil(motor.delay / TIMESTEP)) + 2, 1
            elif late:
                motor.dyntype, motor.actearly = mujoco.mjtDyn.mjDYN_FILTEREXACT, True
                motor.dynprm[0] = TIMESTEP / np.log1p(TIMESTEP / late)

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        return log, declared_on(robot, command_late=self.value)


def _lag(motor: mujoco.MjsActuator) -> float:
    """Mean lag [s] of a motor's discrete low-pass; 0 if it has none."""
    if motor.dyntype != mujoco.mjtDyn.mjDYN_FILTEREXACT:
        return 0.0
    return TIMESTEP / float(np.expm1(TIMESTEP / motor.dynprm[0]))


class ContactDelay(Effect):
    """The feet's contacts begin or end late by this mean time; a negative size means that they
    begin early.

    Caused by a foot's pad and switch (`sim.sensors.pad`), whose delay depends on the load at each
    step; the mean over all steps is the size. A long, soft pad touches before the foot stands. A
    contact that ends early is harmless, since an unloaded foot stands still for a while.
    """

    name = "contact_delay"
    unit = "s"
    bounds = (-0.05, 0.15)
    channels = ("contact_timing",)
    targets = ("touchdown", "liftoff")
    needs = ("contact", "reference")
    on_given_feet = True
    # Less than a row: with every row, some bouncing contacts appear and some vanish.
    step = 1e-3

    def __post_init__(self):
        super().__post_init__()
        if self.target == "liftoff" and self.value < 0.0:
            raise SurefootError(
                f"effect {self.name}: a liftoff is not early, is {self.value:g} {self.unit}"
            )

    def alter_streams(self, streams: Streams, robot: Robot) -> Streams:
        threshold = streams.contact_threshold * robot.mass * GRAVITY
        loads = streams.t, streams.force, threshold
        if self.value < 0.0:
            return replace(streams, force=begin_early(*loads, -self.value))
        late = late_contacts(*loads, self.value, begins=self.target == "touchdown")
        return replace(streams, force=late)

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        undone = self.value
        if self.target == "touchdown":
            # Debouncing has already removed a part of an early beginning. A late beginning is not
            # undone: a foot that stood before it was sensed does no harm, but each step has a delay
            # of its own, and stances extended by the mean would begin in the air.
            undone = min(undone + log.meta.model.get("contact_debounce", 0.0), 0.0)
        rows, contact = int(undone * log.rate), log.contact.copy()
        for leg in range(contact.shape[1] if rows else 0):
            lifts, lands = swings(log.t, log.contact[:, leg])
            for edge in lands if self.target == "touchdown" else lifts:
                contact[max(edge - max(rows, 0), 0) : edge + max(-rows, 0), leg] = False
        columns = {f"contact_{leg}": contact[:, i].astype(float) for i, leg in enumerate(log.legs)}
        # The part that is not undone in the log is declared in the model.
        known = declared_on(robot, **{f"{self.target}_late": self.value - rows / log.rate})
        return log.with_columns(columns), known

    @classmethod
    def is_lossy(cls, target: str) -> bool:
        # The part of each stance before a late touchdown is lost.
        return target == "touchdown"

    @classmethod
    def is_always_present(cls, target: str, robot: Robot) -> bool:
        # A pad takes some time to spring back and cross a threshold.
        return target == "liftoff" and not robot.extras.liftoff_late

    @classmethod
    def interior_bounds(cls, target: str, limbs: Limbs | None = None) -> tuple[float, float]:
        low, high = super().interior_bounds(target, limbs)
        return (low if target == "touchdown" else 1.1 * cls.step), high


class ReferenceDelay(Effect):
    """The reference arrives late by a constant time: its rows show where the robot was."""

    name = "reference_delay"
    unit = "s"
    bounds = (-0.2, 0.2)
    channels = ("imu_gyro", "imu_accel", "leg_velocity", "foot_height")
    targets = ("all",)
    needs = ("reference",)
    on_given_feet = True
    lossy = True
    step = 1e-3

    def alter_reference(self, reference: Reference) -> Reference:
        return _reference_at(reference, reference.t - self.value)

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        return _moved(log, ("ref",), log.t + self.value), robot

    @classmethod
    def starts_on(cls, target: str, log: Log) -> tuple[float, ...]:
        return _starts(cls, log, 1.0)


def _starts(kind: type[Effect], log: Log, sign: float) -> tuple[float, ...]:
    """Initial sizes for a delay: a small one, and `sign` times the reference's lag if that is
    beyond the linear range.
    """
    known = log.has("imu") and log.has("reference")
    late = sign * reference_lag(log, kind.bounds[1]) if known else 0.0
    return (kind.step, late) if abs(late) > NONLINEAR else (kind.step,)


def reference_lag(log: Log, most: float) -> float:
    """Delay [s] of the reference's rotation relative to the gyro, up to +-`most`.

    Where their correlation is largest, to the row.
    """
    return log.once(
        f"reference lag within {most}", _TURNING, lambda: _turning_lag(_turning(log), most)
    )


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
    def made() -> _Turning:
        turning, steps = Rotation.from_quat(log.ref_q, scalar_first=True), np.diff(log.t)
        turned = (turning[:-1].inv() * turning[1:]).as_rotvec() / steps[:, None]
        return _Turning(steps, turned, 0.5 * (log.gyro[1:] + log.gyro[:-1]))

    return log.once("turning by reference and gyro", _TURNING, made)


def _turning_lag(turning: _Turning, most: float) -> float:
    row, turned, gyro = float(np.mean(turning.duration)), turning.reference, turning.gyro
    both = [x - x.mean(axis=0) for x in (turned, gyro)]
    shared = np.sum(
        [convolve(a, b[::-1]) for a, b in zip(*(x.T for x in both), strict=True)], axis=0
    )
    lags = np.arange(1 - len(gyro), len(turned)) * row
    near = np.abs(lags) <= most
    return float(lags[near][np.argmax(shared[near])])


def reference_lag_drift(log: Log, most: float) -> float:
    """Drift [s/s] of the reference's delay relative to the gyro, up to +-`most`.

    Median slope of the lags of pieces of the log (Theil-Sen). 0 if its 95 % interval contains 0, as
    it does if the pieces rotate too little to show a lag.
    """
    return log.once(f"reference drift within {most}", _TURNING, lambda: _lag_drift(log, most))


def _lag_drift(log: Log, most: float) -> float:
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


class ClockScale(Effect):
    """One stream's clock runs slow against the others: its sample period is longer by this share.

    A row at the time t since the log began shows (1 + value) t. Past the end of the walk the last
    sample is held. Quartz oscillators are off by tens of parts per million (1e-5).
    """

    name = "clock_scale"
    unit = "ratio"
    bounds = (-0.02, 0.02)
    channels = ("imu_gyro", "imu_accel", "leg_velocity", "contact_timing")
    targets = (*STREAMS, "reference")
    needs = ("reference",)
    on_given_feet = True
    lossy = True
    step = 1e-4

    def alter_streams(self, streams: Streams, robot: Robot) -> Streams:
        return _at(streams, STREAMS.get(self.target, ()), self._then(streams.t))

    def alter_reference(self, reference: Reference) -> Reference:
        if self.target != "reference":
            return reference
        return _reference_at(reference, self._then(reference.t))

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        t = log.t
        return _moved(
            log, STREAM_COLUMNS[self.target], t[0] + (t - t[0]) / (1.0 + self.value)
        ), robot

    @classmethod
    def channels_of(cls, target: str) -> tuple[str, ...]:
        # Other channels would contain samples of a foot in the air, far outside the linear range.
        return ("contact_timing",) if target == "feet" else cls.channels

    @classmethod
    def step_of(cls, target: str) -> float:
        # Contacts move by whole rows, so a small step would not change them.
        return 10 * cls.step if target == "feet" else cls.step

    @classmethod
    def starts_on(cls, target: str, log: Log) -> tuple[float, ...]:
        step = cls.step_of(target)
        if target not in ("imu", "reference") or not (log.has("imu") and log.has("reference")):
            return (step,)
        drift = reference_lag_drift(log, cls.bounds[1])
        drift = drift if target == "imu" else -drift
        far = abs(drift) * (log.t[-1] - log.t[0]) > NONLINEAR
        return (step, float(np.clip(drift, *cls.bounds))) if far else (step,)

    def _then(self, t: np.ndarray) -> np.ndarray:
        return t[0] + (1.0 + self.value) * (t - t[0])


def _at(streams: Streams, names: tuple[str, ...], then: np.ndarray) -> Streams:
    """The streams with those of `names` as they were at the times `then` (N,) [s].

    Linear interpolation would low-pass an IMU, unlike a delay, and would begin each contact early.
    """
    t = streams.t
    then = np.clip(then, t[0], t[-1])
    moved = {}
    for name in names:
        x = getattr(streams, name)
        if name in STREAMS["imu"]:
            moved[name] = CubicSpline(t, x)(then)
        elif name in STREAMS["feet"]:
            moved[name] = x[_nearest(t, then)]
        else:
            moved[name] = np.column_stack([np.interp(then, t, column) for column in x.T])
    return replace(streams, **moved)


def _reference_at(reference: Reference, then: np.ndarray) -> Reference:
    t = reference.t
    then = np.clip(then, t[0], t[-1])
    turned = Slerp(t, Rotation.from_matrix(reference.R_GI))(then)
    p_GI, v_GI = (
        np.column_stack([np.interp(then, t, x) for x in part.T])
        for part in (reference.p_GI, reference.v_GI)
    )
    return Reference(t, turned.as_matrix(), p_GI, v_GI)


def _moved(log: Log, kinds: tuple[str, ...], then: np.ndarray) -> Log:
    """The log with the columns of these kinds resampled at the times `then` (N,) [s].

    A spline keeps the noise at any fraction of a sample, while linear interpolation would smooth it
    halfway between two. Flags and attitudes are not interpolated by splines.
    """
    t = log.t
    then = np.clip(then, t[0], t[-1])
    names = [n for n in log.columns if n.split("_")[0] in kinds and not _commanded(n)]
    flags = [n for n in names if n.startswith(("contact_", "ref_ok"))]
    turns = [n for n in names if n.startswith("ref_q_")]
    smooth = [n for n in names if n not in flags and n not in turns]
    columns = {}
    for kind in dict.fromkeys(name.split("_")[0] for name in smooth):
        own = [n for n in smooth if n.split("_")[0] == kind]
        values = _spline(t, kind, [log.columns[name] for name in own])(then)
        columns |= {name: values[:, i] for i, name in enumerate(own)}
    columns |= {name: log.columns[name][_nearest(t, then)] for name in flags}
    if turns:
        values = slerp(t, log.ref_q, then)
        columns |= {f"ref_q_{axis}": values[:, i] for i, axis in enumerate("wxyz")}
    return log.with_columns(columns)


KEPT_ROWS = 100_000
"""Rows up to which splines are kept: those of twelve joints then take a tenth of a GB."""
_splines: dict[str, tuple[list[np.ndarray], CubicSpline]] = {}
"""Kind of columns -> those of the last log, time first, and their spline: the delays and the clock
of a stream are tried one after the other.
"""


def _spline(t: np.ndarray, kind: str, columns: list[np.ndarray]) -> CubicSpline:
    """Spline through columns (N,) of one kind at times t (N,) [s]."""
    known = [t, *columns]
    last = _splines.get(kind)
    if last and len(last[0]) == len(known) and all(map(operator.is_, last[0], known)):
        return last[1]
    spline = CubicSpline(t, np.column_stack(columns))
    if len(t) <= KEPT_ROWS:
        _splines[kind] = known, spline
    return spline


def _nearest(t: np.ndarray, then: np.ndarray) -> np.ndarray:
    """Index of the row nearest to each time in `then` (N,) [s]."""
    return np.searchsorted(0.5 * (t[1:] + t[:-1]), then)


def _commanded(name: str) -> bool:
    return name.startswith(("q_des_", "dq_des_", "tau_ff_"))
