"""Detection of rest in a log, and the noise of its IMU and encoders during it."""

from dataclasses import dataclass

import numpy as np

from surefoot.models.noise.allan import AxisNoise, axis_noise
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.log import Log

QUIET_WINDOW, QUIET_BLOCKS = 0.5, 10
"""Length of a window [s], and number of blocks that it is divided into: means over 50 ms suppress
white noise but not a robot's motion.
"""
QUIET_GYRO, QUIET_ACCEL = 0.03, 0.5
"""Standard deviation of these means, in rad/s and m/s^2, up to which a robot is at rest."""
TURNED = 0.01
"""Difference between the means of successive windows up to which they belong to one rest: of the
gyro [rad/s] and, in units of 10 m/s^2, of the accelerometer.
"""


@dataclass(frozen=True)
class RestNoise:
    """Noise of a log at rest.

    Attributes:
        begin: of the rest [s].
        end: of the rest [s].
        gyro: noise of each axis, in rad/s.
        accel: noise of each axis, in m/s^2.
        encoder: standard deviation of single readings at rest (J,) [rad]; empty without joints.
        stance: the same while the joint's foot is in stance, also in a walk (J,) [rad]; NaN where
            the joint's name begins with that of no leg, or its foot hardly stands.
    """

    begin: float
    end: float
    gyro: tuple[AxisNoise, ...]
    accel: tuple[AxisNoise, ...]
    encoder: np.ndarray
    stance: np.ndarray


def rest_of(log: Log) -> np.ndarray:
    """Rows of the longest section of a log in which its IMU is at rest.

    Windows are quiet if gyro and accelerometer vary by less than QUIET_GYRO and QUIET_ACCEL.
    Successive quiet windows are joined if their means agree to TURNED. Raises SurefootError where
    no window is quiet.
    """
    log.require("imu")
    block = max(round(QUIET_WINDOW * log.rate / QUIET_BLOCKS), 1)
    size = block * QUIET_BLOCKS
    count = len(log.t) // size
    gyro, accel = (
        x[: count * size].reshape(count, QUIET_BLOCKS, block, 3).mean(axis=2)
        for x in (log.gyro, log.accel)
    )
    quiet = (gyro.std(axis=1).max(axis=1) < QUIET_GYRO) & (
        accel.std(axis=1).max(axis=1) < QUIET_ACCEL
    )
    if not quiet.any():
        raise SurefootError(
            f"{log.name}: nowhere at rest: no {QUIET_WINDOW} s in which the gyro moves by less "
            f"than {QUIET_GYRO} rad/s and the accelerometer by less than {QUIET_ACCEL} m/s^2"
        )
    turned = np.abs(np.diff(gyro.mean(axis=1), axis=0)).max(axis=1) > TURNED
    tilted = np.abs(np.diff(accel.mean(axis=1), axis=0)).max(axis=1) > 10.0 * TURNED
    joined = quiet[1:] & quiet[:-1] & ~turned & ~tilted
    begins = np.flatnonzero(quiet & ~np.r_[False, joined])
    ends = np.flatnonzero(quiet & ~np.r_[joined, False])
    best = np.argmax(ends - begins)
    return np.arange(begins[best] * size, (ends[best] + 1) * size)


def rest_noise(log: Log) -> RestNoise:
    """Noise of the IMU and the encoders during the longest rest of a log.

    Raises SurefootError where there is no rest, or only too short ones.
    """
    rows = rest_of(log)
    t = log.t[rows]
    gyro, accel = (
        tuple(axis_noise(x[rows, axis], log.rate) for axis in range(3))
        for x in (log.gyro, log.accel)
    )
    encoder = stance = np.zeros(0)
    if log.has("q"):
        encoder = encoder_noise(log.q[rows])
        stance = _stance_noise(log)
    return RestNoise(float(t[0]), float(t[-1]), gyro, accel, encoder, stance)


def encoder_noise(q: np.ndarray) -> np.ndarray:
    """Standard deviation (J,) of the white noise of readings q (N, J) of a smooth motion.

    Third differences of white noise have 1 + 9 + 9 + 1 times its variance; of the motion they
    contain only the jerk.
    """
    return np.diff(q, n=3, axis=0).std(axis=0) / np.sqrt(20.0)


def _stance_noise(log: Log) -> np.ndarray:
    """`encoder_noise` of each joint (J,) over the rows in which the foot of its leg stands.

    A joint is of the leg whose name its own begins with; NaN where there is none.
    """
    found = np.full(len(log.joints), np.nan)
    if not log.has("contact"):
        return found
    third = np.diff(log.q, n=3, axis=0)
    for leg, name in enumerate(log.legs):
        own = [j for j, joint in enumerate(log.joints) if joint.startswith(f"{name}_")]
        stands = np.convolve(log.contact[:, leg], np.ones(4), mode="valid") > 3.5
        if np.count_nonzero(stands) > 8:
            found[own] = third[stands][:, own].std(axis=0) / np.sqrt(20.0)
    return found
