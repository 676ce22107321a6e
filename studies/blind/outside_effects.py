"""Effects outside the catalogue, for which a trace should report that none of its own explains the
log.

One small class each, as in `sim.effects.catalogue`, but without compensation by a model.
"""

from dataclasses import replace

import numpy as np
from scipy.signal import lfilter

from surefoot import Robot
from surefoot.extend import AXES, Effect, Streams, Traced

ENCODER_CHANNELS = (
    *("leg_velocity", "stance_velocity", "stance_displacement", "foot_height"),
    *("base_wrench", "joint_torque"),
)
"""Channels in which an error of a joint's angle shows."""


class EncoderEccentricity(Effect):
    """An encoder's magnet is off its axis, before a gear of 6: an error once per turn of the
    motor.
    """

    name = "encoder_eccentricity"
    unit = "rad"
    bounds = (0.0, 0.1)
    traced = Traced(channels=ENCODER_CHANNELS)
    targets = "joint"
    gear = 6.0

    def alter_streams(self, streams: Streams, robot: Robot) -> Streams:
        j = robot.limbs.joints.index(self.target)
        turn = self.gear * streams.q[:, j]
        q, dq = streams.q.copy(), streams.dq.copy()
        q[:, j] += self.value * np.sin(turn)
        dq[:, j] += self.value * self.gear * np.cos(turn) * streams.dq[:, j]
        return replace(streams, q=q, dq=dq)


class ThermalGyroDrift(Effect):
    """A gyro's bias settles to this size while it warms up, with a time constant of 15 s."""

    name = "thermal_gyro_drift"
    unit = "rad/s"
    bounds = (0.0, 0.5)
    traced = Traced(channels=("imu_gyro",))
    targets = AXES

    def alter_streams(self, streams: Streams, robot: Robot) -> Streams:
        gyro = streams.gyro.copy()
        warm = 1.0 - np.exp(-(streams.t - streams.t[0]) / 15.0)
        gyro[:, AXES.index(self.target)] += self.value * warm
        return replace(streams, gyro=gyro)


class MagnetCrosstalk(Effect):
    """The motor's current distorts the magnetic field of its encoder, depending on the rotor's
    angle.
    """

    name = "magnet_crosstalk"
    unit = "rad"
    bounds = (0.0, 0.1)
    traced = Traced(channels=ENCODER_CHANNELS)
    targets = "joint"

    def alter_streams(self, streams: Streams, robot: Robot) -> Streams:
        j = robot.limbs.joints.index(self.target)
        bent = self.value * np.tanh(streams.tau[:, j] / 20.0) * np.sin(9.0 * streams.q[:, j])
        q, dq = streams.q.copy(), streams.dq.copy()
        q[:, j] += bent
        dq[:, j] += np.gradient(bent, streams.t)
        return replace(streams, q=q, dq=dq)


class TorqueRipple(Effect):
    """Cogging that appears in the motor's current but not at the joint: 28 times per turn."""

    name = "torque_ripple"
    unit = "N m"
    bounds = (0.0, 20.0)
    traced = Traced(channels=("joint_torque", "base_wrench", "command"))
    targets = "joint"

    def alter_streams(self, streams: Streams, robot: Robot) -> Streams:
        j = robot.limbs.joints.index(self.target)
        tau = streams.tau.copy()
        tau[:, j] += self.value * np.sin(28.0 * streams.q[:, j])
        return replace(streams, tau=tau)


class DuplicatedPackets(Effect):
    """This share of the joints' rows repeats an older one: five rows are held at a time."""

    name = "duplicated_packets"
    unit = "ratio"
    bounds = (0.0, 0.5)
    traced = Traced(
        channels=("joint_rate", "joint_torque", "leg_velocity", "stance_velocity", "command")
    )
    targets = ("all",)

    def alter_streams(self, streams: Streams, robot: Robot) -> Streams:
        rows = np.arange(len(streams.t))
        lost = np.random.default_rng(len(rows)).random(len(rows)) < self.value / 5.0
        for first in np.flatnonzero(lost):
            rows[first : first + 5] = rows[first]
        held = {name: getattr(streams, name)[rows] for name in ("q", "dq", "tau")}
        return replace(streams, **held)


class LooseImu(Effect):
    """An IMU on a soft mount, 18 Hz and lightly damped: it tilts by this angle per 10 m/s^2 of
    vibration, and the gyro measures the tilting.
    """

    name = "loose_imu"
    unit = "rad"
    bounds = (0.0, 0.2)
    traced = Traced(channels=("imu_gyro", "imu_accel"))
    targets = AXES

    def alter_streams(self, streams: Streams, robot: Robot) -> Streams:
        a = AXES.index(self.target)
        b, c = (a + 1) % 3, (a + 2) % 3
        dt, w, damping = 1.0 / streams.rate, 2 * np.pi * 18.0, 0.1
        shake = streams.accel[:, b] - streams.accel[:, b].mean()
        # x'' + 2 d w x' + w^2 x = w^2 u, by backward differences.
        whole = 1.0 + 2 * damping * w * dt + (w * dt) ** 2
        poles = [1.0, -(2.0 + 2 * damping * w * dt) / whole, 1.0 / whole]
        tilt = lfilter([self.value / 10.0 * (w * dt) ** 2 / whole], poles, shake)
        gyro, accel = streams.gyro.copy(), streams.accel.copy()
        gyro[:, a] += np.gradient(tilt, streams.t)
        accel[:, b] += tilt * streams.accel[:, c]
        accel[:, c] -= tilt * streams.accel[:, b]
        return replace(streams, gyro=gyro, accel=accel)


OUTSIDE_EFFECTS = {
    kind.name: kind
    for kind in (
        EncoderEccentricity,
        ThermalGyroDrift,
        MagnetCrosstalk,
        TorqueRipple,
        DuplicatedPackets,
        LooseImu,
    )
}
"""By name; any of the channels of an effect is a correct answer."""
