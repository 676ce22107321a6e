"""Where a log rests, and the noise of its IMU and encoders there."""

from dataclasses import dataclass

import numpy as np

from surefoot.models.noise.allan import AxisNoise, axis_noise
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.log import Log

QUIET_WINDOW, QUIET_BLOCKS = 0.5, 10
"""s of a window that is looked at, and the means that it is divided into: 50 ms take white noise
off, and leave what a robot does."""
QUIET_GYRO, QUIET_ACCEL = 0.03, 0.5
"""rad/s and m/s^2: a robot whose means spread by more in a window does not stand still."""
TURNED = 0.01
"""rad/s, and times gravity m/s^2: windows whose means differ by more are not of one rest."""


@dataclass(frozen=True)
class RestNoise:
    """Noise of a log at rest.

    begin, end [s] of the rest; gyro (3 axes) [rad/s] and accel (3 axes) [m/s^2]; encoder (J,)
    [rad], deviation of single readings of each joint while the robot rests, and stance (J,), the
    same while its foot stands, walking or not, NaN where that is not known; both empty without
    joints.
    """

    begin: float
    end: float
    gyro: tuple[AxisNoise, ...]
    accel: tuple[AxisNoise, ...]
    encoder: np.ndarray
    stance: np.ndarray


def rest_of(log: Log) -> np.ndarray:
    """Rows of the longest stretch of a log in which its IMU shows that it rests.

    Windows of half a second are quiet where neither gyro nor accelerometer moves by more than a
    robot that stands does; neighbours belong together if their means
    agree. Raises SurefootError where no window is quiet.
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
    """Noise of the IMU and the encoders of a log that rests somewhere.

    Raises SurefootError where it rests nowhere, or too shortly.
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
    """Deviation (J,) of the white noise of readings q (N, J), whatever smooth motion is below it.

    Third differences of white noise have the variance 1 + 9 + 9 + 1 times its own; what the joint
    does within four samples they leave out but for its jerk.
    """
    return np.diff(q, n=3, axis=0).std(axis=0) / np.sqrt(20.0)


def _stance_noise(log: Log) -> np.ndarray:
    """`encoder_noise` of each joint (J,) over the rows that are of a stance."""
    if not log.has("contact") or len(log.joints) % len(log.legs):
        return np.full(len(log.joints), np.nan)
    each = len(log.joints) // len(log.legs)
    found = []
    third = np.diff(log.q, n=3, axis=0)
    for leg in range(len(log.legs)):
        stands = np.convolve(log.contact[:, leg], np.ones(4), mode="valid") > 3.5
        some = third[stands, leg * each : (leg + 1) * each]
        found.append(some.std(axis=0) / np.sqrt(20.0) if len(some) > 8 else np.full(each, np.nan))
    return np.concatenate(found)
