"""Effects of time: what arrives late, and clocks that disagree.

Tan et al., "Sim-to-Real: Learning Agile Locomotion for Quadruped Robots", RSS 2018, draw latencies
of 0 to 40 ms for their robot; Haarnoja et al., "Learning Agile Soccer Skills for a Bipedal Robot",
Science Robotics 2024, 10 to 50 ms. The bounds follow them; where a
bound is wider, it was chosen.
"""

from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, Slerp

from sim.effect import Effect, with_columns
from sim.log import Log
from sim.robot import Robot
from sim.sensors import Reference, Streams

STREAMS = {"imu": ("gyro", "accel"), "joints": ("q", "dq", "tau"), "feet": ("force",)}


class JointDelay(Effect):
    """Joint positions, velocities and torques arrive late by a constant time."""

    name = "joint_delay"
    unit = "s"
    bounds = (-0.05, 0.05)
    channels = ("leg_velocity",)
    targets = ("all",)
    step = 1e-3

    def alter_streams(self, streams: Streams, robot: Robot) -> Streams:
        return _late(streams, ("q", "dq", "tau"), self.value)

    def explain(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        t = log.t
        then = np.clip(t + self.value, t[0], t[-1])
        names = [f"{kind}_{j}" for kind in ("q", "dq", "tau") if log.has(kind) for j in log.joints]
        # A spline passes noise at every fraction of a sample; lines would smooth it at the half.
        moved = CubicSpline(t, log.frame[names].to_numpy())(then)
        return with_columns(log, {name: moved[:, i] for i, name in enumerate(names)}), robot


class ImuDelay(Effect):
    """Angular rates and specific forces arrive late by a constant time."""

    name = "imu_delay"
    unit = "s"
    bounds = (-0.05, 0.05)
    channels = ("imu_gyro", "imu_accel", "leg_velocity")
    targets = ("all",)

    def alter_streams(self, streams: Streams, robot: Robot) -> Streams:
        # Between two means over a sample lies the mean over parts of both: lines are right here.
        return _late(streams, STREAMS["imu"], self.value)


class TorqueDelay(Effect):
    """Joint torques alone arrive late by a constant time."""

    name = "torque_delay"
    unit = "s"
    bounds = (-0.05, 0.05)
    channels = ("joint_torque", "base_wrench")
    targets = ("all",)

    def alter_streams(self, streams: Streams, robot: Robot) -> Streams:
        return _late(streams, ("tau",), self.value)


class ReferenceDelay(Effect):
    """The reference arrives late by a constant time: its rows show where the robot was."""

    name = "reference_delay"
    unit = "s"
    bounds = (-0.2, 0.2)
    channels = ("imu_gyro", "imu_accel", "leg_velocity")
    targets = ("all",)

    def alter_reference(self, reference: Reference) -> Reference:
        return _reference_at(reference, reference.t - self.value)


class ClockScale(Effect):
    """One stream's clock runs slow against the others': its sample period is longer by this share.

    A row that should show the time t since the log began shows (1 + value) t. Past the end of the
    walk the last sample holds. Quartz oscillators are out by tens of parts in a million (1e-5).
    """

    name = "clock_scale"
    unit = "ratio"
    bounds = (-0.02, 0.02)
    channels = ("imu_gyro", "imu_accel", "leg_velocity")
    targets = (*STREAMS, "reference")

    def alter_streams(self, streams: Streams, robot: Robot) -> Streams:
        return _at(streams, STREAMS.get(self.target, ()), self._then(streams.t))

    def alter_reference(self, reference: Reference) -> Reference:
        if self.target != "reference":
            return reference
        return _reference_at(reference, self._then(reference.t))

    def _then(self, t: np.ndarray) -> np.ndarray:
        return t[0] + (1.0 + self.value) * (t - t[0])


def _late(streams: Streams, names: tuple[str, ...], delay: float) -> Streams:
    return _at(streams, names, streams.t - delay)


def _at(streams: Streams, names: tuple[str, ...], then: np.ndarray) -> Streams:
    """The streams with those of `names` as they were at the times `then` (N,) [s]."""
    t = streams.t
    then = np.clip(then, t[0], t[-1])
    moved = {
        name: np.column_stack([np.interp(then, t, x) for x in getattr(streams, name).T])
        for name in names
    }
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
