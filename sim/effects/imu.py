"""Effects of the IMU: bias, scale, mounting and filter.

The bounds are wider than the figures given, to cover sensors that were never calibrated.
"""

from dataclasses import replace
from functools import partial

import numpy as np

from surefoot.sim.common.series import low_pass
from surefoot.sim.effects.base import AXES, Effect, Prior, Traced, along, declared_on, turn_about
from surefoot.sim.effects.readings import Offset, Scale
from surefoot.sim.log import Log
from surefoot.sim.log.schema import named_columns
from surefoot.sim.robot import Robot
from surefoot.sim.sensors.streams import Reference, Streams

_imu = partial(Traced, step=1e-3, needs=("imu",), belongs_to="sensor", on_given_feet=True)
_readings = partial(_imu, chain_rule="readings")
_gyro = partial(_readings, channels=("imu_gyro", "leg_velocity"))
_accel = partial(_readings, channels=("imu_accel",))
_SPECIFICATION = "MPU-6050 Product Specification"


class ImuRotation(Effect):
    """The IMU is mounted with a rotation about one of its nominal axes; the reference is not.

    Haarnoja et al. (Science Robotics 2024) draw up to 2 degrees for their robot.
    """

    unit = "rad"
    bounds = (-0.5, 0.5)
    targets = AXES
    traced = _readings(
        channels=("imu_gyro", "imu_accel", "leg_velocity"),
        prior=Prior(0.035, "Haarnoja et al., Science Robotics 2024: 2 degrees"),
        motion="tilt the body in stance about each axis in turn",
    )

    def alter_streams(self, streams: Streams, robot: Robot) -> Streams:
        turn = turn_about(self.target, self.value)
        # Row vectors: x @ R is R^T x, the reading in the rotated sensor's axes.
        return replace(streams, gyro=streams.gyro @ turn, accel=streams.accel @ turn)

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        back = turn_about(self.target, self.value).T
        columns = named_columns("gyro", log.gyro @ back) | named_columns("accel", log.accel @ back)
        return log.with_columns(columns), robot


class GyroScale(Scale):
    """One axis of the gyro has a scale error: it reads 1 + size times the rate.

    The MPU-6050's product specification allows 3 % before calibration.
    """

    bounds = (-0.3, 0.3)
    targets = AXES
    readings = ("gyro",)
    traced = _gyro(
        prior=Prior(0.03, f"{_SPECIFICATION}: 3 %", most=0.09),
        motion="turn the body about that axis, both ways and at several rates",
    )


class AccelScale(Scale):
    """One axis of the accelerometer has a scale error: it reads 1 + size times the specific force.

    The MPU-6050's product specification allows 3 % before calibration.
    """

    bounds = (-0.3, 0.3)
    targets = AXES
    readings = ("accel",)
    traced = _accel(
        prior=Prior(0.03, f"{_SPECIFICATION}: 3 %", most=0.09),
        motion="tilt the body and hold it, best upside down: gravity along the axis changes",
    )


class GyroBias(Offset):
    """One axis of the gyro has a constant bias, in addition to the turn-on bias.

    The MPU-6050's product specification allows 20 deg/s (0.35 rad/s) before calibration.
    """

    unit = "rad/s"
    bounds = (-0.5, 0.5)
    targets = AXES
    readings = ("gyro",)
    traced = _gyro(
        belongs_to="run",
        prior=Prior(0.35, f"{_SPECIFICATION}: 20 deg/s"),
        motion="tilt the body and hold it: a bias stays, an effect of gravity changes",
    )


class AccelBias(Offset):
    """One axis of the accelerometer has a constant bias.

    The MPU-6050's product specification allows 50 mg (0.5 m/s^2) along x and y, 80 mg along z.
    """

    unit = "m/s^2"
    bounds = (-2.0, 2.0)
    targets = AXES
    readings = ("accel",)
    traced = _accel(
        belongs_to="run",
        step=1e-2,
        prior=Prior(0.8, f"{_SPECIFICATION}: 50 mg along x and y, 80 mg along z"),
        motion="tilt the body and hold it: a bias stays, gravity along the axis changes",
    )


class GyroGSensitivity(Effect):
    """One axis of the gyro is sensitive to the specific force along it.

    The MPU-6050's product specification gives 0.1 deg/s per g, 1.8e-4 in this unit.
    """

    unit = "rad/s per m/s^2"
    bounds = (-0.02, 0.02)
    targets = AXES
    traced = _gyro(
        step=1e-4,
        prior=Prior(0.001, f"{_SPECIFICATION}: 1.8e-4 is typical, no maximum given"),
        motion="tilt the body and hold it: gravity along the axis then changes",
    )

    def alter_streams(self, streams: Streams, robot: Robot) -> Streams:
        felt = streams.accel * along(self.target, self.value)
        return replace(streams, gyro=streams.gyro + felt)

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        rate, force = (log.columns[f"{kind}_{self.target}"] for kind in ("gyro", "accel"))
        return log.with_columns({f"gyro_{self.target}": rate - self.value * force}), robot


class ImuPosition(Effect):
    """The IMU is mounted with an offset along one of its nominal axes; the reference is not.

    Haarnoja et al. (Science Robotics 2024) draw up to 5 mm; a published model with its IMU simply
    at the origin is off by more.
    """

    unit = "m"
    bounds = (-0.5, 0.5)
    targets = AXES
    traced = _accel(
        lossy=True,
        prior=Prior(0.1, "models whose IMU is left at the origin; 5 mm is drawn by others"),
        motion="turn fast about each axis: a lever arm's error grows with the rate squared",
    )

    def alter_mounting(self, robot: Robot) -> Robot:
        return replace(robot, p_BI=robot.p_BI + robot.R_BI @ along(self.target, self.value))

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        # Rows are means over a step, so the change of the rate over one is between its neighbours.
        omega, arm = log.gyro, along(self.target, self.value)
        spin = np.gradient(omega, log.t, axis=0)
        felt = np.cross(spin, arm) + np.cross(omega, np.cross(omega, arm))
        return log.with_columns(named_columns("accel", log.accel - felt)), robot


class ImuLowpass(Effect):
    """Gyro and accelerometer are filtered by a first-order low-pass of this time constant.

    A bandwidth of f Hz corresponds to 1 / (2 pi f) s: 3.2 ms for 50 Hz. The MPU-6050's filter can
    be set from 260 Hz down to 5 Hz (32 ms), by its register map.
    """

    unit = "s"
    bounds = (0.0, 0.1)
    targets = ("all",)
    traced = _imu(
        channels=("imu_gyro", "imu_accel"),
        lossy=True,
        prior=Prior(0.032, f"{_SPECIFICATION}, register map: down to 5 Hz"),
    )

    def alter_streams(self, streams: Streams, robot: Robot) -> Streams:
        gyro, accel = (low_pass(x, self.value, streams.rate) for x in (streams.gyro, streams.accel))
        return replace(streams, gyro=gyro, accel=accel)

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        # Filter the model's IMU instead: inverting the filter would amplify the readings' noise.
        return log, declared_on(robot, imu_lowpass=self.value)


class MountingRotation(Effect):
    """The IMU is mounted with a rotation about one of its nominal axes, and so is the reference.

    The reference was aligned with the IMU, so the two agree, and the legs are rotated against both.
    Motion capture is aligned to a body or its IMU by hand or by fitting, to about a degree.
    """

    unit = "rad"
    bounds = (-0.5, 0.5)
    targets = AXES
    traced = Traced(
        channels=("leg_velocity", "foot_height", "base_wrench"),
        step=1e-3,
        needs=("reference",),
        motion="walk in every direction, crouched and tall",
    )

    def alter_mounting(self, robot: Robot) -> Robot:
        return replace(robot, R_BI=robot.R_BI @ turn_about(self.target, self.value))

    def alter_reference(self, reference: Reference) -> Reference:
        return replace(reference, R_GI=reference.R_GI @ turn_about(self.target, self.value))

    def compensate(self, log: Log, robot: Robot) -> tuple[Log, Robot]:
        return log, replace(robot, R_BI=robot.R_BI @ turn_about(self.target, self.value))
