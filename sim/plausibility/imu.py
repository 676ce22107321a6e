"""Checks of gyro and accelerometer: gravity, units, axes and signs."""

from collections.abc import Iterator
from itertools import permutations, product

import numpy as np
from scipy.spatial.transform import Rotation

from surefoot.sim.common.gravity import GRAVITY, GRAVITY_G
from surefoot.sim.importing.columns import UNITS
from surefoot.sim.plausibility.axes import (
    AXIS_NAMES,
    GAIN,
    OTHER,
    AxesMatch,
    lag_of,
    match_axes,
)
from surefoot.sim.plausibility.finding import Finding
from surefoot.sim.plausibility.noise import noise_of
from surefoot.sim.plausibility.place import SPEEDING, of_another_point, speed_changes
from surefoot.sim.plausibility.view import SHORTEST_LOG, STEP, LogView

ZERO_G = 0.8
"""Difference of an accelerometer's mean from gravity [m/s^2]: InvenSense MPU-6050 product
specification, zero-g output, +-80 mg on z; better sensors have a quarter of it.
"""
MOST_LEAN = 45.0
"""Angle between the mean specific force and up [deg]: stairs and ramps for legs lean by 35."""
LEANING = 0.75
"""Ratio of the mean specific force to gravity for a robot that turns on a slope of 35 deg, less
ZERO_G.
"""
ZERO_RATE = 0.35
"""Difference of a gyro's mean from the true rate [rad/s]: MPU-6050, zero-rate output, +-20
deg/s.
"""
TUMBLING = 6.0
"""RMS of a gyro [rad/s]: a turn per second for the whole log."""
GYRO_SCALED = 0.15
"""Relative scale error of a gyro or reference: data sheets allow 3 %, and averaging over a stride
costs a few percent.
"""
SCALED_ACCEL = 0.7
"""The same for accelerations, which impacts and filters distort more: 0.6 to 1.2 in clean walks."""
LEFT = 0.6
"""Share of the rotation that a gyro leaves unexplained as logged, and that other axes or signs may
leave; correlation alone hides axes with little motion. On clean walks and a measured Go1, none does
better than the right ones. Corrected, two swapped axes leave 0.15 on clean walks; on the Go1 0.52
to 0.56, but x for y 0.72, which is not detected.
"""
TURNED_IMU = 12.0
"""Rotation of an IMU's axes in the tracked body that is reported [deg]: brackets are accurate to
some degrees, and inclined ones are declared.
"""
STILL_LEFT = 0.5
"""Share of the difference between gyro and reference that may remain after such a rotation."""
WEAK = 0.3
"""Relative scale error of a single axis of a gyro that correlates well with the reference."""
_GOES_WELL = 0.9
"""Correlation from which single axes are compared in scale."""
LATE_ACCEL, LATEST_ACCEL = 0.03, 0.5
"""Smallest delay of an accelerometer that is reported, and largest that is searched for [s]."""
SHAKES = 0.05
"""Least standard deviation of the accelerations along axes that are compared [m/s^2]: 0.5 in walks;
0.01, of the order of noise, in turns on the spot.
"""
MISSED = 0.7
"""Error of an accelerometer's sum over SPEEDING seconds relative to the reference's changes of
velocity: 0.1 in simulated walks of any rate, 0.3 on a measured Go1, 0.6 on an iCub.
"""
IMPLIED = (0.55, 1.25)
"""That error relative to what independent samples of what is between rows would cause: 0.6 to 1 in
walks of 5 to 100 Hz, 0.4 at most of averages.
"""
QUIET = 0.35
"""Least size of an accelerometer's signal relative to the motion's: 0.6 in clean walks."""
SAME_SIZE = 1e-3
"""Least relative variation of the magnitude of a specific force; impacts reach several times
gravity.
"""
NOT_LEVEL = 8.0
"""Angle between gravity and the reference's vertical [deg]; an accelerometer 80 mg off causes 5."""
NOISY = 0.2
"""Noise of a gyro between rows [rad/s]: data sheets have 0.01 (MPU-6050, 0.05 deg/s behind a
filter, 0.005 deg/s/√Hz), logs of a Go1 and a SCALER 0.03 including vibration.
"""
NOISY_ACCEL = 2.0
"""The same of an accelerometer [m/s^2]: data sheets have 0.06 (MPU-6050, 400 ug/sqrt(Hz), over
250 Hz), logs of a Go1, a SCALER and an iCub 0.3 to 0.6 including vibration.
"""
_BLOCK = 2.0
"""Averaging time of a gyro's bias [s], four strides."""
_AXES_P = tuple(f"ref_p_{a}" for a in AXIS_NAMES)
_AXES_GYRO = tuple(f"gyro_{a}" for a in AXIS_NAMES)
_AXES_ACCEL = tuple(f"accel_{a}" for a in AXIS_NAMES)
_DEGREE = 180.0 / np.pi
_UNITS_OF_ACCEL = {
    "g": 1.0,
    "ft/s^2": GRAVITY / 0.3048,
    "cm/s^2": 1e2 * GRAVITY,
    "mg": 1e3,
    "mm/s^2": 1e3 * GRAVITY,
}
"""Gravity in other units."""
_UNITS_OF_GYRO = {
    "deg/s": _DEGREE,
    "rpm": 60.0 / (2.0 * np.pi),
    "mrad/s": 1e3,
    "turns/s": 0.5 / np.pi,
}
"""1 rad/s in other units."""


def gravity(view: LogView) -> Iterator[Finding]:
    """Check that the mean specific force of a body that stays near the ground is gravity,
    upwards.
    """
    if not view.log.has("imu") or not view.comparable:
        return
    mean = view.log.accel.mean(axis=0)
    size = float(np.linalg.norm(mean))
    up, whose = _up(view)
    told = f"mean ({_numbers(mean)}) m/s^2, {size:.3g} in size where gravity is {GRAVITY}"
    sizes, spread = np.linalg.norm(view.log.accel, axis=1), view.log.accel.std(axis=0).max()
    unit = _unit_of_accel(size, float(spread))
    if unit is None and sizes.std() < SAME_SIZE * size < 0.1 * spread:
        unit = "a direction: its size is the same in every row", ""
    if unit is not None:
        cause, line = unit
        yield Finding(_AXES_ACCEL, told, cause, line)
        return
    if up is None:
        if not LEANING * GRAVITY < size < GRAVITY + ZERO_G:
            yield Finding(_AXES_ACCEL, told, "scaled, or a bias")
        return
    lean = float(np.degrees(np.arccos(np.clip(mean @ up / max(size, 1e-9), -1.0, 1.0))))
    if lean > MOST_LEAN:
        told = f"{told}, {lean:.0f} deg from up by {whose}"
        turned = _imu_turned(view)
        if turned is not None:
            yield turned
            return
        yield _turned_over(view, mean, up, told)
    elif not LEANING * GRAVITY < size < GRAVITY + ZERO_G:
        yield Finding(_AXES_ACCEL, told, f"scaled by {size / GRAVITY:.3g}, or a bias")


def _unit_of_accel(size: float, spread: float) -> tuple[str, str] | None:
    """Cause and map line where the magnitude is gravity in another unit."""
    unit, one = min(_UNITS_OF_ACCEL.items(), key=lambda one: abs(np.log(max(size, 1e-9) / one[1])))
    if abs(np.log(max(size, 1e-9) / one)) < np.log(1.3 if unit == "g" else 1.1):
        known = unit in UNITS["accel"]
        line = f'accel_x, accel_y, accel_z = {{ ..., unit = "{unit}" }}' if known else ""
        return f"in {unit}, not m/s^2", line
    if 0.8 < size / GRAVITY**2 < 1.2:
        return "multiplied by gravity twice", ""
    if size < 0.2 * GRAVITY and spread > 0.0:
        return (
            "gravity was taken off: an acceleration, not the specific force that filters need",
            "",
        )
    return None


def _turned_over(view: LogView, mean: np.ndarray, up: np.ndarray, told: str) -> Finding:
    """Explain why the mean specific force does not point up."""
    axis = int(np.argmax(np.abs(up)))
    found = int(np.argmax(np.abs(mean)))
    if found != axis:
        cause = f"swapped axes: gravity is on {AXIS_NAMES[found]}, up is {AXIS_NAMES[axis]}"
        return Finding((f"accel_{AXIS_NAMES[axis]}", f"accel_{AXIS_NAMES[found]}"), told, cause)
    column = f"accel_{AXIS_NAMES[axis]}"
    moved = (
        match_axes(view.accel[view.ok], view.felt[view.ok]).own if view.trusts_reference else None
    )
    if moved is not None and moved[axis] > 0.5:
        shift = round(2.0 * np.sign(up[axis]) * GRAVITY, 2)
        cause = "gravity has the wrong sign, the motion the right one"
        return Finding((column,), told, cause, f"{column} = {{ ..., offset = {shift} }}")
    flipped = [f"accel_{AXIS_NAMES[i]}" for i in range(3) if moved is not None and moved[i] < -0.5]
    columns = tuple(flipped) or (column,)
    if moved is None:
        shift = round(2.0 * np.sign(up[axis]) * GRAVITY, 2)
        line = f"{column} = {{ ..., sign = -1 }}, or offset = {shift} where only gravity is wrong"
        return Finding(columns, told, "wrong sign, of the axis or of gravity alone", line)
    cause = "wrong sign" + (
        ": gravity was logged for specific force" if len(columns) == 3 else " (z down?)"
    )
    return Finding(columns, told, cause, f"{', '.join(columns)} = {{ ..., sign = -1 }}")


def _up(view: LogView) -> tuple[np.ndarray | None, str]:
    """Up in I (3,), and its source: the body, else the reference."""
    if view.up_by_body is not None:
        return view.up_by_body, "the body"
    if view.log.has("reference"):
        up = view.R_GI.inv().apply([0.0, 0.0, 1.0]).mean(axis=0)
        return up / max(float(np.linalg.norm(up)), 1e-9), "the reference"
    return None, ""


def accelerometer(view: LogView) -> Iterator[Finding]:
    """Check that the specific force agrees with the motion of the reference."""
    if not (view.trusts_reference and view.resolves):
        return
    accel, felt = view.accel[view.ok], view.felt[view.ok]
    in_body = match_axes(accel, felt)
    late, shifted = lag_of(accel, felt, STEP, LATEST_ACCEL)
    # Motion is periodic: half a stride later, a swaying axis is its own negative.
    in_world = match_axes(view.ref_a[view.ok], view.R_GI.apply(view.accel)[view.ok] + GRAVITY_G)
    fits = max(in_body.own.mean() + 0.1, in_body.best.mean(), in_world.best.mean())
    delayed = abs(late) > view.least_lag(LATE_ACCEL) and shifted > max(0.6, fits)
    if delayed and not of_another_point(view):
        told = f"{abs(late):.2f} s {'late' if late > 0 else 'early'} against the reference's motion"
        cause = "another clock, or a filter, of the accelerometer or of ref_p"
        yield Finding((*_AXES_ACCEL, *_AXES_P), told, cause)
        return
    as_world = match_axes(accel, view.ref_a[view.ok] - GRAVITY_G).own[:2]
    if as_world.min() > OTHER and (as_world - in_body.own[:2]).mean() > 0.5 * GAIN:
        told = f"correlation with the reference's accelerations in G {_numbers(as_world)}"
        yield Finding(_AXES_ACCEL, told, "in the world's axes, not the body's")
        return
    size = float(np.sqrt(np.sum(accel.var(axis=0)) / max(np.sum(felt.var(axis=0)), 1e-12)))
    if size < QUIET:
        told = f"has {size:.2f} of the accelerations of the reference's motion"
        yield Finding(_AXES_ACCEL, told, "filtered, or gravity alone")
        return
    # If gravity shows that the IMU's z is upright, the reference's is at fault.
    if _shakes(view, in_world) and (
        in_world.best.mean() >= in_body.best.mean() or in_world.wrong == (2,)
    ):
        columns = tuple(f"ref_p_{AXIS_NAMES[i]}" for i in in_world.wrong)
        told = f"correlation with the accelerometer {_of(in_world, in_world.own)}"
        down = "z is down (north-east-down): " if in_world.sign[2] < 0 else ""
        lines = _lines("ref_p", in_world)
        yield Finding(columns, told, f"{down}{in_world.words}", lines)
    elif _shakes(view, in_body):
        columns = tuple(_AXES_ACCEL[i] for i in in_body.wrong)
        told = f"correlation with the reference's motion {_of(in_body, in_body.own)}"
        yield Finding(columns, told, in_body.words, _lines("accel", in_body))
    elif abs(np.log(in_world.scaled)) > np.log1p(SCALED_ACCEL):
        told = f"accelerates {in_world.scaled:.3g} times as fast as the accelerometer"
        cause = "scaled, another unit, or stamps at a wrong rate"
        yield Finding(_AXES_P, told, cause)
    else:
        apart = accel.mean(axis=0) - felt.mean(axis=0)
        R_GI = view.attitudes(0.0, view.ok)
        up = R_GI.apply(accel - felt).mean(axis=0) - GRAVITY_G
        aside = up[:2]
        lean = float(np.degrees(np.arctan2(np.linalg.norm(aside), GRAVITY)))
        if lean > NOT_LEVEL and np.linalg.norm(aside) > 1.05 * np.linalg.norm(apart):
            told = f"its vertical is {lean:.0f} deg from gravity, whichever way the body turns"
            cause = "the reference's world is not level"
            level = Rotation.align_vectors([[0.0, 0.0, 1.0]], [up])[0]
            yield Finding((*_AXES_P, "ref_q"), told, cause, _turned_line("q_GW", level))
            return
        for i in np.flatnonzero(np.abs(apart) > ZERO_G):
            told = f"mean {apart[i]:.2f} m/s^2 off what the reference's motion implies"
            cause = "a bias, or a leaning mount"
            yield Finding((_AXES_ACCEL[i],), told, cause)


def sampled(view: LogView) -> Iterator[Finding]:
    """Check that an IMU's rows are averages: summed over time they give the change of velocity.

    What shakes a body between samples makes the sum a random walk, as large as the steps from row
    to row imply.
    """
    if not view.trusts_reference:
        return
    by_imu, by_reference = speed_changes(view)
    if len(by_imu) * STEP < SHORTEST_LOG:
        return
    missed, changed = (
        float(np.sqrt(np.sum(x.var(axis=0)))) for x in (by_imu - by_reference, by_reference)
    )
    accel = view.log.accel
    bend = accel[1:-1] - 0.5 * (accel[2:] + accel[:-2])
    # White noise has a bend of 1.5 times its variance.
    implied = np.sqrt(np.sum(np.mean(bend**2, axis=0)) / 1.5 * view.step * SPEEDING)
    if missed > MISSED * changed and IMPLIED[0] < missed / max(implied, 1e-12) < IMPLIED[1]:
        told = (
            f"summed over {SPEEDING:g} s, it is {missed:.2f} m/s off changes of {changed:.2f} m/s"
        )
        cause = "sampled at the rows, not averaged over them; log faster, or log averages"
        yield Finding((*_AXES_GYRO, *_AXES_ACCEL), told, cause)


def _shakes(view: LogView, match: AxesMatch) -> bool:
    """Whether a match has wrong axes, and the reference shakes along these."""
    shaken = np.minimum(view.ref_a[view.ok].std(axis=0), view.felt[view.ok].std(axis=0))
    return bool(match.wrong) and float(shaken[list(match.wrong)].min()) > SHAKES


def gyro_unit(view: LogView) -> Iterator[Finding]:
    """Check that a gyro measures something, in rad/s."""
    if not view.log.has("imu") or not view.comparable:
        return
    rms = float(np.sqrt(np.mean(np.sum(view.log.gyro**2, axis=1))))
    if rms == 0.0:
        told, cause = "0 rad/s in every row", "not connected, or not logged"
        yield Finding(_AXES_GYRO, told, cause)
    elif rms > TUMBLING:
        told = f"root mean square {rms:.3g} rad/s"
        mean, other = (x.mean(axis=0) for x in (view.log.gyro, view.log.accel))
        if abs(np.linalg.norm(mean) / GRAVITY - 1.0) < 0.1 and np.linalg.norm(other) < rms / 3.0:
            columns = (*_AXES_GYRO, *_AXES_ACCEL)
            yield Finding(columns, f"{told}, gravity in its mean", "gyro and accelerometer swapped")
            return
        factor = _DEGREE
        if view.compares_turning and view.gyro_match.alike:
            factor = view.gyro_match.scaled
            told += f", {factor:.3g} times as fast as the reference turns"
        yield Finding(_AXES_GYRO, told, *_scaled_gyro(factor))


def _scaled_gyro(factor: float) -> tuple[str, str]:
    """Cause and map line for a gyro with `factor` times the true rate."""
    unit, one = min(_UNITS_OF_GYRO.items(), key=lambda one: abs(np.log(factor / one[1])))
    if abs(factor / one - 1.0) > 0.2:
        return "scaled", ""
    known = unit in UNITS["gyro"]
    line = f'gyro_x, gyro_y, gyro_z = {{ ..., unit = "{unit}" }}' if known else ""
    return f"in {unit}, not rad/s", line


def gyro(view: LogView) -> Iterator[Finding]:
    """Check that a gyro measures the rotation of the reference."""
    if not view.compares_turning:
        return
    match = view.gyro_match
    turned = _imu_turned(view)
    if turned is not None:
        yield turned
        return
    if match.wrong:
        columns = tuple(_AXES_GYRO[i] for i in match.wrong)
        told = f"correlation with the reference's turning {_of(match, match.own)}"
        yield Finding(columns, told, match.words, _lines("gyro", match))
        return
    if not match.alike:
        if not view.resolves:
            return
        told = f"correlation of turning {_numbers(match.own)} about x, y, z"
        cause = "another body, other axes or another clock; try surefoot align"
        yield Finding((*_AXES_GYRO, "ref_q"), told, cause)
        return
    factor = match.scaled
    weak = np.flatnonzero(
        (match.best > _GOES_WELL) & (np.abs(np.log(match.scale)) > np.log1p(WEAK))
    )
    if len(weak) == 1:
        told = f"{match.scale[weak[0]]:.3g} times as fast as the reference turns, unlike the others"
        yield Finding((_AXES_GYRO[weak[0]],), told, "scaled")
    elif abs(factor - 1.0) > GYRO_SCALED:
        told = f"{factor:.3g} times as fast as the reference turns"
        yield Finding(_AXES_GYRO, told, *_scaled_gyro(factor))
    off = (view.gyro - view.turning)[view.ok]
    blocks = np.array_split(off, max(1, round(len(off) * STEP / _BLOCK)))
    apart, means = off.mean(axis=0), np.array([one.mean(axis=0) for one in blocks])
    worst = np.quantile(np.abs(means), 0.9, axis=0)
    for i in np.flatnonzero(np.maximum(np.abs(apart), worst) > ZERO_RATE):
        told = f"mean {apart[i]:.2f} rad/s off the reference's turning"
        if abs(apart[i]) < ZERO_RATE:
            told = f"up to {worst[i]:.2f} rad/s off the reference's turning for {_BLOCK:g} s"
        yield Finding((_AXES_GYRO[i],), told, "a bias")


def gyro_noise(view: LogView) -> Iterator[Finding]:
    """Check the noise of a gyro, from third differences, which hold little of a body's smooth
    rotation.
    """
    if view.log.has("imu") and view.comparable and view.resolves:
        yield from noise_of(view.log.gyro, _AXES_GYRO, NOISY, "rad/s")


def accel_noise(view: LogView) -> Iterator[Finding]:
    """Check the noise of an accelerometer, in the same way."""
    if view.log.has("imu") and view.comparable and view.resolves:
        yield from noise_of(view.log.accel, _AXES_ACCEL, NOISY_ACCEL, "m/s^2")


def _imu_turned(view: LogView) -> Finding | None:
    """Find an IMU whose gyro and accelerometer are turned alike relative to the reference.

    None where there is none, and where one of the two is turned alone.
    """
    if not view.compares_turning:
        return None
    axes = _axes_of_imu(view)
    if axes is None:
        return None
    columns = (*_AXES_GYRO, *_AXES_ACCEL)
    turned = Rotation.from_matrix(axes).as_rotvec(degrees=True) if np.linalg.det(axes) > 0 else None
    words = "mirrored" if turned is None else f"by {_numbers(turned)} deg about x, y, z"
    whole = np.array_equal(axes, np.round(axes))
    if turned is not None and not _in_body(view, axes):
        told = f"{words}, from the tracked body's axes, as turning and motion say"
        line = _turned_line("q_IM", Rotation.from_matrix(axes))
        return Finding(columns, told, "the tracked body is turned against the IMU", line)
    told = f"{words}, from the reference's axes, as turning and motion say"
    if whole:
        match = AxesMatch.of(axes)
        line = "; ".join(_lines(kind, match) for kind in ("gyro", "accel"))
        return Finding(columns, told, f"the IMU is turned in the body: {match.words}", line)
    line = "[robot] imu_orientation, with [reference] q_IM; surefoot align finds it"
    return Finding(columns, told, "the IMU is turned in the body", line)


def _axes_of_imu(view: LogView) -> np.ndarray | None:
    """Orthogonal matrix (3, 3) from the reference's axes to those of gyro and accelerometer.

    The rotation by Kabsch's method, or a mirror image along the axes. Whole numbers where it is
    near to them, and None where it is small or does not fit both.
    """
    gyro, turning = view.gyro[view.ok], view.turning[view.ok]
    a, b = gyro - gyro.mean(axis=0), turning - turning.mean(axis=0)
    found = Rotation.align_vectors(a, b)[0].as_matrix()
    match = view.gyro_match
    mirrored = np.zeros((3, 3))
    mirrored[range(3), match.order] = match.sign
    if np.linalg.det(mirrored) < 0 and len(match.wrong) and match.best.min() > OTHER:
        found = mirrored
    if np.abs(found - np.round(found)).max() < np.sin(np.radians(TURNED_IMU)):
        found = np.round(found) + 0.0
    accel, felt = view.accel[view.ok], view.felt[view.ok]
    pairs = ((a, b), (accel, felt))
    mends = all(
        np.sum((x - y @ found.T) ** 2) < STILL_LEFT * np.sum((x - y) ** 2) for x, y in pairs
    )
    return found if mends and not np.array_equal(found, np.eye(3)) else None


def _in_body(view: LogView, axes: np.ndarray) -> bool:
    """Whether an IMU that is turned from the reference's axes is so in the body, too.

    By up in the body or, where that is on the axis of the turn, by the feet.
    """
    up, mean = view.up_by_body, view.log.accel.mean(axis=0)
    if up is not None:
        as_is, put_right = (float(x @ up) / np.linalg.norm(mean) for x in (mean, mean @ axes))
        if abs(as_is - put_right) > 1.0 - np.cos(np.radians(TURNED_IMU)):
            return put_right > as_is
    if view.stance is None:
        return False
    gyro = view.gyro[view.stance.which]
    return view.stance.turning_fits(gyro @ axes) > view.stance.turning_fits(gyro)


def turning_of_legs(view: LogView) -> Iterator[Finding]:
    """Check a gyro without a reference, by the rotation of lines between standing feet."""
    legs = view.stance
    if legs is None or not view.log.has("imu") or view.log.has("reference"):
        return
    gyro = view.gyro[legs.which]
    as_is = legs.turning_fits(gyro)
    best = (as_is, (0, 1, 2), (1.0, 1.0, 1.0))
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            other = np.empty_like(gyro)
            other[:, list(order)] = gyro * np.array(signs)
            best = max(best, (legs.turning_fits(other), order, signs))
    fits, order, signs = best
    if 1.0 - fits**2 > LEFT * (1.0 - max(as_is, 0.0) ** 2):
        return
    wrong = [i for i in range(3) if order[i] != i or signs[i] < 0]
    columns = tuple(_AXES_GYRO[i] for i in wrong)
    words = ", ".join(
        f"{AXIS_NAMES[i]} is {'-' * (signs[i] < 0)}{AXIS_NAMES[order[i]]}" for i in wrong
    )
    told = f"correlation with the turning that standing feet see {as_is:.2f}, put right {fits:.2f}"
    yield Finding(columns, told, words)


def _of(match: AxesMatch, values: np.ndarray) -> str:
    return ", ".join(f"{AXIS_NAMES[i]} {values[i]:.2f}" for i in match.wrong)


def _lines(kind: str, match: AxesMatch) -> str:
    """Map lines that correct each wrong axis."""
    lines = []
    for i in match.wrong:
        sign = ", sign = -1" if match.sign[i] < 0 else ""
        column = f"their column of {kind}_{AXIS_NAMES[i]}"
        lines.append(f"{kind}_{AXIS_NAMES[match.order[i]]} = {{ column = <{column}>{sign} }}")
    return "; ".join(lines)


def _turned_line(key: str, rotation: Rotation) -> str:
    """Map line for a rotation of a reference."""
    q = rotation.as_quat(canonical=True, scalar_first=True)
    return f"[reference] {key} = [{', '.join(f'{x:.6f}' for x in q + 0.0)}]"


def _numbers(values: np.ndarray) -> str:
    return ", ".join(f"{x:.2f}" for x in values)
