"""Conversion of a recording's reference, poses of a tracked body with its own clock, to the motion
of the IMU frame at a log's rows.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.quaternion import matrix_from_quaternion, quaternion_from_matrix, slerp
from surefoot.sim.common.series import interpolate_rows
from surefoot.sim.importing.clock import Columns, span
from surefoot.sim.importing.columns import EULER
from surefoot.sim.importing.map import ImportMap
from surefoot.sim.importing.sections import ReferenceTable
from surefoot.sim.log import LogError
from surefoot.sim.log.reference import Poses

MAX_GAP = 0.05
"""Gap in the reference over which interpolated rows are marked with ref_ok = 0 [s]."""


_UNIT_TOLERANCE = 1e-2
"""Largest deviation of a quaternion's norm from one, which rounding explains."""
REFERENCE_OFFSET = "reference_offset"
"""Key of a log's `meta.model`: clock offset [s] with which its reference was imported."""
REFERENCE_SAMPLES = "reference_samples"
"""The same: time of the first sample of its reference and usual interval between them [s]."""


def poses_of(table: Columns, path: Path, unit: str, rows: np.ndarray, notes: list[str]) -> Poses:
    """Poses in a reference's own columns t, ref_p and ref_q, or ref_roll, ref_pitch and ref_yaw:
    R = Rz(yaw) Ry(pitch) Rx(roll). Samples without an attitude are left out and added to the notes.

    Raises LogError as `unit_quaternions`, with the same arguments.
    """
    p = np.column_stack([table[f"ref_p_{axis}"] for axis in "xyz"])
    if EULER[0] in table:
        angles = np.column_stack([table[name] for name in EULER])
        q = Rotation.from_euler("ZYX", angles[:, ::-1]).as_quat(scalar_first=True)
        return Poses(table["t"], p, q)
    q = np.column_stack([table[f"ref_q_{axis}"] for axis in "wxyz"])
    known = np.any(q, axis=1)
    if known.all() or not known.any():
        return Poses(table["t"], p, unit_quaternions(path, q, unit, rows))
    notes.append(f"{path}: left out: {np.sum(~known)} samples without an attitude (0, 0, 0, 0)")
    q = unit_quaternions(path, q[known], unit, rows[known])
    return Poses(table["t"][known], p[known], q)


def unit_quaternions(
    path: Path, q: np.ndarray, unit: str = "row", rows: np.ndarray | None = None
) -> np.ndarray:
    """Quaternions (N, 4), normalised; raises LogError, naming the row, where the norm is too far
    from one.

    Rows are called `unit` in the message, with the numbers `rows` (N,), by default from 1.
    """
    norm = np.linalg.norm(q, axis=1)
    bad = np.flatnonzero(np.abs(norm - 1.0) > _UNIT_TOLERANCE)
    if bad.size:
        number = bad[0] + 1 if rows is None else rows[bad[0]]
        raise LogError(f"{path}: {unit} {number}: not a unit quaternion (norm {norm[bad[0]]:.6g})")
    return q / norm[:, None]


def tracked_poses(poses: Poses, reference: ReferenceTable) -> Poses:
    """Poses of the tracked body in a world with z up, on its own clock, from those recorded."""
    if reference.inverse:
        poses = replace(poses, q=quaternion_from_matrix(poses.R.swapaxes(1, 2)))
    return in_world(poses, matrix_from_quaternion(np.array(reference.q_GW)))


def in_world(poses: Poses, R_GW: np.ndarray) -> Poses:
    """Poses in a world G, from those in W; R_GW (3, 3)."""
    if np.array_equal(R_GW, np.eye(3)):
        return poses
    return Poses(poses.t, poses.p @ R_GW.T, quaternion_from_matrix(R_GW @ poses.R))


def imu_poses(poses: Poses, rules: ImportMap, name: str) -> Poses:
    """Poses of the IMU frame on the log's clock, from those of the tracked body.

    Raises SurefootError where the map has no offset for this recording, or no position of the IMU.

    Args:
        poses: as recorded.
        rules: whose `[reference]` gives the body, its position and the clock's offset.
        name: of the recording, for offsets that differ between recordings.
    """
    reference = rules.sections.reference
    if reference is None:
        return poses
    moved = tracked_poses(poses, reference)
    moved = replace(moved, t=moved.t + reference_offset(rules, name))
    if reference.frame == "imu":
        R_IM = matrix_from_quaternion(np.array(reference.q_IM))
        return mounted(moved, np.array(reference.p_IM), R_IM)
    if "p_BI" not in rules.model:
        raise SurefootError(
            f'{rules.path}: [reference] frame "base" needs [robot] imu_position, or an IMU in '
            "the robot's file"
        )
    R_BI = matrix_from_quaternion(np.array(rules.model.get("q_BI", [1.0, 0.0, 0.0, 0.0])))
    return mounted(moved, -R_BI.T @ np.array(rules.model["p_BI"]), R_BI.T)


def mounted(poses: Poses, p_IM: np.ndarray, R_IM: np.ndarray) -> Poses:
    """Poses of the IMU frame I from those of a body M, at p_IM (3,) [m] in I with attitude R_IM (3,
    3), from M to I.
    """
    if not np.any(p_IM) and np.array_equal(R_IM, np.eye(3)):
        return poses
    R_GI = poses.R @ R_IM.T
    return Poses(poses.t, poses.p - R_GI @ p_IM, quaternion_from_matrix(R_GI))


def with_reference(main: Columns, poses: Poses, source: str) -> Columns:
    """The rows within the reference's time, with ref_p, ref_q and ref_ok.

    Args:
        main: log columns with t.
        poses: of the IMU frame, on the same clock.
        source: of the reference, for the message if they do not overlap.
    """
    t = main["t"]
    inside = (t >= poses.t[0]) & (t <= poses.t[-1])
    if not inside.any():
        longer = np.ptp(t) / max(float(np.ptp(poses.t)), 1e-12)
        unit = "" if 0.01 < longer < 100.0 else 'is the t of one in another unit (unit = "ms")? Or '
        raise SurefootError(
            f"{source}: the reference ({span(poses.t)}) and the recording ({span(t)}) do not"
            f" overlap: {unit}another clock? surefoot align finds [reference] offset"
        )
    main = {column: values[inside] for column, values in main.items()}
    at, ok = interpolate_reference(main["t"], poses)
    main |= {f"ref_p_{axis}": at.p[:, i] for i, axis in enumerate("xyz")}
    main |= {f"ref_q_{axis}": at.q[:, i] for i, axis in enumerate("wxyz")}
    return main | {"ref_ok": ok.astype(float)}


def interpolate_reference(t: np.ndarray, poses: Poses) -> tuple[Poses, np.ndarray]:
    """Interpolate poses to t (N,), within their times: positions linearly, attitudes by slerp.

    Returns the poses, and ok (N,): False strictly inside a gap over MAX_GAP.
    """
    after = np.clip(np.searchsorted(poses.t, t, side="left"), 1, len(poses.t) - 1)
    start, end = poses.t[after - 1], poses.t[after]
    ok = (end - start <= MAX_GAP) | (t == start) | (t == end)
    position = interpolate_rows(t, poses.t, poses.p)
    attitude = slerp(poses.t, poses.q, t)
    # As recorded, q may stand for its negative.
    opposite = np.sum(attitude * poses.q[after - 1], axis=1, keepdims=True) < 0.0
    return Poses(t, position, np.where(opposite, -attitude, attitude)), ok


def reference_offset(rules: ImportMap, name: str) -> float:
    """Clock offset [s] of a map's reference for the recording of this name, 0 without a reference.

    Raises SurefootError where the map has offsets for other recordings only.
    """
    given = rules.sections.reference.offset if rules.sections.reference else 0.0
    if not isinstance(given, dict):
        return given
    if name not in given:
        raise SurefootError(
            f"{rules.path}: [reference.offset] has none for {name!r} (known: {', '.join(given)})"
        )
    return given[name]
