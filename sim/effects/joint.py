"""Effects of the joints' encoders and torque sensing: what is read differs from what is.

Sizes that others use for quadrupeds: Margolis and Agrawal, "Walk These Ways", CoRL 2022 (its public
code draws joint offsets of +-0.02 rad and motor strengths of 90 to 110 %). Where a docstring gives
no source for the bounds, none was found and they were chosen wide.
"""

from dataclasses import replace

import numpy as np
from scipy.ndimage import uniform_filter1d

from surefoot.sim.effects.base import Effect, joint_sizes, with_columns
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot
from surefoot.sim.sensors.streams import Streams

TORQUE_WINDOW = 0.03
"""s, over which a measured torque is averaged before it says where a joint is."""


class EncoderOffset(Effect):
    """A joint's encoder reads its angle plus a constant.

    Beside "Walk These Ways": Haarnoja et al. (Science Robotics 2024) draw +-2.9 degrees, 0.05 rad.
    """

    name = "encoder_offset"
    unit = "rad"
    bounds = (-0.2, 0.2)
    channels = ("leg_velocity", "foot_height", "base_wrench", "joint_torque")
    targets = "joint"
    step = 1e-3
    chain_rule = "readings"

    def alter_streams(self, streams: Streams, robot: Robot) -> Streams:
        return replace(streams, q=streams.q + joint_sizes(self, robot.limbs))

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        names = [f"q_{joint}" for joint in self.members(robot.limbs)]
        return with_columns(log, {n: log.columns[n] - self.value for n in names}), robot


class EncoderScale(Effect):
    """A joint's encoder reads its angle, and its rate, times one plus a constant."""

    name = "encoder_scale"
    unit = "ratio"
    bounds = (-0.2, 0.2)
    channels = ("leg_velocity", "foot_height", "base_wrench", "joint_torque")
    targets = "joint"
    step = 1e-3
    chain_rule = "readings"

    def alter_streams(self, streams: Streams, robot: Robot) -> Streams:
        factor = 1.0 + joint_sizes(self, robot.limbs)
        return replace(streams, q=streams.q * factor, dq=streams.dq * factor)

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        both = [f"{kind}_{joint}" for joint in self.members(robot.limbs) for kind in ("q", "dq")]
        names = [name for name in both if name in log.frame]
        scaled = {name: log.columns[name] / (1 + self.value) for name in names}
        return with_columns(log, scaled), robot


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
    targets = "joint"
    groups = True
    needs = ("tau",)
    step = 2e-4
    chain_rule = "readings"

    def alter_streams(self, streams: Streams, robot: Robot) -> Streams:
        side = np.sign(streams.tau)
        # Without a torque nothing moves it from the side where it lay.
        rows = np.arange(len(side))[:, None]
        last = np.maximum.accumulate(np.where(side != 0.0, rows, 0), axis=0)
        play = 0.5 * joint_sizes(self, robot.limbs)
        return replace(streams, q=streams.q + play * np.take_along_axis(side, last, axis=0))

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        columns = {}
        for joint in self.members(robot.limbs):
            torque = log.columns[f"tau_{joint}"]
            # A noisy torque near zero would jump from side to side: a mean of some rows does less.
            side = np.sign(uniform_filter1d(torque, max(1, _window(log) // 4)))
            q = log.columns[f"q_{joint}"]
            columns[f"q_{joint}"] = q - 0.5 * self.value * side
        return with_columns(log, columns), robot


class TorqueScale(Effect):
    """A joint's torque, taken from the motor's current, reads one plus a constant times too much.

    So it does where the motor's torque constant is not the nominal one.

    "Walk These Ways" draws 90 to 110 %.
    """

    name = "torque_scale"
    unit = "ratio"
    bounds = (-0.5, 0.5)
    channels = ("joint_torque", "base_wrench", "command")
    targets = "joint"
    groups = True
    step = 1e-2
    chain_rule = "readings"

    def alter_streams(self, streams: Streams, robot: Robot) -> Streams:
        return replace(streams, tau=streams.tau * (1.0 + joint_sizes(self, robot.limbs)))

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        names = [f"tau_{joint}" for joint in self.members(robot.limbs)]
        scaled = {n: log.columns[n] / (1 + self.value) for n in names}
        return with_columns(log, scaled), robot


class TorqueBias(Effect):
    """A joint's torque reads its value plus a constant."""

    name = "torque_bias"
    unit = "N m"
    bounds = (-20.0, 20.0)
    channels = ("joint_torque", "base_wrench", "command")
    targets = "joint"
    step = 0.1
    chain_rule = "readings"

    def alter_streams(self, streams: Streams, robot: Robot) -> Streams:
        return replace(streams, tau=streams.tau + joint_sizes(self, robot.limbs))

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        names = [f"tau_{joint}" for joint in self.members(robot.limbs)]
        return with_columns(log, {n: log.columns[n] - self.value for n in names}), robot


def _window(log: Log) -> int:
    """Rows within TORQUE_WINDOW."""
    return max(1, round(TORQUE_WINDOW * log.rate))
