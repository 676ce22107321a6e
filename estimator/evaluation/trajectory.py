"""Trajectories, estimated or of a reference, and their files: Parquet and TUM text."""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TextIO

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from surefoot.estimator.evaluation.innovation_sums import InnovationSums
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.files import whole_file
from surefoot.sim.common.limits import admitted, check_unpacked
from surefoot.sim.common.quaternion import matrix_from_quaternion, quaternion_from_matrix
from surefoot.sim.log import Log, reference_velocity

_KEY = b"surefoot_trajectory"
_SCHEMA = b"1"
_UPPER = [(i, j) for i in range(15) for j in range(i, 15)]
_POSE = {"p_GI": "p", "v_GI": "v", "b_a": "b_a", "b_g": "b_g"}
_STATE = (
    "t",
    *(f"q_{c}" for c in "wxyz"),
    *(f"{short}_{c}" for short in _POSE.values() for c in "xyz"),
)
_COLUMNS = (
    *_STATE,
    *(f"cov_{i}_{j}" for i, j in _UPPER),
    "update_t",
    *(f"update_{name}_{c}" for name in ("v", "epsilon") for c in "xyz"),
    "update_pi",
    "update_active",
)


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

    def __post_init__(self):
        n = len(self.t)
        wanted = {"R_GI": (n, 3, 3), "covariance": (n, 15, 15), "t": (n,)}
        for name in ("t", "R_GI", *_POSE, "covariance"):
            value = getattr(self, name)
            if value is not None and np.shape(value) != wanted.get(name, (n, 3)):
                raise TrajectoryError(
                    f"trajectory: {name} has shape {np.shape(value)}, "
                    f"not {wanted.get(name, (n, 3))}"
                )

    @property
    def v_I(self) -> np.ndarray:
        """Velocity (N, 3) [m/s] of the IMU expressed in I."""
        return np.einsum("nij,ni->nj", self.R_GI, self.v_GI)

    def rows(self, which: slice | np.ndarray) -> Trajectory:
        """Select rows by a slice, a mask (N,) or indices. Updates are kept whole."""
        arrays = {name: getattr(self, name)[which] for name in ("t", "R_GI", *_POSE)}
        covariance = None if self.covariance is None else self.covariance[which]
        return replace(self, **arrays, covariance=covariance)

    def write(self, path: str | Path, force: bool = False, warnings: Sequence[str] = ()) -> None:
        """Write one Parquet file, whole or not at all; refuses to overwrite without `force`.

        `warnings`, about what in the log was not plausible, are kept in its metadata.
        """
        with TrajectoryWriter(path, force, tuple(self.columns()), warnings) as file:
            file.write(self)

    def columns(self) -> dict[str, np.ndarray]:
        """Values by the names of a file's columns, see `TrajectoryWriter`."""
        columns = {"t": self.t}
        _spread(columns, "q", quaternion_from_matrix(self.R_GI), "wxyz")
        for name, short in _POSE.items():
            _spread(columns, short, getattr(self, name), "xyz")
        if self.covariance is not None:
            for i, j in _UPPER:
                columns[f"cov_{i}_{j}"] = self.covariance[:, i, j]
        if self.updates is not None:
            columns["update_t"] = self.updates.t
            _spread(columns, "update_v", self.updates.v_I, "xyz")
            if self.updates.epsilon is not None:
                _spread(columns, "update_epsilon", self.updates.epsilon, "xyz")
            if self.updates.pi is not None:
                columns["update_pi"] = self.updates.pi
            columns["update_active"] = self.updates.active.astype(float)
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
        states = pd.DataFrame(frame[frame["t"].notna()])
        q = _gather(states, "q", "wxyz")
        if not np.all(np.abs(np.linalg.norm(q, axis=1) - 1) < 1e-6):
            raise TrajectoryError(f"{path}: q_w..q_z are not unit quaternions")
        covariance = None
        if "cov_0_0" in frame:
            covariance = np.empty((len(states), 15, 15))
            for i, j in _UPPER:
                covariance[:, i, j] = covariance[:, j, i] = states[f"cov_{i}_{j}"]
        vectors: Any = {name: _gather(states, short, "xyz") for name, short in _POSE.items()}
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


class TrajectoryWriter:
    """Writer of a trajectory that comes in pieces, one row group each; the file is whole or absent.

    Columns: t, q_{w,x,y,z}, {p,v,b_a,b_g}_{x,y,z}, the upper triangle cov_<i>_<j>, and for the
    updates update_{t,v_*,epsilon_*,pi,active}; in each row group the shorter of the two is padded
    with NaN. `with TrajectoryWriter(path) as file: file.write(trajectory)`, once per piece;
    `Trajectory.read` returns them as one.
    """

    def __init__(
        self,
        path: str | Path,
        force: bool = False,
        columns: tuple[str, ...] | None = None,
        warnings: Sequence[str] = (),
    ):
        """Prepare a file; nothing is written yet.

        Args:
            path: of the file.
            force: whether to overwrite an existing file; SurefootError otherwise.
            columns: of the file, by default all; NaN where a piece has none of them.
            warnings: about what in its log was not plausible, kept in the file's metadata.
        """
        self._file = whole_file(path, force)
        schema = pa.schema([(name, pa.float64()) for name in columns or _COLUMNS])
        kept = {b"warnings": json.dumps(list(warnings)).encode()} if warnings else {}
        self._schema = schema.with_metadata({_KEY: _SCHEMA} | kept)

    def __enter__(self) -> TrajectoryWriter:
        with ExitStack() as opened:  # a writer that cannot begin leaves no file
            temporary = opened.enter_context(self._file)
            self._writer = pq.ParquetWriter(
                temporary, self._schema, compression="zstd", write_page_checksum=True
            )
            opened.pop_all()
        return self

    def __exit__(self, *error) -> bool | None:
        try:
            self._writer.close()
        except OSError as full:
            return self._file.__exit__(type(full), full, full.__traceback__)
        return self._file.__exit__(*error)

    def write(self, piece: Trajectory) -> None:
        """Append the next piece."""
        columns = piece.columns()
        height = max(len(values) for values in columns.values())
        known = [columns.get(name, np.zeros(0)) for name in self._schema.names]
        arrays = [np.concatenate([x, np.full(height - len(x), np.nan)]) for x in known]
        self._writer.write_table(pa.table(arrays, schema=self._schema))


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
    return UpdateRecord(
        frame["update_t"].to_numpy(),
        _gather(frame, "update_v", "xyz"),
        _gather(frame, "update_epsilon", "xyz") if "update_epsilon_x" in frame else None,
        frame["update_pi"].to_numpy() if "update_pi" in frame else None,
        frame["update_active"].to_numpy() > 0.5,
    )


def _spread(columns: dict, name: str, values: np.ndarray, axes: str) -> None:
    for c, axis in enumerate(axes):
        columns[f"{name}_{axis}"] = values[:, c]


def _gather(frame: pd.DataFrame, name: str, axes: str) -> np.ndarray:
    return np.ascontiguousarray(frame[[f"{name}_{axis}" for axis in axes]].to_numpy(dtype=float))
