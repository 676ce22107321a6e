"""Validation of a filter's inputs and state.

Inputs must have the right shape, be finite and within the range of sensors, and covariances must be
definite; a state must be within the range of double precision.
"""

import numpy as np

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.kernels import kernel

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
MOST_FORCE = 1e9
"""Largest accepted reading of a foot's force, in its own unit: more than 24 bits of counts."""
MOST_ITERATIONS = 1000
"""Largest number of projections in a coverage update."""
MOST_ASYMMETRY = 1e-9
"""Largest `asymmetry` of a covariance."""
MOST_DEVIATION = np.repeat([1e3, 1e7, 1e11, 1e3, 1e3], 3)
"""Standard deviations (15,) of rotation [rad], velocity [m/s], position [m] and biases [m/s^2,
rad/s] beyond which a filter has diverged. Integration of an IMU alone stays below them for a day,
and double precision can represent covariances over this range.
"""
MOST_MEAN = np.array([1.1, 1.1, 1.1, 1e7, 1e11, 1e4, 1e3])
"""Magnitudes (7,) of the rows of the packed mean (rotation, velocity, position and biases) beyond
which a filter has diverged, in the same units.
"""


class SampleError(SurefootError):
    """A sample that a filter rejects; its state is unchanged."""


class DivergedError(SurefootError):
    """A filter whose state has diverged; it accepts no further samples."""


def real(name: str, value) -> np.ndarray:
    """A copy of `value` as a contiguous float array; SurefootError for text, objects, and complex
    numbers.
    """
    try:
        out = np.asarray(value)
    except (TypeError, ValueError):
        raise SurefootError(f"{name}: not numbers") from None
    if out.dtype.kind not in "fiub":
        raise SurefootError(f"{name}: not {'real ' * (out.dtype.kind == 'c')}numbers")
    return np.array(out, dtype=float, order="C")


def numbers(name: str, value, shape: tuple) -> np.ndarray:
    """`value` as a contiguous float array of that shape (-1: any); SurefootError otherwise."""
    out = real(name, value)
    if out.ndim != len(shape) or any(
        s not in (-1, n) for s, n in zip(shape, out.shape, strict=True)
    ):
        wanted = "(" + ", ".join("N" if s == -1 else str(s) for s in shape) + ")"
        raise SurefootError(f"{name}: shape {out.shape} where {wanted} is expected")
    if not np.all(np.isfinite(out)):
        raise SurefootError(f"{name}: has values that are not finite")
    return out


def amounts(name: str, value, count: int) -> np.ndarray:
    """`value`, one number or `count` of them, as an array (count,) of finite numbers >= 0;
    SurefootError otherwise.
    """
    out = np.asarray(value, dtype=float)
    if out.shape not in ((), (count,)) or not np.all((out >= 0) & (out < np.inf)):
        raise SurefootError(f"{name} must be one or {count} finite numbers >= 0")
    return np.broadcast_to(out, count).copy()


def spd(name: str, value, size: int) -> np.ndarray:
    """`value` as a symmetric positive definite (size, size) array; SurefootError otherwise."""
    out = numbers(name, value, (size, size))
    if np.abs(out - out.T).max() > MOST_ASYMMETRY * np.abs(out).max():
        raise SurefootError(f"{name}: is not symmetric")
    try:
        np.linalg.cholesky(out)
    except np.linalg.LinAlgError:
        raise SurefootError(f"{name}: is not positive definite") from None
    return 0.5 * (out + out.T)


@kernel
def is_definite(S) -> bool:
    """Whether S (3, 3), of which the lower triangle is read, is positive definite: the pivots of
    its decomposition L D L^T are positive.
    """
    if not S[0, 0] > 0.0:
        return False
    b, c = S[1, 0] / S[0, 0], S[2, 0] / S[0, 0]
    second = S[1, 1] - b * S[1, 0]
    if not second > 0.0:
        return False
    d = S[2, 1] - b * S[2, 0]
    return S[2, 2] - c * S[2, 0] - d * d / second > 0.0


@kernel
def asymmetry(S) -> float:
    """Largest difference of two opposite elements of S (3, 3), as a share of its largest."""
    largest, skew = 0.0, 0.0
    for i in range(3):
        for j in range(3):
            largest = max(largest, abs(S[i, j]))
            skew = max(skew, abs(S[i, j] - S[j, i]))
    return skew / largest if skew > 0.0 else 0.0


@kernel
def symmetric_definite(S, out) -> bool:
    """Whether S (3, 3) is finite, symmetric and positive definite, as by `spd`.

    out (3, 3) receives its symmetric part.
    """
    finite = True
    for i in range(3):
        for j in range(3):
            finite &= np.isfinite(S[i, j])
            out[i, j] = 0.5 * (S[i, j] + S[j, i])
    return finite and asymmetry(S) <= MOST_ASYMMETRY and is_definite(out)


@kernel
def all_within(x, most: float) -> bool:
    """Whether all of x (N,) are finite and at most `most` in magnitude."""
    inside = True
    for i in range(x.shape[0]):
        inside &= abs(x[i]) <= most
    return inside


@kernel
def is_step(gyro, accel, dt: float) -> bool:
    """Whether gyro, accel (3,) and dt are what an IMU gives, as by `check_step`."""
    if gyro.shape[0] != 3 or accel.shape[0] != 3 or not 0.0 < dt <= MOST_STEP:
        return False
    return all_within(gyro, MOST_GYRO) and all_within(accel, MOST_ACCEL)


@kernel
def is_bounded(v_I, epsilon, gamma: float, iterations: int) -> bool:
    """Whether v_I and epsilon (3,) are a velocity with bounds, of a joint level in (0, 1)."""
    bounded = v_I.shape[0] == 3 and epsilon.shape[0] == 3 and all_within(v_I, MOST_SPEED)
    for i in range(epsilon.shape[0]):
        bounded &= 0.0 < epsilon[i] < np.inf
    return bounded and 0.0 < gamma < 1.0 and 1 <= iterations <= MOST_ITERATIONS


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


def check_step(gyro, accel, dt: float) -> None:
    """Check an IMU's means over a step. Raises SampleError for values that no IMU gives."""
    try:
        gyro, accel, dt = numbers("gyro", gyro, (3,)), numbers("accel", accel, (3,)), float(dt)
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


def check_velocity(v_I) -> np.ndarray:
    """Check a measured velocity (3,) [m/s]. Raises SampleError for an implausible one."""
    v_I = numbers("v_I", v_I, (3,))
    if not all_within(v_I, MOST_SPEED):
        raise SampleError(f"v_I: beyond {MOST_SPEED:g} m/s")
    return v_I


def check_bounds(epsilon, gamma: float, iterations: int = 1) -> None:
    """Check bounds (3,) or (M, 3) [m/s], their joint level, and the projections of an update."""
    if not np.all(np.asarray(epsilon) > 0):
        raise SurefootError("epsilon: every bound must be > 0 m/s")
    if not 0.0 < gamma < 1.0:
        raise SurefootError(f"gamma: {gamma} where a number inside (0, 1) is expected")
    if not 1 <= iterations <= MOST_ITERATIONS:
        raise SurefootError(
            f"iterations: {iterations} where a whole number in 1..{MOST_ITERATIONS} is expected"
        )


def row_indices(rows, count: int, n: int) -> np.ndarray:
    """Check row indices (count,), strictly increasing inside [0, n)."""
    rows = np.asarray(rows)
    if rows.shape != (count,):
        raise SurefootError(f"rows: shape {rows.shape} where ({count},) is expected, one a v_I")
    rows = rows.astype(np.int64)
    if count and (rows[0] < 0 or rows[-1] >= n or not np.all(np.diff(rows) > 0)):
        raise SurefootError(f"rows: must increase strictly inside 0..{n - 1}")
    return rows
