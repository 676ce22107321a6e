"""Checks of a reference's attitudes against gyro and gravity: quaternion order, frame, delay."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from surefoot.sim.importing.advice import Changes, entries, quaternion
from surefoot.sim.plausibility.axes import (
    HARDLY,
    LIKELY,
    SURELY,
    angle_between,
    match_axes,
    number_words,
)

LATEST = 2.0
"""Largest delay of a reference that is searched for [s]; `surefoot align` searches further."""
LATE = 0.02
"""Delay of a reference that is reported [s]: at 1 m/s the body moves 2 cm in it, and clocks set by
hand or network are worse. `trace` finds smaller ones as an effect.
"""
_CLEARLY = 0.02
"""Least improvement of the correlation by a delay."""
TILT = 45.0
"""Angle between gravity and the reference's vertical that no mounting error explains [deg]."""
_UPRIGHT = 30.0
"""The same for an interpretation that corrects it [deg]."""

_LAST_IS_W = {f"ref_q_{a}": f"ref_q_{b}" for a, b in zip("wxyz", "zwxy", strict=True)}
"""Column -> that which was taken for it, where w is the last number and was read as the first."""
_NED = Rotation.from_matrix(np.diag([1.0, -1.0, -1.0]))
_Y_UP = Rotation.from_euler("x", 90, degrees=True)
_X_UP = Rotation.from_euler("y", -90, degrees=True)


@dataclass(frozen=True)
class Reading:
    """Another interpretation of a reference's attitudes.

    Attributes:
        words: its name.
        changes: of an import map that state it.
        read: function that converts the attitudes.
        of_world: whether they are of another world, in which the body turns alike.
    """

    words: str
    changes: Changes
    read: Callable[[Rotation], Rotation]
    of_world: bool = False


def _rolled(R: Rotation) -> Rotation:
    # The numbers read as w, x, y, z were x, y, z, w.
    return Rotation.from_quat(R.as_quat(scalar_first=True))


def _exchanged(columns: Mapping[str, str], inverse: bool = False) -> Changes:
    """Changes for columns that are in the place of others, of the inverse rotation."""
    signs = {n: {"sign": -1.0} if inverse and n != "ref_q_w" else {} for n in columns}
    return {"columns": {n: {"of": other} | signs[n] for n, other in columns.items()}}


def _of_world(words: str, R_GW: Rotation) -> Reading:
    return Reading(words, {"reference": {"q_GW": quaternion(R_GW)}}, lambda R: R_GW * R, True)


OTHER_READINGS = (
    Reading("the quaternion's order is x, y, z, w", _exchanged(_LAST_IS_W), _rolled),
    Reading(
        "the quaternion's order is w, x, y, z",
        _exchanged({other: n for n, other in _LAST_IS_W.items()}),
        lambda R: Rotation.from_quat(R.as_quat(), scalar_first=True),
    ),
    Reading(
        "the quaternion turns the world to the body, not the body to the world",
        entries(("ref_q_x", "ref_q_y", "ref_q_z"), sign=-1.0),
        Rotation.inv,
    ),
    Reading(
        "the quaternion's order is x, y, z, w, and it turns the world to the body",
        _exchanged(_LAST_IS_W, inverse=True),
        lambda R: _rolled(R).inv(),
    ),
    Reading(
        "world and body are north-east-down (z down)",
        entries(("ref_q_y", "ref_q_z", "ref_p_y", "ref_p_z"), sign=-1.0),
        lambda R: _NED * R * _NED,
    ),
    _of_world("the world is north-east-down (z down)", _NED),
    Reading(
        "the tracked body's axes are forward, right, down",
        {"reference": {"q_IM": quaternion(_NED)}},
        lambda R: R * _NED,
    ),
    Reading(
        "its heading turns clockwise",
        entries(("ref_yaw",), sign=-1.0),
        lambda R: Rotation.from_euler("ZYX", R.as_euler("ZYX") * [-1.0, 1.0, 1.0]),
    ),
    Reading(
        "roll and pitch are exchanged",
        _exchanged({"ref_roll": "ref_pitch", "ref_pitch": "ref_roll"}),
        lambda R: Rotation.from_euler("ZYX", R.as_euler("ZYX")[:, [0, 2, 1]]),
    ),
    _of_world("the world's y is up", _Y_UP),
    _of_world("the world's y is down", _Y_UP.inv()),
    _of_world("the world's x is up", _X_UP),
    _of_world("the world's x is down", _X_UP.inv()),
)


@dataclass(frozen=True)
class AttitudeFault:
    """Fault of a reference's attitudes.

    Attributes:
        evidence: what was measured.
        cause: in words.
        changes: of an import map that correct it.
        late: delay of the reference [s], where that is the cause.
    """

    evidence: str
    cause: str
    changes: Changes
    late: float = 0.0


def attitude_fault(
    begin: Rotation,
    end: Rotation,
    gyro: np.ndarray,
    force: np.ndarray,
    delay: tuple[float, float],
    trusts_gyro: Callable[[np.ndarray], bool],
) -> AttitudeFault | None:
    """Find what is wrong with attitudes, given a gyro and the mean specific force.

    None where nothing is, or where the gyro is at fault.

    Args:
        begin: attitudes (M,) half an averaging interval before each time.
        end: attitudes (M,) half an interval after it.
        gyro: (M, 3) [rad/s].
        force: (3,) mean specific force [m/s^2] in I; zero where it is unreliable.
        delay: of the reference [s], 0 if it may be none, and correlation of the turning at it.
        trusts_gyro: tells whether the gyro as logged agrees better with all else than the given
            corrected one.
    """

    def turned(read: Callable[[Rotation], Rotation]) -> np.ndarray:
        return (read(begin).inv() * read(end)).as_rotvec()

    def leaning(read: Callable[[Rotation], Rotation]) -> float:
        if not np.any(force):
            return 0.0
        up = read(begin).inv().apply([0.0, 0.0, 1.0]).mean(axis=0)
        return angle_between(force, up)

    as_is = turned(lambda R: R)
    match, lean = match_axes(gyro, as_is), leaning(lambda R: R)
    own = float(match.own.mean())
    late, shifted = delay
    if not (late and shifted > SURELY and shifted > own + _CLEARLY):
        late, shifted = 0.0, own
    which, how = ("after", "late") if late > 0 else ("before", "early")
    clock = f"the reference's clock is {how}"
    if late and lean < TILT:
        return AttitudeFault(f"turns {abs(late):.2f} s {which} the gyro", clock, {}, late)
    if not match.wrong and own > HARDLY and lean < TILT:
        return None
    tried = [
        # A body turns alike in any world.
        (shifted if r.of_world else float(match_axes(gyro, turned(r.read)).own.mean()),
         leaning(r.read), r)
        for r in OTHER_READINGS
    ]  # fmt: skip
    fitting = [one for one in tried if one[1] < _UPRIGHT and one[0] > LIKELY]
    if not fitting:
        return None
    # Interpretations with the same rotation rate differ in the direction of gravity.
    best = max(fitting, key=lambda one: round(one[0], 2) - one[1] / 1e3)
    if lean < TILT:
        by_gyro = float(match.best.mean())
        if best[0] < max(own + 0.3, by_gyro - 0.05):
            return None
        put_right = np.empty_like(gyro)
        put_right[:, list(match.order)] = gyro * match.sign
        if match.wrong and not trusts_gyro(put_right):
            return None
    seen = f"correlation of its turning with the gyro {number_words(match.own)} about x, y, z, "
    seen += f"its vertical {lean:.0f} deg from gravity"
    if late and best[2].of_world:
        return AttitudeFault(seen, f"{best[2].words}, and {clock}", best[2].changes, late)
    return AttitudeFault(seen, best[2].words, best[2].changes)
