"""Trajectories, estimated or of a reference, and their files: Parquet and TUM text."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TextIO

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from surefoot.estimator.core.lie import hat
from surefoot.estimator.evaluation.innovation_sums import InnovationSums
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.files import whole_file
from surefoot.sim.common.limits import admitted, check_unpacked
from surefoot.sim.common.quaternion import matrix_from_quaternion, quaternion_from_matrix
from surefoot.sim.log import Log, reference_velocity

_KEY = b"surefoot_trajectory"
_SCHEMA = b"1"
_VECTORS = {"p_GI": "p", "v_GI": "v", "b_a": "b_a", "b_g": "b_g"}
ACROSS = np.diag([1.0, 1.0, 0.0])
"""Axes of I about which a mounting error appears as tilt, for an upright body."""


def _columns(name: str, axes: str = "xyz") -> list[str]:
    return [f"{name}_{axis}" for axis in axes]


_UPPER = np.triu_indices(15)
_STATE = ["t", *_columns("q", "wxyz"), *(c for name in _VECTORS.values() for c in _columns(name))]
_COVARIANCE = [f"cov_{i}_{j}" for i, j in zip(*_UPPER, strict=True)]
_UPDATES = ["update_t", *_columns("update_v")]
_BOUNDED = [*_columns("update_epsilon"), "update_pi"]


class TrajectoryError(SurefootError):
    """A trajectory that cannot be read, written or compared."""


@dataclass(frozen=True)
class UpdateRecord:
    """Record of the velocity updates.

    Attributes:
        t: time (M,) [s].
        v_I: measured velocity of the IMU in I (M, 3) [m/s].
        epsilon: bounds of a coverage update (M, 3) [m/s]; None for Gaussian updates.
        pi: prior mass inside the bounds (M,) (eq. pi_def_error_state); None for Gaussian updates.
        active: whether the state changed (M,): pi < gamma, or a Gaussian update.
    """

    t: np.ndarray
    v_I: np.ndarray
    epsilon: np.ndarray | None
    pi: np.ndarray | None
    active: np.ndarray


@dataclass(frozen=True)
class Trajectory:
    """Poses, velocities and biases at N times.

    Attributes:
        t: time (N,) [s].
        R_GI: (N, 3, 3).
        v_GI: (N, 3) [m/s] in G.
        p_GI: (N, 3) [m] in G.
        b_a: (N, 3) [m/s^2] in I.
        b_g: (N, 3) [rad/s] in I.
        covariance: of the right-invariant error (rotation, velocity, position, b_a, b_g) (N, 15,
            15); None for a reference.
        updates: record of the velocity updates.
        innovations: sums over all updates; not stored in files.
        diverged: whether later estimates were not finite and are omitted; not stored in files.
        unlike: distance (N,) of the walk so far from those that an observer was trained on, 1 being
            the farthest of these and NaN where it is not known; not stored in files.
    """

    t: np.ndarray
    R_GI: np.ndarray
    v_GI: np.ndarray
    p_GI: np.ndarray
    b_a: np.ndarray
    b_g: np.ndarray
    covariance: np.ndarray | None = None
    updates: UpdateRecord | None = None
    innovations: InnovationSums | None = None
    diverged: bool = False
    unlike: np.ndarray | None = None

    def __post_init__(self):
        n = len(self.t)
        shapes = {"t": (n,), "R_GI": (n, 3, 3)} | dict.fromkeys(_VECTORS, (n, 3))
        for name, wanted in (shapes | {"covariance": (n, 15, 15), "unlike": (n,)}).items():
            value = getattr(self, name)
            if value is not None and np.shape(value) != wanted:
                raise TrajectoryError(
                    f"trajectory: {name} has shape {np.shape(value)}, not {wanted}"
                )

    @property
    def v_I(self) -> np.ndarray:
        """Velocity (N, 3) [m/s] of the IMU expressed in I."""
        return np.einsum("nij,ni->nj", self.R_GI, self.v_GI)

    def rows(self, which: slice | np.ndarray) -> Trajectory:
        """Select rows by a slice, a mask (N,) or indices. Updates are kept whole."""
        every = {name: getattr(self, name) for name in ("t", "R_GI", *_VECTORS)}
        every |= {"covariance": self.covariance, "unlike": self.unlike}
        return replace(self, **{k: None if x is None else x[which] for k, x in every.items()})

    def write(self, path: str | Path, force: bool = False, warnings: Sequence[str] = ()) -> None:
        """Write one Parquet file, whole or not at all; refuses to overwrite without `force`.

        `warnings`, about what in the log was not plausible, are kept in its metadata.
        """
        with trajectory_file(path, force, tuple(self.columns()), warnings) as write:
            write(self)

    def columns(self) -> dict[str, np.ndarray]:
        """Values by the names of a file's columns, see `trajectory_file`."""
        vectors = (getattr(self, name) for name in _VECTORS)
        state = np.column_stack([self.t, quaternion_from_matrix(self.R_GI), *vectors])
        columns = dict(zip(_STATE, state.T, strict=True))
        if self.covariance is not None:
            columns |= zip(_COVARIANCE, self.covariance[:, *_UPPER].T, strict=True)
        if (updates := self.updates) is not None:
            columns |= zip(_UPDATES, (updates.t, *updates.v_I.T), strict=True)
            if updates.epsilon is not None:
                columns |= zip(_BOUNDED, (*updates.epsilon.T, updates.pi), strict=True)
            columns["update_active"] = updates.active.astype(float)
        return columns

    @classmethod
    def read(cls, path: str | Path) -> Trajectory:
        """Read the trajectory at `path`. Raises TrajectoryError, one line naming the file and
        column.
        """
        try:
            path = admitted(path, "recording")
            about = pq.read_metadata(path)
            size = 8.0 * about.num_rows * about.num_columns
            check_unpacked(path.stat().st_size, size, f"{path}: bytes of columns")
            table = pq.read_table(path, page_checksum_verification=True)
        except SurefootError as error:
            raise TrajectoryError(str(error)) from None
        except (OSError, pa.ArrowException) as error:
            raise TrajectoryError(f"{path}: cannot be read as a trajectory ({error})") from None
        if (table.schema.metadata or {}).get(_KEY) != _SCHEMA:
            raise TrajectoryError(f"{path}: is not a trajectory of this version of surefoot")
        frame = table.to_pandas()
        missing = [name for name in _STATE if name not in frame]
        if missing:
            raise TrajectoryError(f"{path}: column {missing[0]} is missing")
        states = frame[frame["t"].notna()]
        q = _gathered(states, _columns("q", "wxyz"))
        if not np.all(np.abs(np.linalg.norm(q, axis=1) - 1) < 1e-6):
            raise TrajectoryError(f"{path}: q_w..q_z are not unit quaternions")
        covariance = None
        if "cov_0_0" in frame:
            covariance = np.empty((len(states), 15, 15))
            covariance[:, *_UPPER] = states[_COVARIANCE]
            covariance[:, *_UPPER[::-1]] = states[_COVARIANCE]
        vectors: Any = {name: _gathered(states, _columns(c)) for name, c in _VECTORS.items()}
        return cls(
            t=states["t"].to_numpy(),
            R_GI=matrix_from_quaternion(q),
            **vectors,
            covariance=covariance,
            updates=_read_updates(frame),
        )

    def write_tum(self, path: str | Path, force: bool = False) -> None:
        """Write lines of t x y z qx qy qz qw (TUM format) with 17 digits, so nothing is lost."""
        with whole_file(path, force) as temporary, temporary.open("w") as file:
            self.append_tum(file)

    def append_tum(self, file: TextIO) -> None:
        """Append the same lines to an open file."""
        q = quaternion_from_matrix(self.R_GI)
        table = np.column_stack([self.t, self.p_GI, q[:, 1:], q[:, :1]])
        np.savetxt(file, table, fmt="%.17g")


@contextmanager
def trajectory_file(
    path: str | Path,
    force: bool = False,
    columns: tuple[str, ...] | None = None,
    warnings: Sequence[str] = (),
) -> Iterator[Callable[[Trajectory], None]]:
    """A function that appends the next piece of a trajectory to a file, which is whole or absent.

    Columns: t, q_{w,x,y,z}, {p,v,b_a,b_g}_{x,y,z}, the upper triangle cov_<i>_<j>, and for the
    updates update_{t,v_*,epsilon_*,pi,active}. Each piece is a row group, in which the shorter of
    states and updates is padded with NaN; `Trajectory.read` returns them as one.

    Args:
        path: of the file.
        force: whether to overwrite an existing file; SurefootError otherwise.
        columns: of the file, by default all; NaN where a piece has none of them.
        warnings: about what in its log was not plausible, kept in the file's metadata.
    """
    names = columns or (*_STATE, *_COVARIANCE, *_UPDATES, *_BOUNDED, "update_active")
    kept = {b"warnings": json.dumps(list(warnings)).encode()} if warnings else {}
    schema = pa.schema([(name, pa.float64()) for name in names]).with_metadata(
        {_KEY: _SCHEMA} | kept
    )
    with (
        whole_file(path, force) as temporary,
        pq.ParquetWriter(temporary, schema, compression="zstd", write_page_checksum=True) as file,
    ):

        def write(piece: Trajectory) -> None:
            padded = pd.DataFrame({k: pd.Series(v) for k, v in piece.columns().items()})
            values = padded.reindex(columns=list(names)).to_numpy()
            file.write_table(pa.table(list(values.T), schema=schema))

        yield write


def reference(log: Log) -> Trajectory:
    """The log's reference trajectory at the rows with a valid reference (ref_ok), with zero biases.

    A velocity that the log lacks is derived from the positions. Raises LogError where the log has
    no reference.
    """
    log.require("reference")
    rows = np.flatnonzero(log.ref_ok)
    v_GI, zeros = reference_velocity(log)[rows], np.zeros((len(rows), 3))
    return Trajectory(log.t[rows], log.ref_R_GI[rows], v_GI, log.ref_p[rows], zeros, zeros)


def _read_updates(frame: pd.DataFrame) -> UpdateRecord | None:
    # A file written in pieces has all columns that a piece may have.
    frame = frame.dropna(axis="columns", how="all")
    if "update_t" not in frame:
        return None
    frame = pd.DataFrame(frame[frame["update_t"].notna()])
    bounded = "update_pi" in frame
    return UpdateRecord(
        frame["update_t"].to_numpy(),
        _gathered(frame, _columns("update_v")),
        _gathered(frame, _columns("update_epsilon")) if bounded else None,
        frame["update_pi"].to_numpy() if bounded else None,
        frame["update_active"].to_numpy() > 0.5,
    )


def _gathered(frame: pd.DataFrame, names: list[str]) -> np.ndarray:
    return np.ascontiguousarray(frame[names].to_numpy(dtype=float))


def with_mounting(estimate: Trajectory, std: float) -> Trajectory:
    """The same estimate with the covariance for the nominal frame I, to which the IMU is mounted
    with a tolerance; std [rad] of its error d about x and y.

    A filter estimates the attitude R_GS of the axes along which the IMU measures, whose tilt
    gravity reveals. A reference gives the attitude of the nominal frame I in the body, R_GI = R_GS
    exp(-d^), where d is small, constant, and not part of the filter. Alignment cannot remove the
    two components of d across the vertical; it does remove the one about it, as it does yaw.

    Velocity and position are unchanged: p_bar - p = xi_p - [p_bar]x xi_R to first order, so the
    right-invariant error moves by (d_G, [v]x d_G, [p]x d_G) with d_G = R_GI d.
    """
    if estimate.covariance is None or std == 0.0:
        return estimate
    D = std**2 * estimate.R_GI @ ACROSS @ np.swapaxes(estimate.R_GI, 1, 2)
    unit = np.broadcast_to(np.eye(3), D.shape)
    J = np.concatenate([unit, hat(estimate.v_GI), hat(estimate.p_GI)], axis=1)
    covariance = estimate.covariance.copy()
    covariance[:, :9, :9] += J @ D @ np.swapaxes(J, 1, 2)
    return replace(estimate, covariance=covariance)
