"""The attitudes of a reference against the gyro and gravity: which order, which frame, how late?"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from surefoot.sim.plausibility.axes import lag_of, match_axes

LATEST = 2.0
"""s up to which a late reference is looked for: `surefoot align` looks further."""
LATE = 0.02
"""s from which a late reference is said: at 1 m/s the body is 2 cm further, and clocks that were
set by hand or network are worse; an effect of timing below it is the trace's to find."""
_ALIKE = 0.6
"""Mean correlation of the three axes from which on gyro and reference belong together: 0.97 and
more in clean walks."""
_SAME_MOTION = 0.9
"""The same from which on a delay is one: strides resemble each other, so that a clock that is
further off, or axes that are others, correlate by up to 0.87 at a whole number of them."""
_CLEARLY = 0.02
"""By which a delay must better it."""
TILT = 45.0
"""deg between gravity and the reference's vertical: no mount is so wrong by accident."""
_UPRIGHT = 30.0
"""deg, of a reading that is to mend it."""

_NED = Rotation.from_matrix(np.diag([1.0, -1.0, -1.0]))
_Y_UP = Rotation.from_euler("x", 90, degrees=True)


@dataclass(frozen=True)
class Reading:
    """Another way to read a reference's attitudes: in words, and what it does to them."""

    words: str
    map_line: str
    read: Callable[[Rotation], Rotation]


def _rolled(R: Rotation) -> Rotation:
    # What stands as w, x, y, z was x, y, z, w.
    return Rotation.from_quat(R.as_quat(scalar_first=True))


OTHER_READINGS = (
    Reading(
        "the quaternion's order is x, y, z, w",
        "give ref_q_w their last number, ref_q_x their first",
        _rolled,
    ),
    Reading(
        "the quaternion turns the world to the body, not the body to the world",
        "ref_q_x, ref_q_y, ref_q_z = { ..., sign = -1 }",
        Rotation.inv,
    ),
    Reading(
        "the quaternion's order is x, y, z, w, and it turns the world to the body",
        "give ref_q_w their last number; ref_q_x, ref_q_y, ref_q_z = { ..., sign = -1 }",
        lambda R: _rolled(R).inv(),
    ),
    Reading(
        "world and body are north-east-down (z down)",
        "ref_q_y, ref_q_z, ref_p_y, ref_p_z = { ..., sign = -1 }",
        lambda R: _NED * R * _NED,
    ),
    Reading(
        "the world is north-east-down (z down)", "turn it by 180 deg about x", lambda R: _NED * R
    ),
    Reading(
        "the tracked body's axes are forward, right, down",
        "[reference] q_IM = [0, 1, 0, 0]",
        lambda R: R * _NED,
    ),
    Reading("the world's y is up", "turn it by 90 deg about x", lambda R: _Y_UP * R),
    Reading(
        "the world's z is down and y up", "turn it by -90 deg about x", lambda R: _Y_UP.inv() * R
    ),
)


@dataclass(frozen=True)
class AttitudeFault:
    """What is wrong with a reference's attitudes: the evidence, the cause in words, the map line,
    and how late [s] it is where that is the cause."""

    evidence: str
    cause: str
    map_line: str
    late: float = 0.0


def attitude_fault(
    begin: Rotation,
    end: Rotation,
    gyro: np.ndarray,
    force: np.ndarray,
    step: float,
    trusts_gyro: Callable[[np.ndarray], bool],
) -> AttitudeFault | None:
    """What is wrong with attitudes beside a gyro and the mean specific force; None where nothing
    is, or where the gyro is at fault.

    Args:
        begin: (M,) attitudes half a mean before each time.
        end: (M,) the same after it; both with a row every `step`.
        gyro: (M, 3) [rad/s].
        force: (3,) mean specific force [m/s^2] in I; zero where it is not to be trusted.
        step: s.
        trusts_gyro: whether the gyro as it is, rather than as it is given, fits all else.
    """

    def turned(read: Callable[[Rotation], Rotation]) -> np.ndarray:
        return (read(begin).inv() * read(end)).as_rotvec()

    def leaning(read: Callable[[Rotation], Rotation]) -> float:
        if not np.any(force):
            return 0.0
        up = read(begin).inv().apply([0.0, 0.0, 1.0]).mean(axis=0)
        size = max(float(np.linalg.norm(force) * np.linalg.norm(up)), 1e-9)
        return float(np.degrees(np.arccos(np.clip(force @ up / size, -1.0, 1.0))))

    as_is = turned(lambda R: R)
    match, lean = match_axes(gyro, as_is), leaning(lambda R: R)
    own = float(match.own.mean())
    late, shifted = lag_of(as_is, gyro, step, LATEST)
    if abs(late) > LATE and shifted > _SAME_MOTION and shifted > own + _CLEARLY and lean < TILT:
        which, how = ("after", "late") if late > 0 else ("before", "early")
        told = f"turns {abs(late):.2f} s {which} the gyro"
        line = f"[reference] offset = {-late:.3f}"
        return AttitudeFault(told, f"the reference's clock is {how}", line, late)
    if not match.wrong and own > 0.5 and lean < TILT:
        return None
    tried = [
        (float(match_axes(gyro, turned(r.read)).own.mean()), leaning(r.read), r)
        for r in OTHER_READINGS
    ]
    fitting = [one for one in tried if one[1] < _UPRIGHT and one[0] > _ALIKE]
    if not fitting:
        return None
    # Readings that turn alike differ in where they have gravity.
    best = max(fitting, key=lambda one: round(one[0], 2) - one[1] / 1e3)
    if lean < TILT:
        by_gyro = float(match.best.mean())
        if best[0] < max(own + 0.3, by_gyro - 0.05):
            return None
        put_right = np.empty_like(gyro)
        put_right[:, list(match.order)] = gyro * match.sign
        if match.wrong and not trusts_gyro(put_right):
            return None
    told = (
        f"correlation of its turning with the gyro {', '.join(f'{x:.2f}' for x in match.own)} "
        f"about x, y, z, its vertical {lean:.0f} deg from gravity"
    )
    return AttitudeFault(told, best[2].words, best[2].map_line)
