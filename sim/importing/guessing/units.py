"""Units and signs of a recording's columns, from their values.

Units follow from magnitudes, and from columns that measure the same: rates and the derivative of
angles, the gyro and the rotation of gravity. Left and right follow from the strides in turns.
"""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import pandas as pd
from scipy.ndimage import uniform_filter1d

from surefoot.sim.importing.columns import DEGREE, STANDARD_GRAVITY, UNITS
from surefoot.sim.log.derived import JOINT_WINDOW, derivative

_LARGEST_ANGLE = 4.0 * np.pi
"""Largest plausible joint angle [rad], two turns; larger ones are in degrees."""
_LONGEST_TRAVEL = 5.0
"""Largest plausible distance of a joint that slides [m]."""
_SURE_ANGLE = 3.5
"""Largest joint angle that is certainly in radians [rad]."""
_NEAR = 1.25
"""Tolerance of a ratio that identifies a unit."""
_AGREE = 0.5
"""Correlation from which two columns measure the same."""
_CAN_TURN = 0.1
"""Standard deviation of the yaw rate from which strides distinguish left from right [rad/s]."""
_STRIDES = 1.0
"""Window for the size of strides [s]."""
_ASSUMED_STEP = 0.005
"""Assumed interval between the rows of a recording without times, to compare a rate with its angle
[s].
"""


def usual_size(values: Iterable[np.ndarray]) -> float:
    """Magnitude that one value in a hundred exceeds, of the largest of some columns (N,)."""
    return max((float(np.quantile(np.abs(x), 0.99)) for x in values), default=0.0)


def unit_of_angles(values: Iterable[np.ndarray], named: set[str]) -> tuple[str, str]:
    """Unit of angles, each (N,), and a doubt; `named` are the units in the columns' names."""
    for unit in ("deg", "rad"):
        if unit in named:
            return unit, ""
    most = usual_size(values)
    if most > 800.0:
        return "rad", f"reaches {most:.3g}: counts, with which gain?"
    if most > _LARGEST_ANGLE:
        return "deg", ""
    return "rad", "" if most < _SURE_ANGLE else "rad or deg?"


def unit_of_travels(values: Iterable[np.ndarray], named: set[str]) -> tuple[str, str]:
    """Unit of the distances of joints that slide, each (N,), and a doubt; `named` as above."""
    for unit in UNITS["foot"]:
        if unit in named:
            return unit, ""
    return ("m", "") if usual_size(values) < _LONGEST_TRAVEL else ("mm", "mm or cm?")


def unit_of_rates(
    t: np.ndarray | None,
    rates: Sequence[np.ndarray],
    angles: Sequence[np.ndarray],
    units: Mapping[str, float] = UNITS["dq"],
) -> tuple[str, str, float | None]:
    """Unit of joint rates, by the derivative of their angles, and a doubt.

    Without times, rates are assumed to be in rad/s and determine the rate of the rows [Hz], the
    third value.

    Args:
        t: (N,) [s], or None.
        rates: of joints, each (N,).
        angles: of the same joints, each (N,) [rad or m]; may be empty.
        units: of which it is one.
    """
    first = next(iter(units))
    if not angles:
        unit, other = ("rad/s", "deg/s") if usual_size(rates) < 60.0 else ("deg/s", "rad/s")
        return unit, f"{unit} or {other}?", None
    q, dq = np.column_stack(angles), np.column_stack(rates)
    times = t if t is not None else _ASSUMED_STEP * np.arange(len(q))
    window = max(JOINT_WINDOW, 5.0 * float(np.median(np.diff(times))))
    change = derivative(times, q, window, causal=False)
    alike = np.sum(change * dq) / max(np.linalg.norm(change) * np.linalg.norm(dq), 1e-12)
    ratio = np.sum(change * dq) / max(float(np.sum(dq**2)), 1e-12)
    if abs(alike) < _AGREE:
        return first, "does not follow its angle: of which joint, in which unit?", None
    if t is None:
        # The ratio is the assumed rate of the rows over the true one.
        rows = float(f"{1.0 / _ASSUMED_STEP / abs(ratio):.3g}") if abs(ratio) > 1e-3 else None
        return first, f"{first}, if the rate of the rows is right?", rows
    for unit, size in units.items():
        if 1.0 / _NEAR < abs(ratio) / size < _NEAR:
            return unit, "" if ratio > 0.0 else "counts against its angle: sign = -1?", None
    return first, f"is {1.0 / ratio:.3g} times the change of its angle: in which unit?", None


def unit_of_gyro(
    t: np.ndarray | None, gyro: np.ndarray, accel: np.ndarray | None, named: set[str]
) -> tuple[str, str]:
    """Unit of a gyro (N, 3), and a doubt, from the rotation of gravity in the accelerometer.

    If that is inconclusive, from the units in names, or else from the gyro's magnitude.

    Args:
        t: (N,) [s], or None.
        gyro: (N, 3), in an unknown unit.
        accel: (N, 3) in any unit, or None.
        named: units in the columns' names.
    """
    size = usual_size([gyro])
    by_name = next(iter(named)) if len(named) == 1 and named <= set(UNITS["gyro"]) else ""
    unit = by_name or ("rad/s" if size < 12.0 else "deg/s")
    dt = 1.0 if t is None else max(float(np.median(np.diff(t))), 1e-6)
    width = max(int(0.5 / dt), 1)
    if t is not None and accel is not None and len(t) > 2 * width:
        smooth, mean_gyro = (uniform_filter1d(x, width, axis=0) for x in (accel, gyro))
        up = smooth / np.maximum(np.linalg.norm(smooth, axis=1, keepdims=True), 1e-9)
        turned = np.gradient(up, t, axis=0)[width:-width]
        by_gyro = -np.cross(mean_gyro, up)[width:-width]
        both = float(np.linalg.norm(turned) * np.linalg.norm(by_gyro))
        alike = float(np.sum(turned * by_gyro)) / max(both, 1e-12)
        ratio = float(np.sum(turned * by_gyro)) / max(float(np.sum(by_gyro**2)), 1e-12)
        for fitting, scale in (("rad/s", 1.0), ("deg/s", DEGREE)):
            if alike > 0.7 and 1 / 3 < ratio / scale < 3:
                return fitting, ""
        if alike < -0.7:
            return unit, "turns against the accelerometer: signs of one of them?"
    if accel is not None and not by_name and unit_of_accel(accel)[1] != 1.0:
        return unit, f"{unit}, or counts as the accelerometer's: with which gain?"
    return unit, "" if by_name or not 4.0 < size < 60.0 else "rad/s or deg/s?"


def unit_of_accel(accel: np.ndarray) -> tuple[str, float, str]:
    """Unit of an accelerometer (N, 3), gain, and a doubt: its usual magnitude is taken to be
    gravity, and the mean specific force to point up, +z.
    """
    size = float(np.median(np.linalg.norm(accel, axis=1)))
    for unit, low, high in (("m/s^2", 8.0, 12.0), ("g", 0.8, 1.2), ("mg", 0.8e3, 1.2e3)):
        if low < size < high:
            return unit, 1.0, _gravity_doubt(accel.mean(axis=0))
    gain = float(f"{STANDARD_GRAVITY / max(size, 1e-9):.4g}")
    return "m/s^2", gain, f"its length is {size:.3g} at rest: in which unit?"


def _gravity_doubt(mean: np.ndarray) -> str:
    """A doubt about the axes where the mean specific force (3,) does not point up."""
    axis = int(np.argmax(np.abs(mean)))
    along = f"{'+' if mean[axis] > 0 else '-'} on {'xyz'[axis]}"
    asked = "change [robot] imu_orientation, axes or signs, or add gravity (offset = 19.62)?"
    return "" if along == "+ on z" else f"gravity reads {along}, not + on z: {asked}"


def stride_in_turns(
    t: np.ndarray, yaw: np.ndarray, left: Sequence[np.ndarray], right: Sequence[np.ndarray]
) -> float | None:
    """Growth of the right legs' strides over the left ones' with the rate of left turns, in log
    units per rad/s.

    Positive if the sides are right, since the outer legs move further. None where it cannot be
    determined.

    Args:
        t: (N,) [s].
        yaw: (N,) yaw rate, positive to the left [rad/s].
        left: angles (N,) of the left legs' thighs, in any unit.
        right: of the right legs'.
    """
    second = np.floor((t - t[0]) / _STRIDES)
    turning = np.asarray(pd.Series(yaw).groupby(second).mean())
    parts = [pd.DataFrame(np.column_stack(side)).groupby(second) for side in (left, right)]
    strides = np.array([part.std(ddof=0).mean(axis=1) for part in parts], dtype=float)
    walking = strides.min(axis=0) > 0.3 * np.median(strides)
    turning, strides = turning[walking], strides[:, walking]
    if len(turning) < 4 or np.std(turning) < _CAN_TURN:
        return None
    more = np.log(strides[1] / strides[0])
    if abs(np.corrcoef(turning, more)[0, 1]) < _AGREE:
        return None
    return float(np.polyfit(turning, more, 1)[0])
