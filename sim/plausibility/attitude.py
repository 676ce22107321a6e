"""Check of a reference's attitudes against gyro and gravity: quaternion order, frame, delay."""

from collections.abc import Callable, Iterator, Mapping

import numpy as np
from scipy.spatial.transform import Rotation

from surefoot.sim.common.gravity import GRAVITY_G
from surefoot.sim.importing.advice import Changes, entries, quaternion
from surefoot.sim.importing.reference import REFERENCE_OFFSET
from surefoot.sim.plausibility.comparison import angle_between, match_axes, number_words
from surefoot.sim.plausibility.finding import Finding, plausibility_rule
from surefoot.sim.plausibility.limits import HARDLY, LATE, LATEST, LIKELY, SURELY
from surefoot.sim.plausibility.view import GYRO, MEAN, REF_P, REF_Q, LogView

_CLEARLY = 0.02
"""Least improvement of the correlation by a delay."""
NOT_LEVEL = 8.0
"""Angle between gravity and the reference's vertical [deg]; an accelerometer 80 mg off causes 5."""
TILT = 45.0
"""Such an angle that no mounting error explains [deg]."""
_UPRIGHT = 30.0
"""Largest such angle that an interpretation which corrects the reference leaves [deg]."""
_LAST_IS_W = {f"ref_q_{a}": f"ref_q_{b}" for a, b in zip("wxyz", "zwxy", strict=True)}
"""Column -> that which was taken for it, where w is the last number and was read as the first."""
_Z = np.array([0.0, 0.0, 1.0])
_SAME_AXES = np.eye(3)
_NED = Rotation.from_matrix(np.diag([1.0, -1.0, -1.0]))
_Read = Callable[[Rotation], Rotation]


def _rolled(R: Rotation) -> Rotation:
    # The numbers read as w, x, y, z were x, y, z, w.
    return Rotation.from_quat(R.as_quat(scalar_first=True))


def _exchanged(columns: Mapping[str, str], inverse: bool = False) -> Changes:
    """Changes for columns that are in the place of others, of the inverse rotation."""
    signs = {n: {"sign": -1.0} if inverse and n != "ref_q_w" else {} for n in columns}
    return {"columns": {n: {"of": other} | signs[n] for n, other in columns.items()}}


OTHER_READINGS: tuple[tuple[str, Changes, _Read], ...] = (
    ("the quaternion's order is x, y, z, w", _exchanged(_LAST_IS_W), _rolled),
    (
        "the quaternion's order is w, x, y, z",
        _exchanged({other: n for n, other in _LAST_IS_W.items()}),
        lambda R: Rotation.from_quat(R.as_quat(), scalar_first=True),
    ),
    (
        "the quaternion turns the world to the body, not the body to the world",
        entries(("ref_q_x", "ref_q_y", "ref_q_z"), sign=-1.0),
        Rotation.inv,
    ),
    (
        "the quaternion's order is x, y, z, w, and it turns the world to the body",
        _exchanged(_LAST_IS_W, inverse=True),
        lambda R: _rolled(R).inv(),
    ),
    (
        "world and body are north-east-down (z down)",
        entries(("ref_q_y", "ref_q_z", "ref_p_y", "ref_p_z"), sign=-1.0),
        lambda R: _NED * R * _NED,
    ),
    (
        "the tracked body's axes are forward, right, down",
        {"reference": {"q_IM": quaternion(_NED)}},
        lambda R: R * _NED,
    ),
    (
        "its heading turns clockwise",
        entries(("ref_yaw",), sign=-1.0),
        lambda R: Rotation.from_euler("ZYX", R.as_euler("ZYX") * [-1.0, 1.0, 1.0]),
    ),
    (
        "roll and pitch are exchanged",
        _exchanged({"ref_roll": "ref_pitch", "ref_pitch": "ref_roll"}),
        lambda R: Rotation.from_euler("ZYX", R.as_euler("ZYX")[:, [0, 2, 1]]),
    ),
)
"""Other interpretations of a reference's attitudes: in words, the change of a map, and how they are
converted.
"""


@plausibility_rule("reference's attitude", "t gyro ref", when="compares_turning")
def attitude(view: LogView) -> Iterator[Finding]:
    """Check that the reference rotates with the gyro, without a delay, and that gravity points
    down.

    Compares: the turning of ref_q with the gyro, its vertical with gravity, both as they are
        and under other readings (x, y, z, w; world to body; north-east-down; heading clockwise),
        and up to {LATEST:g} s late or early.
    Threshold: a reading that fits where ref_q as it is does not; {LATE:g} s late;
        a vertical that is {NOT_LEVEL:g}° from gravity whichever way the body turns, or along
        another axis.
    Reason: clean walks correlate by 0.97 and more; at 1 m/s a body is 2 cm further after 0.02
        s; an accelerometer 80 mg off leans by 5°.
    Remedy: the order or sign of ref_q's columns; [reference] q_GW, q_IM or offset; surefoot align.
    """
    match = view.gyro_match
    as_is = float(match.paired.mean())
    lag, shifted = view.delay(view.turning[view.ok], view.gyro[view.ok], LATE, LATEST)
    if shifted < max(SURELY, as_is + _CLEARLY):
        lag = 0.0
    if lag or (not match.wrong and as_is > HARDLY):
        level = _levelled(view)
        if level is not None:
            yield _not_level(view, *level, lag)
        elif lag:
            yield _late(view, lag)
        return
    found = _other_reading(view)
    if found is not None:
        words, changes = found
        numbers = number_words(match.paired)
        seen = f"correlation of its turning with the gyro {numbers} about x, y, z"
        yield Finding(REF_Q, seen, words, changes)
    elif match.best.mean() > LIKELY and not _gyro_at_fault(view):
        # A body turns alike in any world, also one whose axes are not yet those of the IMU.
        level = _levelled(view, match.axes)
        if level is not None:
            yield _not_level(view, *level)


def _not_level(view: LogView, up: np.ndarray, R_GW: Rotation, lag: float = 0.0) -> Finding:
    """The finding for a world in which up is (3,), and that R_GW turns to z up."""
    seen = f"its vertical is {angle_between(up, _Z):.0f} deg from gravity"
    cause = f"the reference's world is not level: up is ({number_words(up)}) in it"
    changes = {"q_GW": quaternion(R_GW)}
    if lag:
        cause, changes = f"{cause}; {_clock(lag)}", changes | _on_time(view, lag)
    return Finding((*REF_P, *REF_Q), seen, cause, {"reference": changes})


def _levelled(view: LogView, axes: np.ndarray = _SAME_AXES) -> tuple[np.ndarray, Rotation] | None:
    """Up (3,) in the reference's world, by the specific force, and the rotation from this world to
    one with z up, by whole right angles where these nearly do. None where it is level, or where it
    is the body in which the force leans.

    `axes` (3, 3) turn vectors of the tracked body to the IMU's axes.
    """
    mean = view.log.accel.mean(axis=0)
    if view.robot is not None and mean @ view.robot.R_BI[2] < 0.5 * np.linalg.norm(mean):
        return None
    R_GI, accel = view.attitudes(0.0, view.ok), view.accel[view.ok] @ axes
    up = R_GI.apply(accel).mean(axis=0)
    apart = np.linalg.norm((accel - R_GI.inv().apply(-GRAVITY_G)).mean(axis=0))
    in_world = np.linalg.norm(up[:2]) > 1.05 * apart
    lean, up = angle_between(up, _Z), up / max(float(np.linalg.norm(up)), 1e-9)
    R_GW = _NED if lean > 180.0 - _UPRIGHT else Rotation.align_vectors([_Z], [up])[0]
    if lean > TILT and np.abs(up).max() > np.cos(np.radians(_UPRIGHT)):
        return up, Rotation.from_matrix(np.round(R_GW.as_matrix()))
    return (up, R_GW) if in_world and lean > NOT_LEVEL else None


def _late(view: LogView, lag: float) -> Finding:
    """The finding for a reference that is late relative to the gyro [s]."""
    seen = f"turns {abs(lag):.2f} s {'after' if lag > 0 else 'before'} the gyro"
    by_force, alike = view.delay(view.accel[view.ok], view.felt[view.ok], LATE, LATEST)
    if alike > SURELY and abs(by_force) < 0.5 * abs(lag):
        seen = f"{seen}, and the accelerometer does not"
        return Finding(GYRO, seen, "a filter, or another clock, of the gyro alone")
    return Finding((*REF_P, *REF_Q), seen, _clock(lag), {"reference": _on_time(view, lag)})


def _clock(lag: float) -> str:
    return f"the reference's clock is {'late' if lag > 0 else 'early'}"


def _on_time(view: LogView, lag: float) -> dict[str, float]:
    offset = view.log.meta.model.get(REFERENCE_OFFSET, 0.0) - lag
    return {"offset": round(offset, 3)}


def _other_reading(view: LogView) -> tuple[str, Changes] | None:
    """The reading of the attitudes that fits gyro and gravity best, in words, and its changes; None
    where none does, or where the gyro is at fault.
    """
    gyro, force = view.gyro[view.ok], view.log.accel.mean(axis=0)
    begin, end = (view.attitudes(after, view.ok) for after in (-0.5 * MEAN, 0.5 * MEAN))
    fitting = []
    for words, changes, read in OTHER_READINGS:
        R_GI = read(begin)
        fits = float(match_axes(gyro, (R_GI.inv() * read(end)).as_rotvec()).paired.mean())
        leans = angle_between(force, R_GI.inv().apply(_Z).mean(axis=0))
        if leans < _UPRIGHT and fits > LIKELY:
            # Readings with the same rotation rate differ in the direction of gravity.
            fitting.append((round(fits, 2) - leans / 1e3, fits, words, changes))
    if not fitting:
        return None
    _, fits, words, changes = max(fitting, key=lambda one: one[0])
    match = view.gyro_match
    if fits < max(match.paired.mean() + 0.3, match.best.mean() - 0.05):
        return None
    return None if match.wrong and _gyro_at_fault(view) else (words, changes)


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
