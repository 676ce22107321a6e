"""Effects of the joints' encoders and torque sensing.

Sizes used by others for quadrupeds: Margolis and Agrawal, "Walk These Ways", CoRL 2022 (its public
code draws joint offsets of +-0.02 rad and motor strengths of 90 to 110 %). Where a docstring gives
no source for the bounds, none was found and they were chosen wide.
"""

from dataclasses import replace
from functools import partial

import numpy as np
from scipy.ndimage import uniform_filter1d

from surefoot.sim.effects.readings import Offset, ReadingError, Scale
from surefoot.sim.effects.traced import NO_FIGURE_OF_DRIVES, Prior, Traced
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot
from surefoot.sim.sensors.streams import Streams

TORQUE_WINDOW = 0.03
"""Four times the averaging time of the torque whose sign gives a joint's position in its play [s].
"""

_reading = partial(Traced, step=1e-3, chain_rule="readings")
_POSE = ("leg_velocity", "foot_height", "base_wrench")
_TORQUE = ("joint_torque", "base_wrench", "command")


class EncoderOffset(Offset):
    """A joint's encoder has a constant offset.

    Besides "Walk These Ways": Haarnoja et al. (Science Robotics 2024) draw +-2.9 degrees, 0.05 rad.
    """

    name = "encoder_offset"
    unit = "rad"
    bounds = (-0.2, 0.2)
    readings = ("q",)
    traced = _reading(
        channels=(*_POSE, "joint_torque"),
        belongs_to="run",
        prior=Prior(0.05, "Haarnoja et al., Science Robotics 2024: 2.9 degrees"),
        motion="walk crouched and tall, and turn on the spot",
    )


class EncoderScale(Scale):
    """A joint's encoder has a scale error: it reads 1 + size times the angle and rate.

    A turn of an encoder is a turn, and gears have whole teeth: what is left is the slope of its
    non-linearity.
    """

    name = "encoder_scale"
    bounds = (-0.2, 0.2)
    readings = ("q", "dq")
    traced = _reading(
        channels=(*_POSE, "joint_torque"),
        belongs_to="sensor",
        prior=Prior(0.025, "ams AS5050 data sheet: 1.41 degrees over a turn", most=0.075),
        motion="bend the joint over its whole range: a scale's error grows with the angle",
    )


class Backlash(ReadingError):
    """Backlash of this width between the encoder, on the motor's side, and the joint.

    The motor rests against the side that it pushes on, half the width ahead of the joint, until the
    torque changes sign. It then crosses at once, so the rate is that of the joint.

    A quasi-direct drive for legs has +-0.11 degrees, 3.8 mrad in all (Perez-Diaz et al. 2024, on
    the PULSE115-60).
    """

    name = "backlash"
    unit = "rad"
    bounds = (0.0, 0.1)
    groups = True
    readings = ("q",)
    traced = _reading(
        channels=("joint_rate", *_POSE),
        step=2e-4,
        needs=("tau",),
        prior=Prior(0.035, "maxon catalogue: planetary gearheads of 0.5 to 2 degrees"),
        motion="load the joint in both directions at the same angle",
    )

    def alter_streams(self, streams: Streams, robot: Robot) -> Streams:
        side = np.sign(streams.tau)
        # Without torque, the motor stays where it was.
        rows = np.arange(len(side))[:, None]
        last = np.maximum.accumulate(np.where(side != 0.0, rows, 0), axis=0)
        play = 0.5 * self.sizes(robot)
        return replace(streams, q=streams.q + play * np.take_along_axis(side, last, axis=0))

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        columns = {}
        # Average a few rows, since noise near zero torque would make the side chatter.
        rows = max(1, round(TORQUE_WINDOW * log.rate) // 4)
        for joint in self.members(robot.limbs):
            side = np.sign(uniform_filter1d(log.columns[f"tau_{joint}"], rows))
            q = log.columns[f"q_{joint}"]
            columns[f"q_{joint}"] = q - 0.5 * self.value * side
        return log.with_columns(columns), robot


class TorqueScale(Scale):
    """A joint's torque, measured by the motor's current, has a scale error of 1 + size.

    The cause is a torque constant of the motor that differs from the nominal one. "Walk These Ways"
    draws 90 to 110 %.
    """

    name = "torque_scale"
    bounds = (-0.5, 0.5)
    groups = True
    readings = ("tau",)
    traced = _reading(
        channels=_TORQUE,
        step=1e-2,
        prior=Prior(0.1, "Margolis and Agrawal, CoRL 2022: motor strengths of 90 to 110 %"),
    )


class TorqueBias(Offset):
    """A joint's measured torque has a constant offset.

    The bounds leave room for large arms.
    """

    name = "torque_bias"
    unit = "N m"
    bounds = (-2e3, 2e3)
    readings = ("tau",)
    traced = _reading(
        channels=_TORQUE,
        step=0.1,
        belongs_to="run",
        bounds_on_legs=(-200.0, 200.0),
        prior=Prior(20.0, NO_FIGURE_OF_DRIVES),
    )
