"""Check of a reference's attitudes against gyro and gravity: quaternion order, frame, delay."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from surefoot.sim.importing.advice import Changes, entries, quaternion
from surefoot.sim.importing.reference import REFERENCE_OFFSET
from surefoot.sim.plausibility.comparison import angle_between, match_axes, number_words
from surefoot.sim.plausibility.finding import Finding, plausibility_rule
from surefoot.sim.plausibility.limits import HARDLY, LATE, LATEST, LIKELY, SURELY
from surefoot.sim.plausibility.view import GYRO, MEAN, REF_P, REF_Q, LogView

_CLEARLY = 0.02
"""Least improvement of the correlation by a delay."""
TILT = 45.0
"""Angle between gravity and the reference's vertical that no mounting error explains [deg]."""
_UPRIGHT = 30.0
"""Largest such angle that an interpretation which corrects the reference leaves [deg]."""
_LAST_IS_W = {f"ref_q_{a}": f"ref_q_{b}" for a, b in zip("wxyz", "zwxy", strict=True)}
"""Column -> that which was taken for it, where w is the last number and was read as the first."""
_SAME_AXES = np.eye(3)
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


@plausibility_rule("reference's attitude", "t gyro ref", when="compares_turning")
def attitude(view: LogView) -> Iterator[Finding]:
    """Check that the reference rotates with the gyro, without a delay, and that gravity points
    down.

    Compares: the turning of ref_q with the gyro, its vertical with gravity, both as they are
        and under other readings (x, y, z, w; world to body; north-east-down; y up), and up to
        {LATEST:g} s late or early.
    Threshold: a reading that fits where ref_q as it is does not; {LATE:g} s late;
        a vertical that is far from gravity.
    Reason: clean walks correlate by 0.97 and more; at 1 m/s a body is 2 cm further after 0.02
        s.
    Remedy: the order or sign of ref_q's columns; [reference] offset; surefoot align.
    """
    as_is, lean = float(view.gyro_match.paired.mean()), _leaning(view)
    lag, shifted = view.delay(view.turning[view.ok], view.gyro[view.ok], LATE, LATEST)
    if shifted < max(SURELY, as_is + _CLEARLY):
        lag = 0.0
    if lean < TILT and (lag or (not view.gyro_match.wrong and as_is > HARDLY)):
        if lag:
            yield _late(view, lag)
        return
    reading = _other_reading(view, shifted if lag else as_is, lean)
    if reading is None:
        return
    numbers = number_words(view.gyro_match.paired)
    seen = f"correlation of its turning with the gyro {numbers} about x, y, z, "
    seen += f"its vertical {lean:.0f} deg from gravity"
    if lag and reading.of_world:
        world, clock = reading.changes["reference"], _on_time(view, lag)["reference"]
        cause = f"{reading.words}, and {_clock(lag)}"
        yield Finding((*REF_P, *REF_Q), seen, cause, {"reference": {**world, **clock}})
    else:
        yield Finding(REF_Q, seen, reading.words, reading.changes)


def _late(view: LogView, lag: float) -> Finding:
    """The finding for a reference that is late relative to the gyro [s]."""
    seen = f"turns {abs(lag):.2f} s {'after' if lag > 0 else 'before'} the gyro"
    by_force, alike = view.delay(view.accel[view.ok], view.felt[view.ok], LATE, LATEST)
    if alike > SURELY and abs(by_force) < 0.5 * abs(lag):
        seen = f"{seen}, and the accelerometer does not"
        return Finding(GYRO, seen, "a filter, or another clock, of the gyro alone")
    return Finding((*REF_P, *REF_Q), seen, _clock(lag), _on_time(view, lag))


def _clock(lag: float) -> str:
    return f"the reference's clock is {'late' if lag > 0 else 'early'}"


def _on_time(view: LogView, lag: float) -> Changes:
    offset = view.log.meta.model.get(REFERENCE_OFFSET, 0.0) - lag
    return {"reference": {"offset": round(offset, 3)}}


def _leaning(
    view: LogView, read: Callable[[Rotation], Rotation] = lambda R: R, axes: np.ndarray = _SAME_AXES
) -> float:
    """Angle between gravity and the vertical of a reference's attitudes as read [deg]; 0 where the
    accelerometer itself leans.

    `axes` (3, 3) turn vectors of the tracked body to the IMU's axes.
    """
    force = view.log.accel.mean(axis=0)
    if view.robot is not None and force @ view.robot.R_BI[2] < 0.5 * np.linalg.norm(force):
        return 0.0
    R_GI = read(view.attitudes(-0.5 * MEAN, view.ok))
    return angle_between(force @ axes, R_GI.inv().apply([0.0, 0.0, 1.0]).mean(axis=0))


def _other_reading(view: LogView, as_is: float, lean: float) -> Reading | None:
    """The reading of the attitudes that fits gyro and gravity best; None where none does, or where
    the gyro is at fault.

    Args:
        view: of the log.
        as_is: correlation of the reference's turning with the gyro.
        lean: angle of its vertical from gravity [deg].
    """
    gyro = view.gyro[view.ok]
    begin, end = (view.attitudes(after, view.ok) for after in (-0.5 * MEAN, 0.5 * MEAN))
    match, fitting = view.gyro_match, []
    for one in OTHER_READINGS:
        # A body turns alike in any world, also one whose axes are not yet those of the IMU.
        if one.of_world:
            fits, leans = max(as_is, match.best.mean()), _leaning(view, one.read, match.axes)
        else:
            turned = (one.read(begin).inv() * one.read(end)).as_rotvec()
            fits, leans = match_axes(gyro, turned).paired.mean(), _leaning(view, one.read)
        if leans < _UPRIGHT and fits > LIKELY:
            # Readings with the same rotation rate differ in the direction of gravity.
            fitting.append((round(fits, 2) - leans / 1e3, fits, one))
    if not fitting:
        return None
    _, fits, best = max(fitting, key=lambda one: one[0])
    if lean >= TILT:
        return best
    if fits < max(match.paired.mean() + 0.3, match.best.mean() - 0.05):
        return None
    return None if match.wrong and _gyro_at_fault(view) else best


def _gyro_at_fault(view: LogView) -> bool:
    """Whether the gyro fits less well as logged than with its axes put right by the reference.

    Judged by the legs or, where these show nothing, by whether the accelerometer agrees with the
    reference.
    """
    corrected = view.gyro @ view.gyro_match.axes
    if view.stance is not None:
        which = view.stance.which
        as_is, otherwise = (view.stance.turning_fits(x[which]) for x in (view.gyro, corrected))
        if max(as_is, otherwise) > 0.2:
            return as_is <= otherwise
    return not match_axes(view.accel[view.ok], view.felt[view.ok]).wrong
