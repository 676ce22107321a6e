"""Alignment of a measured reference with a log's IMU: clock offset, position and rotation.

It uses no legs, so a trace can rely on it.
"""

from dataclasses import dataclass, replace
from pathlib import PurePath
from typing import Any

import msgspec
import numpy as np
from scipy.spatial.transform import Rotation

from surefoot.models.alignment.least_squares import (
    FIRST_STEPS,
    MOST_STEPS,
    Placement,
    PlacementFit,
    Readings,
    fit_placement,
    most_likely,
    specific_forces,
)
from surefoot.models.alignment.rotation_guess import LEAST_OVERLAP, guesses_from_rotation
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.files import plain_json
from surefoot.sim.common.gravity import GRAVITY
from surefoot.sim.common.quaternion import matrix_from_quaternion, quaternion_from_matrix
from surefoot.sim.common.series import interpolate_rows
from surefoot.sim.importing.columns import map_line
from surefoot.sim.importing.reference import REFERENCE_OFFSET, in_world, mounted, with_reference
from surefoot.sim.importing.reference_check import without_jumps
from surefoot.sim.importing.sections import ReferenceTable
from surefoot.sim.log import Log
from surefoot.sim.log.reference import Poses, reference_poses
from surefoot.sim.log.schema import LOG_NAME
from surefoot.sim.plausibility.comparison import match_axes
from surefoot.sim.plausibility.reference import FASTEST_LEGS

_OTHER_EPOCH = 10.0
"""Time [s] by which recordings that were made together may miss each other on one epoch: two
programs that are started by hand.
"""
_FEWEST_SAMPLES = 15
"""Least number of samples of the reference for a fit: as many as it has unknowns."""
_SAME_OFFSET = 0.02
"""Difference of offsets that are the same [s]: a fraction of a stride."""
HALVES_TOLERANCE = 5e-3
"""Largest difference of the clock offsets of a log's halves [s]: half a sample at 100 Hz."""
MOST_ROTATION_MISSED = 0.15
"""Largest share of the gyro's rotation that the tracked body may lack. A gyro read at 100 Hz misses
less than a tenth of a walk's rotation; a loose body, or another one, lacks more.
"""
_LEVEL = np.eye(3)
_OFF_AXIS = 0.25
"""Largest error of the mean specific force along an axis of the reference's world, in gravities."""
_FORCE_SHIFT = 5.0
"""Largest difference of the accelerometer's mean from the specific force of the reference [m/s^2]:
half of gravity. A bias is smaller, as is the effect of the first guess of the rotation; gravity
with the wrong sign is larger.
"""


@dataclass(frozen=True)
class Alignment(Placement):
    """Clock offset, position and rotation of a tracked body M relative to the IMU I.

    Half widths are those of 95 % intervals.

    Attributes:
        q_GW: of the reference's world, to one with z up, as w, x, y, z.
        offset_half_width: [s].
        others: other clock offsets that fit as well (K,) [s]: a periodic gait looks alike after
            every stride. The interval of the offset includes them.
        halves: offsets fitted to each half of the log (2,) [s].
        p_IM_half_width: (3,) [m].
        R_IM_half_width: (3,) [rad].
        turn_missed: share of the gyro's rotation that the tracked body does not have.
        accel_sign: factor of each axis that makes the accelerometer a specific force (3,).
        accel_offset: to add to it (3,) [m/s^2].
        fitted: residuals of the fit.
        faults: reasons to doubt the result, in words.
    """

    q_GW: np.ndarray
    offset_half_width: float
    others: np.ndarray
    halves: np.ndarray
    p_IM_half_width: np.ndarray
    R_IM_half_width: np.ndarray
    turn_missed: float
    accel_sign: np.ndarray
    accel_offset: np.ndarray
    fitted: PlacementFit
    faults: tuple[str, ...]

    @property
    def q_IM(self) -> np.ndarray:
        """R_IM as w, x, y, z."""
        return quaternion_from_matrix(self.R_IM)

    @property
    def lines(self) -> tuple[str, ...]:
        """The result in words, faults last."""
        angles = np.degrees(Rotation.from_matrix(self.R_IM).as_rotvec())
        first, second = self.halves
        return (
            f"clock: add {_numbers(np.array([self.offset]), 4)} s to the reference's stamps "
            f"(+-{1e3 * self.offset_half_width:.2g} ms); the log's halves say "
            f"{_numbers(np.array([first]), 4)} and {_numbers(np.array([second]), 4)} s",
            f"place: the tracked point is at ({_numbers(1e3 * self.p_IM, 0)}) mm in the IMU frame "
            f"(+-{_numbers(1e3 * self.p_IM_half_width, 0)})",
            f"rotation: ({_numbers(angles, 1)}) deg from the tracked body's axes to the IMU's "
            f"(+-{_numbers(np.degrees(self.R_IM_half_width), 1)})",
            f"turning: the tracked body misses {100 * self.turn_missed:.1f} % of the gyro's",
            *(f"doubtful: {fault}" for fault in self.faults),
        )

    def map_lines(self, reference: ReferenceTable | None = None, name: str = "") -> tuple[str, ...]:
        """Lines of [reference] in an import map that apply the same alignment.

        They have all that is in `reference`, that of the recording's map, but its columns; or only
        the keys to replace, where it is not given. name: of the recording.
        """
        values = self.map_values
        if reference is not None:
            blank = vars(ReferenceTable(columns={}))
            own = {k: x for k, x in vars(reference).items() if k != "columns" and x != blank[k]}
            if isinstance(reference.offset, dict):
                values["offset"] = reference.offset | {name: values["offset"]}
            values = msgspec.to_builtins(own) | values
        return ("[reference]", *(map_line(key, x) for key, x in values.items()))

    @property
    def map_values(self) -> dict[str, Any]:
        """Values of [reference] in an import map, with as many digits as are written there."""
        return {
            "frame": "imu",
            "offset": round(self.offset, 5),
            "p_IM": _rounded(self.p_IM, 4),
            "q_IM": _rounded(self.q_IM, 6),
            "q_GW": _rounded(self.q_GW, 6),
        }

    def as_dict(self) -> dict[str, Any]:
        """The result as plain JSON types, in SI units."""
        values = {k: v for k, v in vars(self).items() if k not in ("fitted", "R_IM")}
        return plain_json(values | {"q_IM": self.q_IM})


def align(
    log: Log,
    poses: Poses | None = None,
    most: float | None = None,
    seed: int = 0,
    about: float = 0.0,
    R_GW: np.ndarray = _LEVEL,
) -> Alignment:
    """Find clock offset, position and rotation of a reference, from IMU and reference alone.

    Args:
        log: with an IMU.
        poses: of the tracked body, on its own clock; by default the log's own reference.
        most: largest difference from `about` that is searched for [s]; by default, and if nothing
            within it gives the clocks enough time in common, all offsets that do are searched.
        seed: of the bootstrap of the intervals.
        about: known part of the clock offset [s].
        R_GW: known part of the rotation (3, 3) of the poses' world to one with z up; a turn of the
            whole gravity is added to it.

    Raises SurefootError if the log has no IMU or no reference, or they overlap too little.
    """
    log.require("imu")
    poses = without_jumps(in_world(reference_poses(log) if poses is None else poses, R_GW))
    t, gyro, accel = log.t, log.gyro, log.accel
    too_little = SurefootError(f"{log.name}: IMU and reference share too little to be aligned")
    apart = max(poses.t[0] + about - t[-1], t[0] - poses.t[-1] - about) + LEAST_OVERLAP
    if apart > (_OTHER_EPOCH if most is None else most):
        about, most = 0.5 * float(t[0] + t[-1] - poses.t[0] - poses.t[-1]), None
    poses = replace(poses, t=poses.t + about)
    if most is None:
        # As far as they can have something in common, without what gaps of either add.
        middle = 0.5 * abs(float(t[0] + t[-1] - poses.t[0] - poses.t[-1]))
        most = middle + 0.5 * (_recorded(t) + _recorded(poses.t))
    starts = guesses_from_rotation(t, gyro, poses, most)
    if not starts:
        raise too_little
    readings = Readings(t, gyro, accel, poses)
    speed = float(np.median(np.linalg.norm(np.diff(poses.p, axis=0), axis=1) / np.diff(poses.t)))
    if speed > FASTEST_LEGS:
        unit = "in mm, not m? Set the unit of ref_p in the map first"
        raise SurefootError(f"{log.name}: the reference moves at {speed:.3g} m/s: {unit}")
    readings, turn, sign, shift = _in_our_convention(readings, starts[0])
    # Wrong strides converge slowly: those that leave clearly more after some steps are left out.
    every: list[tuple[PlacementFit, Placement]] = []
    for steps in (FIRST_STEPS, MOST_STEPS) if len(starts) > 1 else (MOST_STEPS,):
        fits = [fit_placement(readings, x, np.random.default_rng(seed), steps) for x in starts]
        every = [(one, x) for one, x in zip(fits, starts, strict=True) if one]
        every = [(one, x) for one, x in every if len(one.t) >= _FEWEST_SAMPLES]
        if not every:
            raise too_little
        every = [every[k] for k in most_likely([one for one, _ in every])]
        starts = [x for _, x in every]
    fitted, *rivals = (one for one, _ in every)
    R_GW = R_GW if turn is None else turn @ R_GW
    turned = ("the reference's world has another axis up than z: see q_GW",) * (turn is not None)
    found, width = fitted.placement, fitted.half_width
    alike = (one.placement.offset for one in rivals)
    others = np.array(sorted(x for x in alike if abs(x - found.offset) > _SAME_OFFSET))
    halves = about + found.offset + fitted.halves[:, 0]
    missed = _turn_missed(fitted, readings)
    return Alignment(
        **vars(replace(found, offset=about + found.offset)),
        q_GW=quaternion_from_matrix(R_GW),
        offset_half_width=float(width[0] + np.abs(others - found.offset).max(initial=0.0)),
        others=about + others,
        halves=halves,
        p_IM_half_width=width[10:13],
        R_IM_half_width=width[1:4],
        turn_missed=missed,
        accel_sign=sign,
        accel_offset=shift,
        fitted=fitted,
        faults=(*turned, *_faults(missed, about + others, halves, sign, shift)),
    )


def aligned_log(log: Log, alignment: Alignment, poses: Poses | None = None) -> Log:
    """The log with ref_p and ref_q of the IMU frame on the IMU's clock, noted in its metadata.

    `poses` are those that were aligned, by default the log's own; rows outside them are cut.
    """
    poses = reference_poses(log) if poses is None else poses
    at = alignment.map_values
    R_GW, R_IM = (matrix_from_quaternion(np.array(at[name])) for name in ("q_GW", "q_IM"))
    poses = in_world(replace(poses, t=poses.t + at["offset"]), R_GW)
    at_imu = mounted(poses, np.array(at["p_IM"]), R_IM)
    columns = {str(n): x.to_numpy() for n, x in log.frame.items() if not str(n).startswith("ref_")}
    columns = with_reference(columns, at_imu, log.name)
    frame = log.frame.iloc[:0].reindex(columns=list(columns)).assign(**columns)
    return noted_as_aligned(replace(log, frame=frame), alignment)


def noted_as_aligned(log: Log, alignment: Alignment) -> Log:
    """The log with the alignment of its reference, and its own name, in its metadata."""
    done = {k: alignment.as_dict()[k] for k in ("offset", "p_IM", "q_IM")}
    derived = (*log.meta.derived, "reference (aligned with the IMU)")
    offset = {REFERENCE_OFFSET: alignment.map_values["offset"]}
    model = (
        log.meta.model | offset | {"reference_alignment": done, LOG_NAME: PurePath(log.name).name}
    )
    return replace(log, meta=replace(log.meta, derived=derived, model=model))


def _in_our_convention(
    readings: Readings, start: Placement
) -> tuple[Readings, np.ndarray | None, np.ndarray, np.ndarray]:
    """The readings in a world with z up, by an accelerometer of specific force; the turn (3, 3) of
    the reference's world, None for none; sign (3,) and shift (3,) of the accelerometer.
    """
    felt, moved, lever = specific_forces(readings, start)
    if len(felt) < _FEWEST_SAMPLES:
        return readings, None, np.ones(3), np.zeros(3)
    turn = _level(readings, start, felt.mean(axis=0))
    if turn is not None:
        readings = replace(readings, poses=in_world(readings.poses, turn))
        felt, moved, lever = specific_forces(readings, start)
    sign, shift = _accelerometer(felt, moved, lever)
    return replace(readings, accel=readings.accel * sign + shift), turn, sign, shift


def _recorded(t: np.ndarray) -> float:
    """Time [s] that stamps t (N,) cover without gaps."""
    steps = np.diff(t)
    return float(np.minimum(steps, 10.0 * np.median(steps)).sum())


def _turn_missed(fitted: PlacementFit, readings: Readings) -> float:
    """Share of the gyro's rotation that the tracked body does not have, while the robot moves.

    The median of the residual counts, since impacts smeared by the IMU's filter are not another
    body.
    """
    rates = interpolate_rows(fitted.t, readings.t, readings.gyro)
    rates = rates - np.median(rates, axis=0)
    size = np.linalg.norm(rates, axis=1)
    moving = size > 0.1 * np.percentile(size, 95.0)
    missed = (1.4826 * np.median(np.abs(fitted.rates[moving]), axis=0)) ** 2
    return float(missed.sum() / max(float(np.var(rates[moving], axis=0).sum()), 1e-12))


def _level(readings: Readings, at: Placement, felt: np.ndarray) -> np.ndarray | None:
    """Rotation (3, 3) to a world with z up, where the mean specific force (3,) [m/s^2] is along
    another axis of the reference's world and the motion fits it there; else None.

    Along -z only that of an upright IMU: else it may be the accelerometer's sign.
    """
    up = (readings.poses.R @ at.R_IM.T @ felt).mean(axis=0) / GRAVITY
    axis = np.round(up)
    upright = axis[2] > 0.0 or (axis[2] < 0.0 and felt[2] < 0.0)
    if upright or np.abs(axis).sum() != 1.0 or np.linalg.norm(up - axis) > _OFF_AXIS:
        return None
    turn = np.round(Rotation.align_vectors([[0.0, 0.0, 1.0]], [axis])[0].as_matrix())
    poses = in_world(readings.poses, turn)
    felt, moved, _ = specific_forces(replace(readings, poses=poses), at)
    return turn if match_axes(felt, moved).alike else None


def _accelerometer(
    felt: np.ndarray, moved: np.ndarray, lever: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Sign (3,) and offset (3,) [m/s^2] that make the accelerometer's readings a specific force,
    since conventions differ.

    The arguments are the results of `specific_forces`.
    """
    sign, shift = np.ones(3), np.zeros(3)
    for axis in range(3):
        columns = np.column_stack([moved[:, axis], lever[:, axis], np.ones(len(felt))])
        slope = np.linalg.lstsq(columns, felt[:, axis], rcond=None)[0][0]
        sign[axis] = -1.0 if slope < -0.3 else 1.0
        difference = float(np.mean(moved[:, axis] - sign[axis] * felt[:, axis]))
        if abs(difference) > _FORCE_SHIFT:
            shift[axis] = round(difference, 2)
    return sign, shift


def _faults(
    missed: float, others: np.ndarray, halves: np.ndarray, sign: np.ndarray, shift: np.ndarray
) -> tuple[str, ...]:
    """Reasons to doubt an alignment, in words.

    Args:
        missed: share of the rotation that the tracked body does not have.
        others: other clock offsets that fit as well (K,) [s].
        halves: offsets by each half of the log (2,) [s].
        sign: of the accelerometer's axes (3,).
        shift: of the same (3,) [m/s^2].
    """
    found = []
    if len(others):
        found.append(
            f"a clock offset of {_numbers(others, 3)} s fits as well, since strides look alike: "
            "start or stop walking, or turn, while both record; or give the offset in the map"
        )
    if missed > MOST_ROTATION_MISSED:
        found.append(
            f"the tracked body does not turn as the IMU does: {100 * missed:.0f} % of the gyro's "
            "turning is not its own (another body, a loose one, or no common motion)"
        )
    if abs(halves[1] - halves[0]) > HALVES_TOLERANCE:
        found.append(
            f"the halves of the log disagree by {1e3 * abs(halves[1] - halves[0]):.0f} ms: a clock "
            "that drifts or jumps"
        )
    if np.count_nonzero(shift) > 1:
        shift = 0.0 * shift
        found.append("gravity is along other axes of accel than of the reference: swapped ones?")
    for axis, s, d in zip("xyz", sign, shift, strict=True):
        if s < 0 or d:
            found.append(
                f"accel_{axis} is no specific force; in the map, on top of its own: "
                f"sign = {s:.0f}, offset = {d:.2f} in the entry of accel_{axis}"
            )
    return tuple(found)


def _rounded(values: np.ndarray, digits: int) -> tuple[float, ...]:
    # Adding zero turns -0.0 into 0.0.
    return tuple((np.round(values, digits) + 0.0).tolist())


def _numbers(values: np.ndarray, digits: int) -> str:
    return ", ".join(f"{value:.{digits}f}" for value in _rounded(values, digits))
