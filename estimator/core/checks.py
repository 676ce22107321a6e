"""Validation of a filter's inputs and state.

Inputs must have the right shape, be finite and within the range of sensors, and covariances must be
definite; a state must be within the range of double precision.
"""

import numpy as np

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.kernels import kernel

_FLOAT = np.dtype(float)

MOST_GYRO = 200.0
"""Largest accepted rate [rad/s]; the fastest gyros of IMUs reach 4000 deg/s, 70 rad/s."""
MOST_ACCEL = 1e4
"""Largest accepted specific force [m/s^2]; shock accelerometers reach 400 g, a foot's impact some
10 g.
"""
MOST_STEP = 10.0
"""Longest accepted step [s]. After a longer gap the filter must be started anew: an IMU of 1 mg and
0.1 deg/s has drifted by a metre, and the motion was not measured.
"""
MOST_SPEED = 1e3
"""Largest accepted measured velocity [m/s], three times the speed of sound."""
MOST_ANGLE, MOST_RATE, MOST_TORQUE = 1e4, 1e3, 1e6
"""Largest accepted angle [rad], rate [rad/s] and torque [N m] of a joint: 1500 turns, the speed of
an unloaded motor, and a torque beyond any machine.
"""
MOST_REACH = 1e2
"""Largest accepted distance from the IMU to a foot [m]."""
MOST_DEVIATION = np.repeat([1e3, 1e7, 1e11, 1e3, 1e3], 3)
"""Standard deviations (15,) of rotation [rad], velocity [m/s], position [m] and biases [m/s^2,
rad/s] beyond which a filter has diverged. Integration of an IMU alone stays below them for a day,
and double precision can represent covariances over this range.
"""
MOST_MEAN = np.array([1.1, 1.1, 1.1, 1e7, 1e11, 1e4, 1e3])
"""The same for the rows of the packed mean: rotation, velocity, position and biases."""


class SampleError(SurefootError):
    """A sample that a filter rejects; its state is unchanged."""


class DivergedError(SurefootError):
    """A filter whose state has diverged; it accepts no further samples."""


def numbers(name: str, value, shape: tuple) -> np.ndarray:
    """`value` as a contiguous float array of that shape (-1: any); SurefootError otherwise."""
    try:
        out = np.array(value, dtype=float, order="C")
    except (TypeError, ValueError):
        raise SurefootError(f"{name}: not numbers") from None
    if out.ndim != len(shape) or any(
        s not in (-1, n) for s, n in zip(shape, out.shape, strict=True)
    ):
        wanted = "(" + ", ".join("N" if s == -1 else str(s) for s in shape) + ")"
        raise SurefootError(f"{name}: shape {out.shape} where {wanted} is expected")
    if not np.all(np.isfinite(out)):
        raise SurefootError(f"{name}: has values that are not finite")
    return out


def vector(name: str, value) -> np.ndarray:
    """`numbers(name, value, (3,))`, fast where `value` is a float array already."""
    if _plain(value, (3,)):
        x, y, z = value.tolist()
        # NaN if one of them is infinite or NaN itself.
        if (x - x) + (y - y) + (z - z) == 0.0:
            return value
    return numbers(name, value, (3,))


def spd_3(name: str, value) -> np.ndarray:
    """`spd(name, value, 3)`, fast where `value` is a float array already."""
    if _plain(value, (3, 3)) and definite_3(value):
        return value
    return spd(name, value, 3)


def _plain(value, shape: tuple) -> bool:
    return (
        type(value) is np.ndarray
        and value.dtype is _FLOAT
        and value.shape == shape
        and value.flags.carray
    )


@kernel
def definite_3(S) -> bool:
    """Whether S (3, 3) is finite, symmetric and positive definite, by its leading minors."""
    if S[0, 1] != S[1, 0] or S[0, 2] != S[2, 0] or S[1, 2] != S[2, 1]:
        return False
    two = S[0, 0] * S[1, 1] - S[0, 1] ** 2
    three = (
        S[2, 2] * two
        - S[0, 2] * (S[0, 2] * S[1, 1] - S[0, 1] * S[1, 2])
        + S[1, 2] * (S[0, 2] * S[0, 1] - S[0, 0] * S[1, 2])
    )
    return 0.0 < S[0, 0] < np.inf and 0.0 < two < np.inf and 0.0 < three < np.inf


def spd(name: str, value, size: int) -> np.ndarray:
    """`value` as a symmetric positive definite (size, size) array; SurefootError otherwise."""
    out = numbers(name, value, (size, size))
    if np.abs(out - out.T).max() > 1e-9 * np.abs(out).max():
        raise SurefootError(f"{name}: is not symmetric")
    try:
        np.linalg.cholesky(out)
    except np.linalg.LinAlgError:
        raise SurefootError(f"{name}: is not positive definite") from None
    return 0.5 * (out + out.T)


@kernel
def all_within(x, most: float) -> bool:
    """Whether all of x (N,) are finite and at most `most` in magnitude."""
    inside = True
    for i in range(x.shape[0]):
        inside &= abs(x[i]) <= most
    return inside


@kernel
def is_sound(mean, covariance) -> bool:
    """Whether mean (7+E, 3) and covariance (15+3E, 15+3E) are within MOST_MEAN, MOST_DEVIATION."""
    sound = True
    for i in range(7):
        for j in range(3):
            sound &= abs(mean[i, j]) <= MOST_MEAN[i]
    for i in range(15):
        sound &= 0.0 <= covariance[i, i] <= MOST_DEVIATION[i] ** 2
    return sound


def check_sound(mean: np.ndarray, covariance: np.ndarray) -> None:
    """Raise DivergedError where a filter's state is not sound."""
    if not is_sound(mean, covariance):
        raise DivergedError("the filter has diverged: begin a new one")


def check_step(gyro, accel, dt: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Check an IMU's means over a step. Raises SampleError for values that no IMU gives."""
    try:
        gyro, accel, dt = vector("gyro", gyro), vector("accel", accel), float(dt)
    except (SurefootError, TypeError, ValueError) as error:
        raise SampleError(f"{error}") from None
    if not 0.0 < dt <= MOST_STEP:
        raise SampleError(f"dt: {dt} where a number > 0 and at most {MOST_STEP:g} s is expected")
    for name, value, most, unit in (
        ("gyro", gyro, MOST_GYRO, "rad/s"),
        ("accel", accel, MOST_ACCEL, "m/s^2"),
    ):
        if not all_within(value, most):
            raise SampleError(f"{name}: beyond {most:g} {unit}, which no sensor reads")
    return gyro, accel, dt


def check_velocity(v_I) -> np.ndarray:
    """Check a measured velocity (3,) [m/s]. Raises SampleError for an implausible one."""
    v_I = vector("v_I", v_I)
    if not all_within(v_I, MOST_SPEED):
        raise SampleError(f"v_I: beyond {MOST_SPEED:g} m/s")
    return v_I


def row_indices(rows, count: int, n: int) -> np.ndarray:
    """Check row indices (count,), strictly increasing inside [0, n)."""
    rows = np.asarray(rows)
    if rows.shape != (count,):
        raise SurefootError(f"rows: shape {rows.shape} where ({count},) is expected, one a v_I")
    rows = rows.astype(np.int64)
    if count and (rows[0] < 0 or rows[-1] >= n or not np.all(np.diff(rows) > 0)):
        raise SurefootError(f"rows: must increase strictly inside 0..{n - 1}")
    return rows
