"""An effect of a user's own that is not in the catalogue."""

from dataclasses import replace

import numpy as np

from surefoot.extend import AXES, Effect, Traced, with_columns


class GyroWarming(Effect):
    """A gyro's bias grows to this size while it warms up, with a time constant of 16 s."""

    name = "gyro_warming"
    unit = "rad/s"
    bounds = (-0.5, 0.5)
    targets = AXES
    traced = Traced(channels=("imu_gyro", "leg_velocity"), step=1e-3, needs=("imu",))

    def alter_streams(self, streams, robot):
        gyro = streams.gyro.copy()
        gyro[:, AXES.index(self.target)] += self.value * settled(streams.t)
        return replace(streams, gyro=gyro)

    def compensate(self, log, robot):
        column = f"gyro_{self.target}"
        reading = log.frame[column].to_numpy() - self.value * settled(log.t)
        return with_columns(log, {column: reading}), robot


def settled(t):
    """Share of its size that the bias has at times t (N,) [s]."""
    return 1.0 - np.exp(-(t - t[0]) / 16.0)
