"""Errors of readings, a constant offset and a scale; and those of the joints' encoders and torques.

Such an effect declares which readings err and is one class without a body. Sizes used by others for
quadrupeds: Margolis and Agrawal, "Walk These Ways", CoRL 2022 (its public code draws joint offsets
of +-0.02 rad and motor strengths of 90 to 110 %). Where a docstring gives no source for the bounds,
none was found and they were chosen wide.
"""

from dataclasses import replace
from functools import partial
from typing import ClassVar

import numpy as np

from surefoot.sim.effects.base import AXES, NO_FIGURE_OF_DRIVES, Effect, Prior, Traced
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot
from surefoot.sim.sensors.streams import Streams


class ReadingError(Effect):
    """An error of the readings of some joints, or along some axes of the IMU."""

    readings: ClassVar[tuple[str, ...]]
    """The readings that err: some of gyro, accel, q, dq and tau."""
    targets = "joint"

    def reading(self, true: np.ndarray, size: float | np.ndarray) -> np.ndarray:
        """What the sensor reads of true values (N,) or (N, K), for a size, or one a column."""
        raise NotImplementedError

    def true(self, reading: np.ndarray, size: float) -> np.ndarray:
        """The true values (N,) of which the sensor reads these."""
        raise NotImplementedError

    def alter_streams(self, streams: Streams, robot: Robot) -> Streams:
        at = AXES if self.targets == AXES else robot.limbs.joints
        sizes = self.value * np.isin(at, self.members(robot.limbs))
        altered = {name: self.reading(getattr(streams, name), sizes) for name in self.readings}
        return replace(streams, **altered)

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        at = self.members(robot.limbs)
        names = [f"{kind}_{part}" for part in at for kind in self.readings]
        there = [name for name in names if name in log.columns]
        undone = {name: self.true(log.columns[name], self.value) for name in there}
        return log.with_columns(undone), robot


class Offset(ReadingError):
    """Readings have a constant offset."""

    def reading(self, true: np.ndarray, size: float | np.ndarray) -> np.ndarray:
        return true + size

    def true(self, reading: np.ndarray, size: float) -> np.ndarray:
        return reading - size


class Scale(ReadingError):
    """Readings are 1 + size times the true values."""

    unit = "ratio"

    def reading(self, true: np.ndarray, size: float | np.ndarray) -> np.ndarray:
        return true * (1.0 + size)

    def true(self, reading: np.ndarray, size: float) -> np.ndarray:
        return reading / (1.0 + size)


_reading = partial(Traced, step=1e-3, chain_rule="readings")


_POSE = ("leg_velocity", "foot_height", "base_wrench")


_TORQUE = ("joint_torque", "base_wrench", "command")


class EncoderOffset(Offset):
    """A joint's encoder has a constant offset.

    Besides "Walk These Ways": Haarnoja et al. (Science Robotics 2024) draw +-2.9 degrees, 0.05 rad.
    """

    unit = "rad"
    bounds = (-0.2, 0.2)
    readings = ("q",)
    traced = _reading(
        channels=(*_POSE, "joint_torque"),
        belongs_to="run",
        prior=Prior(0.05, "Haarnoja et al., Science Robotics 2024: 2.9 degrees"),
        motion="read the joint at a known angle, or walk crouched and tall and turn on the spot",
    )


class EncoderScale(Scale):
    """A joint's encoder has a scale error: it reads 1 + size times the angle and rate.

    A turn of an encoder is a turn, and gears have whole teeth: what is left is the slope of its
    non-linearity.
    """

    bounds = (-0.2, 0.2)
    readings = ("q", "dq")
    traced = _reading(
        channels=(*_POSE, "joint_torque"),
        belongs_to="sensor",
        prior=Prior(0.025, "ams AS5050 data sheet: 1.41 degrees over a turn", most=0.075),
        motion="bend the joint over its whole range: a scale's error grows with the angle",
    )


class TorqueScale(Scale):
    """A joint's torque, measured by the motor's current, has a scale error of 1 + size.

    The cause is a torque constant of the motor that differs from the nominal one. "Walk These Ways"
    draws 90 to 110 %.
    """

    bounds = (-0.5, 0.5)
    groups = True
    readings = ("tau",)
    by_torque = True
    traced = _reading(
        channels=_TORQUE,
        step=1e-2,
        prior=Prior(0.1, "Margolis and Agrawal, CoRL 2022: motor strengths of 90 to 110 %"),
    )


class TorqueBias(Offset):
    """A joint's measured torque has a constant offset.

    The bounds leave room for large arms.
    """

    unit = "N m"
    bounds = (-2e3, 2e3)
    readings = ("tau",)
    by_torque = True
    traced = _reading(
        channels=_TORQUE,
        step=0.1,
        belongs_to="run",
        bounds_on_legs=(-200.0, 200.0),
        prior=Prior(20.0, NO_FIGURE_OF_DRIVES),
    )
