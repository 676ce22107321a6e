"""Initial state of a filter, from the reference's first row or, without one, from gravity."""

from dataclasses import dataclass, replace

import numpy as np

from surefoot.estimator.core.lie import hat
from surefoot.estimator.core.state import NavState
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.gravity import GRAVITY
from surefoot.sim.log import Log, reference_velocity

STILL_WINDOW = 0.5
"""Time at a log's start over which the gyro's bias is averaged [s], and gravity without a
reference.
"""
STILL_GYRO, STILL_ACCEL = 0.03, 0.5
"""Spread of the readings over that window, rad/s and m/s^2, above which a robot is not at rest."""
INDEPENDENT = 0.02
"""Interval at which a gyro's readings at rest count as independent [s]."""
STILL_BIAS = 3e-4
"""Least standard deviation of a gyro bias estimated at rest [rad/s], since legs yield slowly."""


@dataclass(frozen=True)
class InitialStd:
    """Standard deviations of the initial state in G: attitude [rad], velocity [m/s], position [m],
    biases.

    tilt is about the horizontal axes of G, yaw about the vertical. b_a [m/s^2] covers the offset of
    a factory-calibrated MEMS accelerometer (10 mg), b_g [rad/s] that of its gyro (0.3 deg/s).
    Position and yaw are unobservable and aligned before any metric: their values are the
    reference's, and their deviations only keep the covariance definite. height [m], if given, is
    that of the vertical position, which is known at a start on known ground.
    """

    tilt: float = 0.02
    yaw: float = 1e-3
    velocity: float = 0.05
    position: float = 1e-3
    b_a: float = 0.1
    b_g: float = 5e-3
    height: float | None = None


REFERENCE_STD = InitialStd()
GRAVITY_STD = InitialStd(tilt=0.05, velocity=0.2)


def initial_state(log: Log, std: InitialStd | None = None) -> tuple[NavState, np.ndarray]:
    """State at the log's first row and its covariance (15, 15) in right-invariant error order.

    With a reference: its first position, attitude and velocity (REFERENCE_STD). Without: roll and
    pitch from the mean specific force of the first 0.5 s; yaw, position and velocity zero
    (GRAVITY_STD), assuming that the robot stands. Biases start at zero, the gyro's at its mean if
    the IMU shows that the robot is at rest (`still_gyro_bias`).

    Raises LogError where the log has neither a reference nor an IMU, and SurefootError where the
    reference is not valid in the first row or the mean specific force cannot be gravity (more than
    2 m/s^2 off).
    """
    if log.has("reference"):
        row = int(np.flatnonzero(log.ref_ok)[0]) if log.ref_ok.any() else 0
        if row != 0:
            raise SurefootError(f"{log.name}: ref_ok is 0 in the first row, nothing to start from")
        b_g, std = still_gyro_bias(log, std or REFERENCE_STD)
        state = NavState(log.ref_R_GI[0], reference_velocity(log)[0], log.ref_p[0], b_g=b_g)
        return state, start_covariance(state, std)
    log.require("imu")
    start = log.t <= log.t[0] + STILL_WINDOW
    force = log.accel[start].mean(axis=0)
    size = float(np.linalg.norm(force))
    if abs(size - GRAVITY) > 2.0:
        raise SurefootError(
            f"{log.name}: accel averages {size:.1f} m/s^2 over the first {STILL_WINDOW} s, "
            "so gravity is unknown; start the log standing or give a reference"
        )
    b_g, std = still_gyro_bias(log, std or GRAVITY_STD)
    state = NavState(level(force), b_g=b_g)
    return state, start_covariance(state, std)


def still_gyro_bias(log: Log, std: InitialStd) -> tuple[np.ndarray, InitialStd]:
    """Gyro bias (3,) [rad/s] if the log starts at rest, else zero; `std` with its deviation.

    The mean of the first 0.5 s, if these have two rows or more and their two halves agree: a robot
    that is standing up rotates slowly but steadily. The deviation is that of the mean, with one
    independent reading per INDEPENDENT, and at least STILL_BIAS.
    """
    if not log.has("imu"):
        return np.zeros(3), std
    start = log.t <= log.t[0] + STILL_WINDOW
    gyro, accel = log.gyro[start], log.accel[start]
    spread = float(gyro.std(axis=0).max())
    if len(gyro) < 2 or spread > STILL_GYRO or accel.std(axis=0).max() > STILL_ACCEL:
        return np.zeros(3), std
    first, second = np.array_split(gyro, 2)
    turned = np.abs(first.mean(axis=0) - second.mean(axis=0)).max()
    if turned > 3.0 * (STILL_BIAS + spread * np.sqrt(4.0 / len(gyro))):
        return np.zeros(3), std
    count = min(len(gyro) / (INDEPENDENT * log.rate), float(len(gyro)))
    deviation = max(STILL_BIAS, spread / np.sqrt(max(count, 1.0)))
    return gyro.mean(axis=0), replace(std, b_g=min(deviation, std.b_g))


def level(force_I: np.ndarray) -> np.ndarray:
    """R_GI (3, 3) with zero yaw that rotates the specific force (3,) of a body at rest onto +z of
    G.
    """
    up = force_I / np.linalg.norm(force_I)
    # The x axis of I keeps its heading or, if it is vertical, the y axis.
    forward = np.array([1.0, 0.0, 0.0]) if abs(up[0]) < 0.99 else np.array([0.0, 1.0, 0.0])
    x = forward - up * (up @ forward)
    x /= np.linalg.norm(x)
    return np.array([x, np.cross(up, x), up])


def start_covariance(state: NavState, std: InitialStd) -> np.ndarray:
    """Covariance (15, 15) of the right-invariant error for independent Euclidean errors in G.

    v_bar - v = xi_v - [v_bar]x xi_R and p_bar - p = xi_p - [p_bar]x xi_R to first order, so a
    position known to a millimetre far from the origin is correlated with the attitude in xi.
    """
    plain = np.repeat([0.0, std.velocity, std.position, std.b_a, std.b_g], 3)
    plain[:3] = std.tilt, std.tilt, std.yaw
    if std.height is not None:
        plain[8] = std.height
    if not (np.all(np.isfinite(plain)) and np.all(plain > 0)):
        raise SurefootError("initial std: every standard deviation must be a finite number > 0")
    T = np.eye(15)
    T[3:6, :3] = hat(state.v_GI)
    T[6:9, :3] = hat(state.p_GI)
    return T @ np.diag(plain**2) @ T.T
