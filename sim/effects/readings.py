"""Errors of readings: a constant offset, and a scale.

Such an effect declares which readings err and is one class without a body.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import ClassVar

import numpy as np

from surefoot.sim.effects.base import Effect
from surefoot.sim.effects.targets import AXES
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot
from surefoot.sim.sensors.streams import Streams


class ReadingError(Effect):
    """An error of the readings of some joints, or along some axes of the IMU."""

    readings: ClassVar[tuple[str, ...]]
    """The readings that err: some of gyro, accel, q, dq and tau."""
    targets = "joint"

    def sizes(self, robot: Robot) -> np.ndarray:
        """Sizes at all joints (J,) or axes (3,), zero where the effect does not act."""
        at = AXES if self.targets == AXES else robot.limbs.joints
        return self.value * np.isin(at, self.members(robot.limbs))

    def altered(self, streams: Streams, change: Callable[[np.ndarray], np.ndarray]) -> Streams:
        """The streams after a change of the readings that err."""
        return replace(streams, **{name: change(getattr(streams, name)) for name in self.readings})

    def undone(self, log: Log, robot: Robot, change: Callable[[np.ndarray], np.ndarray]) -> Log:
        """The log after a change of the columns that err, as far as it has them."""
        at = self.members(robot.limbs)
        names = [f"{kind}_{part}" for part in at for kind in self.readings]
        return log.with_columns({n: change(log.columns[n]) for n in names if n in log.columns})


class Offset(ReadingError):
    """Readings have a constant offset."""

    def alter_streams(self, streams: Streams, robot: Robot) -> Streams:
        sizes = self.sizes(robot)
        return self.altered(streams, lambda x: x + sizes)

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        return self.undone(log, robot, lambda x: x - self.value), robot


class Scale(ReadingError):
    """Readings are 1 + size times the true values."""

    unit = "ratio"

    def alter_streams(self, streams: Streams, robot: Robot) -> Streams:
        factors = 1.0 + self.sizes(robot)
        return self.altered(streams, lambda x: x * factors)

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        return self.undone(log, robot, lambda x: x / (1 + self.value)), robot
