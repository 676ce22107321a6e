"""Initial state of a filter: from the reference's first row, from gravity at rest, or from gravity
and the legs in motion.
"""

from dataclasses import dataclass, replace
from itertools import accumulate
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from surefoot.estimator.core.lie import hat
from surefoot.estimator.core.state import NavState
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.gravity import GRAVITY
from surefoot.sim.log import Log, foot_velocity, joint_velocity, reference_velocity
from surefoot.sim.robot.feet import Feet, shown_feet

Start = Literal["reference", "rest", "moving"]
"""What a first state is taken from; see `initial_state`."""

STILL_WINDOW = 0.5
"""Time at a log's start over which the gyro's bias is averaged [s], and gravity without a
reference.
"""
STILL_GYRO, STILL_ACCEL = 0.03, 0.5
"""Spread of the readings over that window, rad/s and m/s^2, above which a robot is not at rest."""
INDEPENDENT = 0.02
"""Interval at which a gyro's readings at rest count as independent [s]."""
MOVING_WINDOW = 1.0
"""Time at the start of a log in motion from which gravity and velocity are fitted [s], about two
strides.
"""
BEGINNING = 0.1
"""Time over which the first motion is averaged [s], three rows at least: a fifth of a stride."""
LEG_MOVES, BODY_TURNS = 0.3, 0.1
"""Rate from which a joint [rad/s] or a foot [m/s] moves (standing robots have 0.01, walking ones
0.7), and RMS rate from which a body turns [rad/s] (twenty times the noise of a gyro at rest).
"""
STANCE = 0.25
"""Time over which the errors of leg velocities are correlated [s], a stance of a trot."""
UNKNOWN_VELOCITY = 1.0
"""Standard deviation of a velocity that no sensor shows [m/s], a fast walk."""
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


def start_of(log: Log) -> Start:
    """What the first state of a log is best taken from: its reference, or else what the IMU and the
    joints of the first rows show.
    """
    if log.has("reference") and log.ref_ok[0]:
        return "reference"
    return "moving" if starts_in_motion(log) else "rest"


def starts_in_motion(log: Log) -> bool:
    """Whether a robot already moves in the first rows of a log, by its gyro and its legs; False
    without an IMU, since no filter runs then.
    """
    if not log.has("imu"):
        return False
    first, leg = log.rows(log.t <= max(log.t[0] + BEGINNING, log.t[:3][-1])), 0.0
    if log.has("q"):
        leg = np.abs(joint_velocity(first).mean(axis=0)).max()
    elif log.has("foot"):
        leg = np.abs(foot_velocity(first).mean(axis=0)).max()
    turning = np.sqrt(np.mean(np.sum(first.gyro**2, axis=1)))
    return bool(turning >= BODY_TURNS or leg >= LEG_MOVES)


def initial_state(
    log: Log, start: Start | None = None, feet: Feet | None = None
) -> tuple[NavState, InitialStd]:
    """State at the log's first row and its standard deviations.

    - reference: its first position, attitude and velocity (REFERENCE_STD).
    - rest: roll and pitch from the mean specific force of the first 0.5 s; yaw, position and
      velocity zero (GRAVITY_STD), assuming that the robot stands.
    - moving: roll, pitch and velocity from IMU and standing legs over the first second;
      yaw and position zero.

    Biases start at zero, the gyro's at its mean if the IMU shows that the robot is at rest
    (`still_gyro_bias`).

    Raises LogError where the log lacks the reference or the IMU that this takes, and SurefootError
    where the reference is not valid in the first row or the mean specific force cannot be gravity
    (more than 2 m/s^2 off).

    Args:
        log: whose first rows are used.
        start: what the state is taken from; by default `start_of` the log.
        feet: how the log shows its feet; None if it does not.
    """
    start = start or start_of(log)
    if start == "reference":
        log.require("reference")
        if not log.ref_ok[0]:
            raise SurefootError(f"{log.name}: ref_ok is 0 in the first row, nothing to start from")
        b_g, std = still_gyro_bias(log, REFERENCE_STD)
        return NavState(log.ref_R_GI[0], reference_velocity(log)[0], log.ref_p[0], b_g=b_g), std
    log.require("imu")
    window = STILL_WINDOW if start == "rest" else MOVING_WINDOW
    first = log.rows(log.t <= log.t[0] + window)
    if start == "rest":
        b_g, std = still_gyro_bias(log, GRAVITY_STD)
        force, v_I = first.accel.mean(axis=0), np.zeros(3)
    else:
        b_g = np.zeros(3)
        force, v_I, std = _moving(first, feet)
    size = float(np.linalg.norm(force))
    if abs(size - GRAVITY) > 2.0:
        raise SurefootError(
            f"{log.name}: accel averages {size:.1f} m/s^2 over the first {window} s, "
            "so gravity is unknown; start the log standing or give a reference"
        )
    R_GI = level(force)
    return NavState(R_GI, R_GI @ v_I, b_g=b_g), std


def _moving(first: Log, feet: Feet | None) -> tuple[np.ndarray, np.ndarray, InitialStd]:
    """Reaction to gravity (3,) [m/s^2] and velocity (3,) [m/s] in I at the first row, and their
    deviations.

    In the axes of I at the first row, v(t) = v_0 + integral of the specific force + g t. With v(t)
    from the standing legs, v_0 and g are the line that fits the rest best; its errors are
    correlated over a STANCE. Without legs, v_0 is unknown and the same at the end.
    """
    t = first.t - first.t[0]
    dt = np.diff(t, prepend=0.0)
    turns = Rotation.from_rotvec(first.gyro * dt[:, None]).as_matrix()
    R = np.array(list(accumulate(turns, np.matmul)))  # turns the axes of a row to the first's
    gained = np.cumsum(np.einsum("nij,nj->ni", R, first.accel) * dt[:, None], axis=0)
    force = gained[-1] / t[-1] if t[-1] > 0.0 else first.accel[0]
    v_I = np.einsum("nij,nj->ni", R, _velocity_of_legs(first, feet, force @ R))
    known = np.isfinite(v_I).all(axis=1)
    span = float(np.ptp(t[known])) if known.any() else 0.0
    if span < STANCE:
        return force, np.zeros(3), replace(GRAVITY_STD, velocity=UNKNOWN_VELOCITY)
    line = np.stack([np.ones(np.count_nonzero(known)), t[known]], axis=1)
    fit, *_ = np.linalg.lstsq(line, v_I[known] - gained[known], rcond=None)
    error = np.sqrt(np.mean((v_I[known] - gained[known] - line @ fit) ** 2) * STANCE / span)
    std = REFERENCE_STD
    tilt = np.hypot(np.sqrt(12.0) * error / span, std.b_a) / GRAVITY + 0.5 * std.b_g * span
    velocity = np.hypot(2.0 * error, std.velocity)
    return -fit[1], fit[0], replace(std, tilt=max(float(tilt), std.tilt), velocity=float(velocity))


def _velocity_of_legs(first: Log, feet: Feet | None, up: np.ndarray) -> np.ndarray:
    """Velocity of the IMU in I (N, 3) [m/s] by the standing feet; NaN where it is unknown.

    up (N, 3): along the ground's normal, in I.
    """
    shown = shown_feet(first, feet)
    if shown is None or not first.has("contact"):
        return np.full((len(first.t), 3), np.nan)
    up = up / np.maximum(np.linalg.norm(up, axis=1, keepdims=True), 1e-9)
    by_foot = shown.imu_velocity(*shown.readings(first), first.gyro, up, first.contact)
    count = np.isfinite(by_foot[..., 0]).sum(axis=1)
    return np.nansum(by_foot, axis=1) / np.where(count, count, np.nan)[:, None]


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
