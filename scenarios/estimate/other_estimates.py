"""Estimates of other programs: poses as TUM text, or a table with the columns below.

| columns | | unit |
|---|---|---|
| `t` | time on the log's clock | s |
| `p_{x,y,z}` | position in the world | m |
| `q_{w,x,y,z}` | attitude, body to world | - |
| `v_{x,y,z}` | velocity in the world; derived from the positions where left out | m/s |
| `cov_p_{xx,xy,xz,yy,yz,zz}` | covariance of the position's error in the world | m^2 |
| `cov_v_...` | the same of the velocity | m^2/s^2 |
| `cov_q_...` | the same of the attitude, as a rotation vector in the world | rad^2 |

TUM text has the columns t, p_x, p_y, p_z, q_x, q_y, q_z and q_w, without names or with others that
end in these letters, as the header `# timestamp tx ty tz qx qy qz qw` of the TUM data sets does.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from surefoot.estimator.core.lie import hat
from surefoot.estimator.evaluation.trajectory import Trajectory, reference
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.quaternion import matrix_from_quaternion, quaternion_from_matrix
from surefoot.sim.common.series import interpolate_rows
from surefoot.sim.importing.clock import span
from surefoot.sim.importing.readers.file import detected_layout, read_file
from surefoot.sim.importing.readers.table import RecordedTable, column_readings
from surefoot.sim.importing.reference import interpolate_reference, unit_quaternions
from surefoot.sim.importing.sections import Source
from surefoot.sim.log import Log
from surefoot.sim.log.derived import REFERENCE_WINDOW, derivative
from surefoot.sim.log.reference import Poses
from surefoot.sim.robot import Robot

_POSITION = ("p_x", "p_y", "p_z")
_ATTITUDE = ("q_w", "q_x", "q_y", "q_z")
_VELOCITY = ("v_x", "v_y", "v_z")
_TUM = ("t", *_POSITION, *_ATTITUDE[1:], _ATTITUDE[0])
_PARTS = {"attitude": "q", "velocity": "v", "position": "p"}
"""Quantities in the order of the right-invariant error, and their names in columns."""
_PAIRS = {f"{a}{b}": (i, j) for i, a in enumerate("xyz") for j, b in enumerate("xyz") if i <= j}
"""Entries of a symmetric matrix by the names of their columns."""


@dataclass(frozen=True)
class OtherEstimate:
    """An estimate, and what it claims of its errors.

    Attributes:
        trajectory: on its own stamps.
        claimed: which of position, velocity and attitude have a covariance.
    """

    trajectory: Trajectory
    claimed: frozenset[str]


def read_estimate(path: Path) -> OtherEstimate:
    """Read an estimate of surefoot (Parquet), or of another program, see the module.

    Raises SurefootError, one line naming the file, and the column and row at fault.
    """
    if path.suffix.lower() == ".parquet":
        found = Trajectory.read(path)
        claimed = () if found.covariance is None else _PARTS
        return OtherEstimate(found, frozenset(claimed))
    layout = detected_layout(path)
    table = read_file(path, Source(**layout))
    cells = table.cells
    named = layout.get("header", True)
    in_order = not named or "".join(name[-1:] for name in cells).lower().endswith("xyzxyzw")
    if in_order and len(cells) == len(_TUM):
        cells = dict(zip(_TUM, cells.values(), strict=True))
    elif not named:
        raise SurefootError(
            f"{path}: {len(cells)} columns without names; TUM text has {len(_TUM)}: "
            "t x y z qx qy qz qw"
        )
    table = replace(table, cells=cells)
    t = _values(table, ("t",))[:, 0]
    backwards = np.flatnonzero(np.diff(t) <= 0.0)
    if len(t) < 2 or len(backwards):
        at = f"{table.row} {table.first + backwards[0] + 1}: " if len(backwards) else ""
        raise SurefootError(f"{path}: {at}t must increase from row to row, over two at least")
    p_GI = _values(table, _POSITION)
    rows = np.arange(len(t)) + table.first
    q = unit_quaternions(path, _values(table, _ATTITUDE), table.row, rows)
    known = any(name in cells for name in _VELOCITY)
    v_GI = _values(table, _VELOCITY) if known else derivative(t, p_GI, REFERENCE_WINDOW, False)
    zeros = np.zeros((len(t), 3))
    found = Trajectory(t, matrix_from_quaternion(q), v_GI, p_GI, zeros, zeros)
    blocks = {
        name: _covariance(table, part)
        for name, part in _PARTS.items()
        if any(column.startswith(f"cov_{part}_") for column in cells)
    }
    covariance = _invariant(found, blocks) if blocks else None
    return OtherEstimate(replace(found, covariance=covariance), frozenset(blocks))


def _values(table: RecordedTable, names: Sequence[str]) -> np.ndarray:
    """The columns (N, D) of these names."""
    for name in names:
        if name not in table.cells:
            raise SurefootError(f"{table.path}: column {name!r} is missing, of {', '.join(names)}")
    return np.column_stack([column_readings(table, name, Source())[1] for name in names])


def _covariance(table: RecordedTable, part: str) -> np.ndarray:
    """Covariance (N, 3, 3) of the errors of a part in the world."""
    entries = _values(table, [f"cov_{part}_{pair}" for pair in _PAIRS])
    covariance = np.empty((len(entries), 3, 3))
    for column, (i, j) in zip(entries.T, _PAIRS.values(), strict=True):
        covariance[:, i, j] = covariance[:, j, i] = column
    wrong = np.flatnonzero(np.linalg.eigvalsh(covariance)[:, 0] <= 0.0)
    if len(wrong):
        row = f"{table.row} {table.first + wrong[0]}"
        raise SurefootError(f"{table.path}: {row}: cov_{part} is not positive definite")
    return covariance


def _invariant(estimate: Trajectory, blocks: Mapping[str, np.ndarray]) -> np.ndarray:
    """Covariance (N, 15, 15) of the right-invariant error, from those of parts in the world,
    uncorrelated; zero where a part is left out.

    To first order xi_p = (p_bar - p) + [p_bar]x xi_R, and xi_v likewise.
    """
    n = len(estimate.t)
    in_world = np.zeros((n, 9, 9))
    for at, part in enumerate(_PARTS):
        in_world[:, 3 * at : 3 * at + 3, 3 * at : 3 * at + 3] = blocks.get(part, 0.0)
    J = np.broadcast_to(np.eye(9), (n, 9, 9)).copy()
    J[:, 3:6, :3], J[:, 6:, :3] = hat(estimate.v_GI), hat(estimate.p_GI)
    covariance = np.zeros((n, 15, 15))
    covariance[:, :9, :9] = J @ in_world @ J.swapaxes(1, 2)
    return covariance


def of_imu(estimate: Trajectory, log: Log, robot: Robot) -> Trajectory:
    """The estimate of the IMU frame, from one of the robot's base; the log's gyro gives the
    velocity of the one relative to the other.

    The mounting multiplies a pose on the right, so the right-invariant error stays as it is.
    """
    gyro = interpolate_rows(estimate.t, log.t, log.gyro)
    lever = np.cross(gyro @ robot.R_BI.T, robot.p_BI)
    turned = estimate.R_GI @ np.stack([lever, np.broadcast_to(robot.p_BI, lever.shape)], axis=-1)
    return replace(
        estimate,
        R_GI=estimate.R_GI @ robot.R_BI,
        v_GI=estimate.v_GI + turned[..., 0],
        p_GI=estimate.p_GI + turned[..., 1],
    )


def beside_reference(estimate: Trajectory, log: Log, name: str) -> tuple[Trajectory, Trajectory]:
    """The log's reference interpolated to the estimate's stamps, and the estimate, at those that
    are not in a gap of the reference.

    Raises SurefootError, naming the estimate, where fewer than two are.
    """
    truth = reference(log)
    inside = (estimate.t >= truth.t[0]) & (estimate.t <= truth.t[-1])
    if np.count_nonzero(inside) < 2:
        raise SurefootError(
            f"{name}: its stamps ({span(estimate.t)}) and the log's reference ({span(truth.t)}) do "
            "not overlap; --offset is added to its stamps"
        )
    estimate = estimate.rows(inside)
    measured = Poses(truth.t, truth.p_GI, quaternion_from_matrix(truth.R_GI))
    poses, known = interpolate_reference(estimate.t, measured)
    v_GI = interpolate_rows(estimate.t, truth.t, truth.v_GI)
    zeros = np.zeros_like(v_GI)
    there = Trajectory(estimate.t, poses.R, v_GI, poses.p, zeros, zeros)
    return there.rows(known), estimate.rows(known)
