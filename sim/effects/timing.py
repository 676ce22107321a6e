"""Effects of timing: delays, and clocks with different rates.

Tan et al., "Sim-to-Real: Learning Agile Locomotion for Quadruped Robots", RSS 2018, draw latencies
of 0 to 40 ms for their robot; Haarnoja et al., "Learning Agile Soccer Skills for a Bipedal Robot",
Science Robotics 2024, 10 to 50 ms. The bounds include these ranges.
"""

from dataclasses import replace
from functools import partial
from typing import ClassVar

import mujoco
import numpy as np

from surefoot.sim.effects.base import Effect, Prior, Traced, declared_on
from surefoot.sim.effects.resampling import (
    STREAMS,
    log_at,
    reference_at,
    reference_lag,
    reference_lag_drift,
    streams_at,
)
from surefoot.sim.log import Log
from surefoot.sim.physics.scene import TIMESTEP
from surefoot.sim.robot import Robot
from surefoot.sim.sensors.streams import Reference, Streams

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
