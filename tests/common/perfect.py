"""Sensors without errors."""

from surefoot.sim.sensors.streams import Sensors

PERFECT = Sensors(
    gyro_noise=0.0, accel_noise=0.0, gyro_instability=0.0, accel_instability=0.0,
    gyro_turn_on=0.0, accel_turn_on=0.0, encoder_step=0.0,
    velocity_noise=0.0, torque_noise=0.0, force_noise=0.0,
)  # fmt: skip
"""Nothing lies between the simulation and the log but the rounding of the IMU."""
