"""Checks of gyro and accelerometer: gravity, units, axes and signs."""

from collections.abc import Iterator
from itertools import permutations, product

import numpy as np
from scipy.spatial.transform import Rotation

from surefoot.sim.common.gravity import GRAVITY, GRAVITY_G
from surefoot.sim.importing.advice import entries, quaternion
from surefoot.sim.plausibility.comparison import (
    AxesMatch,
    angle_between,
    in_another_unit,
    match_axes,
    number_words,
    of_scale,
)
from surefoot.sim.plausibility.finding import Finding, plausibility_rule
from surefoot.sim.plausibility.limits import FEWEST, HARDLY, LATE_STREAM, LIKELY, MENDED
from surefoot.sim.plausibility.reference import SPEEDING, other_point, speed_changes
from surefoot.sim.plausibility.view import ACCEL, GYRO, REF_P, STEP, LogView

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
TURNED_IMU = 12.0
"""Rotation of an IMU's axes in the tracked body that is reported [deg]: brackets are accurate to
some degrees, and inclined ones are declared.
"""
LATEST_ACCEL = 0.5
"""Largest delay of an accelerometer that is searched for [s]."""
SHAKES = 0.05
"""Least standard deviation of the accelerations along axes that are compared [m/s^2]: 0.5 in walks;
0.01, of the order of noise, in turns on the spot.
"""
SUM_OFF = 0.7
"""Error of an accelerometer's sum over SPEEDING seconds relative to the reference's changes of
velocity: 0.1 in simulated walks of any rate, 0.3 on a measured Go1, 0.6 on an iCub.
"""
IMPLIED = (0.55, 1.25)
"""Range of the error of the sum, relative to the error that independent samples at the rows would
cause, in which rows are samples: 0.6 to 1 in walks sampled at 5 to 100 Hz, at most 0.4 where rows
are averages.
"""
QUIET = 0.35
"""Least size of an accelerometer's signal relative to the motion's: 0.6 in clean walks."""
SAME_SIZE = 1e-3
"""Least relative variation of the magnitude of a specific force; impacts reach several times
gravity.
"""
_IN_WORLD = 0.2
"""Least excess of the correlation with accelerations in the world over that in the body [-]: half
of what axes have in common with each other.
"""
_BLOCK = 2.0
"""Averaging time of a gyro's bias [s], four strides."""


@plausibility_rule("gravity", "accel", when="comparable")
def gravity(view: LogView) -> Iterator[Finding]:
    """Check that the mean specific force of a body that stays near the ground is gravity,
    upwards.

    Compares: the mean of the accelerometer with gravity, and its direction with what is up: the
        robot's z, else away from the feet, else the reference's.
    Threshold: {ZERO_G:g} m/s² above {GRAVITY:g}, a quarter below; {MOST_LEAN:g}° from up.
    Reason: the mean acceleration of what stays near the ground is zero, so that gravity is left;
        accelerometers have biases of 80 mg at worst (MPU-6050 product specification); a robot that
        turns about on a slope of 35° has a shorter mean.
    Remedy: unit = "g"; sign; offset (twice gravity where the motion has the right sign, see the
        evidence); the order of the axes.
    """
    accel = view.log.accel
    mean, spread = accel.mean(axis=0), float(accel.std(axis=0).max())
    size = float(np.linalg.norm(mean))
    seen = f"mean ({number_words(mean)}) m/s^2, {size:.3g} in size where gravity is {GRAVITY}"
    cause, changes = in_another_unit("accel", ACCEL, size / GRAVITY, "")
    if 0.8 < size / GRAVITY**2 < 1.2:
        cause, changes = "multiplied by gravity twice", {}
    elif size < 0.2 * GRAVITY and spread > 0.0 and not cause:
        cause = "gravity was taken off: an acceleration, not the specific force that filters need"
    elif np.linalg.norm(accel, axis=1).std() < SAME_SIZE * size < 0.1 * spread and not cause:
        cause = "a direction: its size is the same in every row"
    up, lean = view.up_by_body, 0.0
    if up is None and view.log.has("reference"):
        up = view.R_GI.inv().apply([0.0, 0.0, 1.0]).mean(axis=0)
    if up is not None:
        lean = angle_between(mean, up)
    if cause:
        yield Finding(ACCEL, seen, cause, changes)
    elif up is not None and lean > MOST_LEAN:
        witness = "the reference" if view.up_by_body is None else "the body"
        seen = f"{seen}, {lean:.0f} deg from up by {witness}"
        yield _imu_turned(view) or _turned_over(view, mean, up, seen)
    elif not LEANING * GRAVITY < size < GRAVITY + ZERO_G:
        yield Finding(ACCEL, seen, f"scaled by {size / GRAVITY:.3g}, or a bias")


def _turned_over(view: LogView, mean: np.ndarray, up: np.ndarray, seen: str) -> Finding:
    """Explain why the mean specific force does not point up."""
    axis, found = (int(np.argmax(np.abs(x))) for x in (up, mean))
    if found != axis:
        cause = f"swapped axes: gravity is on {'xyz'[found]}, up is {'xyz'[axis]}"
        return Finding((ACCEL[axis], ACCEL[found]), seen, cause)
    columns, offset = (ACCEL[axis],), round(2.0 * float(np.sign(up[axis])) * GRAVITY, 2)
    if not view.trusts_reference:
        cause = "wrong sign, of the axis or of gravity alone: in its entry of the map"
        return Finding(columns, seen, f"{cause} sign = -1 or offset = {offset}")
    moved = match_axes(view.accel[view.ok], view.felt[view.ok]).paired
    if moved[axis] > 0.5:
        cause = "gravity has the wrong sign, the motion the right one"
        return Finding(columns, seen, cause, entries(columns, offset=offset))
    columns = view.columns("accel", moved < -0.5) or columns
    return Finding(columns, seen, "wrong sign", entries(columns, sign=-1.0))


@plausibility_rule("accelerometer", "t accel gyro ref", when="trusts_reference resolves")
def accelerometer(view: LogView) -> Iterator[Finding]:
    """Check that the specific force agrees with the motion of the reference.

    Compares: the accelerometer with gravity and the acceleration of ref_p, in world and body.
    Threshold: correlations as of the gyro; a mean {ZERO_G:g} m/s² off; {QUIET:.0%} of the motion.
    Reason: impacts and filters blur accelerations: clean walks have 60 % and more.
    Remedy: order or sign of the axes of accel or ref_p, whichever the evidence names.
    """
    accel, felt = view.accel[view.ok], view.felt[view.ok]
    R_GI = view.attitudes(0.0, view.ok)
    in_body = match_axes(accel, felt)
    # Motion is periodic: half a stride later, a swaying axis is its own negative.
    in_world = match_axes(view.ref_a[view.ok], R_GI.apply(accel) + GRAVITY_G)
    fits = max(in_body.paired.mean() + 0.1, in_body.best.mean(), in_world.best.mean())
    lag, shifted = view.delay(accel, felt, LATE_STREAM, LATEST_ACCEL)
    as_world = match_axes(accel, view.ref_a[view.ok] - GRAVITY_G).paired[:2]
    size = float(np.sqrt(np.sum(accel.var(axis=0)) / max(np.sum(felt.var(axis=0)), 1e-12)))
    if lag and shifted > max(HARDLY, fits) and other_point(view) is None:
        seen = f"{abs(lag):.2f} s {'late' if lag > 0 else 'early'} against the reference's motion"
        cause = "another clock, or a filter, of the accelerometer or of ref_p"
        yield Finding((*ACCEL, *REF_P), seen, cause)
    elif as_world.min() > LIKELY and (as_world - in_body.paired[:2]).mean() > _IN_WORLD:
        seen = f"correlation with the reference's accelerations in G {number_words(as_world)}"
        yield Finding(ACCEL, seen, "in the world's axes, not the body's")
    elif size < QUIET:
        seen = f"has {size:.2f} of the accelerations of the reference's motion"
        yield Finding(ACCEL, seen, "filtered, or gravity alone")
    # If gravity shows that the IMU's z is upright, the reference's is at fault.
    elif _shakes(view, in_world) and (
        in_world.best.mean() >= in_body.best.mean() or in_world.wrong == (2,)
    ):
        yield in_world.finding("ref_p", "the accelerometer")
    elif _shakes(view, in_body):
        yield in_body.finding("accel", "the reference's motion")
    else:
        off = (accel - felt).mean(axis=0)
        for i in np.flatnonzero(np.abs(off) > ZERO_G):
            seen = f"mean {off[i]:.2f} m/s^2 off what the reference's motion implies"
            yield Finding((ACCEL[i],), seen, "a bias, or a leaning mount")


def _shakes(view: LogView, match: AxesMatch) -> bool:
    """Whether a match has wrong axes, and the reference shakes along these."""
    shaken = np.minimum(view.ref_a[view.ok].std(axis=0), view.felt[view.ok].std(axis=0))
    return bool(match.wrong) and float(shaken[list(match.wrong)].min()) > SHAKES


@plausibility_rule("IMU's rows", "t accel gyro ref", when="trusts_reference")
def averaged(view: LogView) -> Iterator[Finding]:
    """Check that an IMU's rows are averages: summed over time they give the change of velocity.

    What shakes a body between samples makes the sum a random walk, as large as the steps from row
    to row imply.

    Compares: the accelerometer's sum over {SPEEDING:g} s with changes of velocity of ref_p.
    Threshold: {SUM_OFF:.0%} of these, and {IMPLIED[0]:g} to {IMPLIED[1]:g} times what
        independent samples cause.
    Reason: averages over each row give the change of velocity at any rate.
    Remedy: log faster, or averages over the rows: filters take each row for an average.
    """
    by_imu, by_reference = speed_changes(view)
    if len(by_imu) < FEWEST:
        return
    missed, changed = (
        float(np.sqrt(np.sum(x.var(axis=0)))) for x in (by_imu - by_reference, by_reference)
    )
    accel = view.log.accel
    bend = accel[1:-1] - 0.5 * (accel[2:] + accel[:-2])
    # White noise has a bend of 1.5 times its variance.
    implied = np.sqrt(np.sum(np.mean(bend**2, axis=0)) / 1.5 * view.step * SPEEDING)
    if missed > SUM_OFF * changed and IMPLIED[0] < missed / max(implied, 1e-12) < IMPLIED[1]:
        seen = f"its sum over {SPEEDING:g} s is {missed:.2f} m/s off changes of {changed:.2f} m/s"
        cause = "sampled at the rows, not averaged over them; log faster, or log averages"
        yield Finding((*GYRO, *ACCEL), seen, cause)


@plausibility_rule("gyro's unit", "gyro", when="comparable")
def gyro_unit(view: LogView) -> Iterator[Finding]:
    """Check that a gyro measures something, in rad/s.

    Compares: the gyro's size.
    Threshold: {TUMBLING:g} rad/s root mean square, or 0 throughout.
    Reason: a turn a second for as long as the log lasts is no walk.
    Remedy: unit = "deg/s".
    """
    rms = float(np.sqrt(np.mean(np.sum(view.log.gyro**2, axis=1))))
    if rms == 0.0:
        yield Finding(GYRO, "0 rad/s in every row", "not connected, or not logged")
    elif rms > TUMBLING:
        seen = f"root mean square {rms:.3g} rad/s"
        mean, other = (x.mean(axis=0) for x in (view.log.gyro, view.log.accel))
        if abs(np.linalg.norm(mean) / GRAVITY - 1.0) < 0.1 and np.linalg.norm(other) < rms / 3.0:
            columns = (*GYRO, *ACCEL)
            yield Finding(columns, f"{seen}, gravity in its mean", "gyro and accelerometer swapped")
            return
        factor = 180.0 / np.pi
        if view.compares_turning and view.gyro_match.alike:
            factor = float(np.median(view.gyro_match.scale))
            seen += f", {factor:.3g} times as fast as the reference turns"
        yield Finding(GYRO, seen, *in_another_unit("gyro", GYRO, factor, "scaled"))


@plausibility_rule("gyro", "t gyro ref", when="compares_turning")
def gyro(view: LogView) -> Iterator[Finding]:
    """Check that a gyro measures the rotation of the reference.

    Compares: the gyro with the turning of ref_q, axis by axis.
    Threshold: correlation above {LIKELY:g} with another axis or its negative, which leaves
        {MENDED:.0%} of what its own leaves; a factor off by {SCALED:.0%}; a mean
        {ZERO_RATE:g} rad/s off.
    Reason: gyros are true to 3 %, and read 20 deg/s at rest at worst (MPU-6050).
    Remedy: order, sign or unit of the axes; where the accelerometer says the same,
        imu_orientation.
    """
    match = view.gyro_match
    if turned := _imu_turned(view):
        yield turned
    elif match.wrong:
        yield match.finding("gyro", "the reference's turning")
    elif match.alike:
        sure = match.surely
        if sure.any():
            columns, unsure = view.columns("gyro", sure), 1.0 - match.best[sure]
            expected = "as fast as the reference turns"
            yield from of_scale(columns, match.scale[sure], expected, "scaled", unsure)
        yield from _gyro_biased(view)
    elif view.resolves:
        seen = f"correlation of turning {number_words(match.paired)} about x, y, z"
        cause = "another body, other axes or another clock; try surefoot align"
        yield Finding((*GYRO, "ref_q"), seen, cause)


def _gyro_biased(view: LogView) -> Iterator[Finding]:
    """Check the mean of a gyro against the reference's turning, some strides at a time."""
    off = (view.gyro - view.turning)[view.ok]
    blocks = np.array_split(off, max(1, round(len(off) * STEP / _BLOCK)))
    most = np.quantile(np.abs([one.mean(axis=0) for one in blocks]), 0.9, axis=0)
    for i in np.flatnonzero(most > ZERO_RATE):
        seen = f"up to {most[i]:.2f} rad/s off the reference's turning for {_BLOCK:g} s"
        yield Finding((GYRO[i],), seen, "a bias")


def _imu_turned(view: LogView) -> Finding | None:
    """Find an IMU whose gyro and accelerometer are turned alike relative to the reference.

    None where there is none, and where one of the two is turned alone.
    """
    axes = _axes_of_imu(view) if view.compares_turning else None
    if axes is None:
        return None
    columns, turn, words = (*GYRO, *ACCEL), None, "mirrored"
    if np.linalg.det(axes) > 0.0:
        turn = Rotation.from_matrix(axes)
        words = f"by {number_words(turn.as_rotvec(degrees=True))} deg about x, y, z"
    changes = {"reference": {"q_IM": quaternion(turn)}} if turn else {}
    if turn and not _in_body(view, axes):
        seen = f"{words}, from the tracked body's axes, as turning and motion say"
        return Finding(columns, seen, "the tracked body is turned against the IMU", changes)
    seen = f"{words}, from the reference's axes, as turning and motion say"
    if np.array_equal(axes, np.round(axes)):
        match = AxesMatch.of(axes)
        cause = f"the IMU is turned in the body: {match.words}"
        return Finding(columns, seen, cause, match.corrected("gyro", "accel"))
    cause = "the IMU is turned in the body; surefoot align finds q_IM closer"
    if view.robot is not None:
        q_BI = Rotation.from_matrix(view.robot.R_BI @ axes.T)
        changes |= {"robot": {"imu_orientation": quaternion(q_BI)}}
    return Finding(columns, seen, cause, changes)


def _axes_of_imu(view: LogView) -> np.ndarray | None:
    """Orthogonal matrix (3, 3) from the reference's axes to those of gyro and accelerometer.

    The rotation by Kabsch's method, or a mirror image along the axes. Whole numbers where it is
    near to them, and None where it is small or does not fit both.
    """
    gyro, turning = view.gyro[view.ok], view.turning[view.ok]
    a, b = gyro - gyro.mean(axis=0), turning - turning.mean(axis=0)
    found = Rotation.align_vectors(a, b)[0].as_matrix()
    match = view.gyro_match
    if np.linalg.det(match.axes) < 0 and len(match.wrong) and match.best.min() > LIKELY:
        found = match.axes
    if np.abs(found - np.round(found)).max() < np.sin(np.radians(TURNED_IMU)):
        found = np.round(found) + 0.0
    pairs = ((a, b), (view.accel[view.ok], view.felt[view.ok]))
    mends = all(np.sum((x - y @ found.T) ** 2) < MENDED * np.sum((x - y) ** 2) for x, y in pairs)
    return found if mends and not np.array_equal(found, np.eye(3)) else None


def _in_body(view: LogView, axes: np.ndarray) -> bool:
    """Whether an IMU that is turned from the reference's axes is so in the body, too.

    By up in the body or, where that is on the axis of the turn, by the feet.
    """
    up, mean = view.up_by_body, view.log.accel.mean(axis=0)
    if up is not None:
        as_is, put_right = (float(x @ up) / np.linalg.norm(mean) for x in (mean, mean @ axes))
        if abs(as_is - put_right) > 1.0 - np.cos(np.radians(TURNED_IMU)):
            return bool(put_right > as_is)
    if view.stance is None:
        return False
    gyro = view.gyro[view.stance.which]
    return view.stance.turning_fits(gyro @ axes) > view.stance.turning_fits(gyro)


@plausibility_rule("gyro and legs", "t gyro contact", beside="q foot")
def turning_of_legs(view: LogView) -> Iterator[Finding]:
    """Check a gyro without a reference, by the rotation of lines between standing feet.

    Compares: without a reference: the gyro with the turning of lines between standing feet.
    Threshold: another order or sign of axes that leaves {MENDED:.0%} of what is unexplained.
    Reason: feet that stand do not turn; other axes fit by chance only.
    Remedy: order or sign of the axes.
    """
    legs = view.stance
    if legs is None or view.log.has("reference"):
        return
    gyro = view.gyro[legs.which]
    as_is = legs.turning_fits(gyro)
    signed = product(permutations(np.eye(3)), product((1.0, -1.0), repeat=3))
    ways = [np.diag(signs) @ rows for rows, signs in signed]
    fits, best = max(((legs.turning_fits(gyro @ axes), k) for k, axes in enumerate(ways)))
    if 1.0 - fits**2 > MENDED * (1.0 - max(as_is, 0.0) ** 2):
        return
    match = AxesMatch.of(ways[best])
    columns = tuple(GYRO[i] for i in match.wrong)
    seen = f"correlation with the turning that standing feet see {as_is:.2f}, put right {fits:.2f}"
    yield Finding(columns, seen, match.words)
