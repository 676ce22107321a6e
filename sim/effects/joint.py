"""Effects of the joints' encoders and torque sensing: what is read differs from what is.

Sizes that others use for quadrupeds: Margolis and Agrawal, "Walk These Ways", CoRL 2022 (its public
code draws joint offsets of +-0.02 rad and motor strengths of 90 to 110 %). Where a docstring gives
no source for the bounds, none was found and they were chosen wide.
"""

from dataclasses import replace

import numpy as np
from scipy.ndimage import uniform_filter1d

from surefoot.sim.effects.base import Effect, with_columns
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot
from surefoot.sim.robot.legs import JOINTS
from surefoot.sim.sensors.streams import Streams

TORQUE_WINDOW = 0.03
"""s, over which a measured torque is averaged or differentiated before it says where a joint is."""


class EncoderOffset(Effect):
    """A joint's encoder reads its angle plus a constant.

    Beside "Walk These Ways": Haarnoja et al. (Science Robotics 2024) draw +-2.9 degrees, 0.05 rad.
    """

    name = "encoder_offset"
    unit = "rad"
    bounds = (-0.2, 0.2)
    channels = ("leg_velocity", "foot_height", "base_wrench", "joint_torque")
    targets = JOINTS
    step = 1e-3
    chain_rule = "readings"

    def alter_streams(self, streams: Streams, robot: Robot) -> Streams:
        q = streams.q.copy()
        q[:, JOINTS.index(self.target)] += self.value
        return replace(streams, q=q)

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        column = f"q_{self.target}"
        return with_columns(log, {column: log.frame[column].to_numpy() - self.value}), robot


class EncoderScale(Effect):
    """A joint's encoder reads its angle, and its rate, times one plus a constant."""

    name = "encoder_scale"
    unit = "ratio"
    bounds = (-0.2, 0.2)
    channels = ("leg_velocity", "foot_height", "base_wrench", "joint_torque")
    targets = JOINTS
    step = 1e-3
    chain_rule = "readings"

    def alter_streams(self, streams: Streams, robot: Robot) -> Streams:
        factor = 1.0 + self.value * _only(self.target)
        return replace(streams, q=streams.q * factor, dq=streams.dq * factor)

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        names = [n for n in (f"q_{self.target}", f"dq_{self.target}") if n in log.frame]
        scaled = {name: log.frame[name].to_numpy() / (1 + self.value) for name in names}
        return with_columns(log, scaled), robot


class JointCompliance(Effect):
    """A spring between the encoder, on the motor's side, and the joint: q reads q + tau / k.

    The size is 1 / k. The motor's own inertia is left out, so that its angle follows the torque at
    once; the rate that is read is the derivative of the angle that is read.
    """

    name = "joint_compliance"
    unit = "rad/(N m)"
    bounds = (0.0, 0.02)
    channels = ("leg_velocity", "foot_height", "base_wrench", "joint_torque")
    targets = JOINTS
    needs = ("tau",)
    step = 2e-5
    chain_rule = "readings"

    def alter_streams(self, streams: Streams, robot: Robot) -> Streams:
        wound = streams.tau * (self.value * _only(self.target))
        rate = np.gradient(wound, streams.t, axis=0)
        return replace(streams, q=streams.q + wound, dq=streams.dq + rate)

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        torque = log.frame[f"tau_{self.target}"].to_numpy()
        wound = {f"q_{self.target}": self.value * torque}
        if f"dq_{self.target}" in log.frame:
            # The torque's noise, differenced row by row, would drown the rate that is read.
            slope = np.gradient(uniform_filter1d(torque, _window(log)), log.t)
            wound[f"dq_{self.target}"] = self.value * slope
        columns = {name: log.frame[name].to_numpy() - wound[name] for name in wound}
        return with_columns(log, columns), robot


class Backlash(Effect):
    """Play of this width between the encoder, on the motor's side, and the joint.

    The motor lies against the side that it pushes on, half the play ahead of the joint, and stays
    there until the torque changes its sign. It crosses at once: the rate that is read is the
    joint's.

    A quasi-direct drive for legs has +-0.11 degrees, 3.8 mrad in all (Perez-Diaz et al. 2024, on
    the PULSE115-60).
    """

    name = "backlash"
    unit = "rad"
    bounds = (0.0, 0.1)
    channels = ("joint_rate", "leg_velocity", "foot_height", "base_wrench")
    targets = JOINTS
    needs = ("tau",)
    step = 2e-4
    chain_rule = "readings"

    def alter_streams(self, streams: Streams, robot: Robot) -> Streams:
        j = JOINTS.index(self.target)
        side = np.sign(streams.tau[:, j])
        # Without a torque nothing moves it from the side where it lay.
        last = np.maximum.accumulate(np.where(side != 0.0, np.arange(len(side)), 0))
        q = streams.q.copy()
        q[:, j] += 0.5 * self.value * side[last]
        return replace(streams, q=q)

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        torque = log.frame[f"tau_{self.target}"].to_numpy()
        # A noisy torque near zero would jump from side to side: a mean over some rows does less.
        side = np.sign(uniform_filter1d(torque, max(1, _window(log) // 4)))
        q = log.frame[f"q_{self.target}"].to_numpy() - 0.5 * self.value * side
        return with_columns(log, {f"q_{self.target}": q}), robot


class TorqueScale(Effect):
    """A joint's torque, taken from the motor's current, reads one plus a constant times too much.

    So it does where the motor's torque constant is not the nominal one.

    "Walk These Ways" draws 90 to 110 %.
    """

    name = "torque_scale"
    unit = "ratio"
    bounds = (-0.5, 0.5)
    channels = ("joint_torque", "base_wrench")
    targets = JOINTS
    step = 1e-2
    chain_rule = "readings"

    def alter_streams(self, streams: Streams, robot: Robot) -> Streams:
        return replace(streams, tau=streams.tau * (1.0 + self.value * _only(self.target)))

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        column = f"tau_{self.target}"
        return with_columns(log, {column: log.frame[column].to_numpy() / (1 + self.value)}), robot


class TorqueBias(Effect):
    """A joint's torque reads its value plus a constant."""

    name = "torque_bias"
    unit = "N m"
    bounds = (-20.0, 20.0)
    channels = ("joint_torque", "base_wrench")
    targets = JOINTS
    step = 0.1
    chain_rule = "readings"

    def alter_streams(self, streams: Streams, robot: Robot) -> Streams:
        return replace(streams, tau=streams.tau + self.value * _only(self.target))

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        column = f"tau_{self.target}"
        return with_columns(log, {column: log.frame[column].to_numpy() - self.value}), robot


def _window(log: Log) -> int:
    """Rows within TORQUE_WINDOW."""
    return max(1, round(TORQUE_WINDOW * log.rate))


def _only(joint: str) -> np.ndarray:
    """(12,): one for this joint, zero for the others."""
    return np.eye(12)[JOINTS.index(joint)]
