"""The Log: one walk as one Parquet file, the only thing that is passed between the rooms.

A row holds gyro and accel as their mean over (t[k-1], t[k]], and joints, contacts and reference at
t[k]: a filter predicts over row k, then updates with row k. `sim.log.schema` says what is valid.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.files import whole_file
from surefoot.sim.common.quaternion import matrix_from_quaternion
from surefoot.sim.log.schema import (
    GROUPS,
    JOINTS,
    LEGS,
    check_frame,
    check_metadata,
    check_table,
    joint_names,
)

SCHEMA = 1
KEY = b"surefoot"


class LogError(SurefootError):
    """A log that cannot be read, or that lacks what was asked of it."""


@dataclass(frozen=True)
class Meta:
    """What a log says of itself.

    `rate` is in Hz. `effects` are the declared ones, each a dict of name, target, value, unit.
    `motor_law` is {"kp": (J,), "kd": (J,)} in N m/rad and N m s/rad. `model` is what an import map
    says of the robot (p_BI in m, q_BI as w, x, y, z, foot_radius in m), which overrides the MJCF,
    and of its ground (ground_evenness in m).
    """

    rate: float
    schema: int = SCHEMA
    robot: str | None = None
    scenario: str | None = None
    seed: int | None = None
    effects: tuple[dict[str, Any], ...] = ()
    motor_law: dict[str, Any] | None = None
    derived: tuple[str, ...] = ()
    versions: dict[str, str] = field(default_factory=dict)
    model: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Log:
    """One walk: `frame` has a float64 column each (`t`, `gyro_x`, `q_FL_hip` ...), a row a sample.

    The properties give fresh contiguous arrays in SI units; each raises LogError where its columns
    are missing. J joints in canonical order (leg-major over FL, FR, RL, RR), so a quadruped's
    `q.reshape(N, 4, 3)` is (row, leg, joint).
    """

    frame: pd.DataFrame
    meta: Meta
    name: str = "log"

    @classmethod
    def read(cls, path: str | Path) -> Log:
        """The log at `path`. Raises LogError, one line with file, column and row, if not valid."""
        path = Path(path)
        table = _read_table(path)
        try:
            check_table(table.schema)
            values = check_metadata(table.schema.metadata or {}, KEY, SCHEMA)
            columns = {name: table[name].to_numpy() for name in table.column_names}
            frame = pd.DataFrame(columns)
            check_frame(frame, values["rate"])
        except SurefootError as error:
            raise LogError(f"{path}: {error}") from error
        for name in ("effects", "derived"):
            if name in values:
                values[name] = tuple(values[name])
        return cls(frame, Meta(**values), path.stem)

    def write(self, path: str | Path, force: bool = False) -> None:
        """Write the whole file or none. Raises LogError if it exists (no `force`) or is invalid."""
        path = Path(path)
        try:
            text = json.dumps(asdict(self.meta), default=_plain, allow_nan=False, sort_keys=True)
            check_metadata({KEY: text.encode()}, KEY, SCHEMA)
            check_frame(self.frame, self.meta.rate)
        except (SurefootError, TypeError, ValueError) as error:
            raise LogError(f"{path}: not written, {error}") from error
        columns = {str(name): pa.array(self.frame[name].to_numpy()) for name in self.frame}
        table = pa.table(columns).replace_schema_metadata({KEY: text.encode()})
        try:
            with whole_file(path, force) as temporary:
                pq.write_table(table, temporary, compression="zstd", write_page_checksum=True)
        except SurefootError as error:
            raise LogError(str(error)) from error

    def rows(self, which: slice | np.ndarray) -> Log:
        """The log of some rows: a slice (a step divides the rate), a mask (N,) or row indices."""
        step = which.step or 1 if isinstance(which, slice) else 1
        frame = self.frame.iloc[which].reset_index(drop=True)
        return replace(self, frame=frame, meta=replace(self.meta, rate=self.meta.rate / step))

    def has(self, group: str) -> bool:
        """Whether every column of a group is there (see `require` for the groups)."""
        return not self._missing(group)

    def require(self, *groups: str) -> None:
        """Raise LogError naming the groups and columns that are missing.

        Groups: imu, q, dq, tau, commands (or q_des, dq_des, tau_ff one by one), contact, force,
        reference, ref_v, truth.
        """
        missing = {group: self._missing(group) for group in groups}
        lacking = [f"{group} ({_shorten(names)})" for group, names in missing.items() if names]
        if lacking:
            raise LogError(f"{self.name}: the log lacks {', '.join(lacking)}")

    def _missing(self, group: str) -> list[str]:
        if group not in GROUPS:
            raise KeyError(f"no log group {group!r}; groups are {', '.join(GROUPS)}")
        names: list[str] = []
        for name in GROUPS[group]:
            if not name.endswith("_"):
                names.append(name)
            elif self.joints:
                names.extend(name + joint for joint in self.joints)
            else:
                names.append(name + "<joint>")
        return [name for name in names if name not in self.frame]

    def _array(self, group: str, names: Sequence[str]) -> np.ndarray:
        self.require(group)
        # Column by column: pandas takes several times as long to select them together.
        return np.column_stack([self.frame[name].to_numpy(dtype=float) for name in names])

    def _joint_array(self, prefix: str) -> np.ndarray:
        return self._array(prefix, [f"{prefix}_{joint}" for joint in self.joints])

    @cached_property
    def joints(self) -> tuple[str, ...]:
        """Joint names, canonical for a quadruped, else in the order of the columns."""
        names = joint_names(self.frame.columns)
        return JOINTS if set(names) == set(JOINTS) else names

    @property
    def rate(self) -> float:
        """Nominal sampling rate, Hz."""
        return self.meta.rate

    @property
    def t(self) -> np.ndarray:
        """Time (N,), s, strictly increasing."""
        return np.array(self.frame["t"], dtype=float)

    @property
    def gyro(self) -> np.ndarray:
        """Angular velocity (N, 3) in I, rad/s, mean over the sample."""
        return self._array("imu", [f"gyro_{axis}" for axis in "xyz"])

    @property
    def accel(self) -> np.ndarray:
        """Specific force (N, 3) in I, m/s^2, mean over the sample."""
        return self._array("imu", [f"accel_{axis}" for axis in "xyz"])

    @property
    def q(self) -> np.ndarray:
        """Joint positions (N, J), rad."""
        return self._joint_array("q")

    @property
    def dq(self) -> np.ndarray:
        """Joint velocities (N, J), rad/s, as logged; `joint_velocity` derives missing ones."""
        return self._joint_array("dq")

    @property
    def tau(self) -> np.ndarray:
        """Joint torques (N, J), N m."""
        return self._joint_array("tau")

    @property
    def q_des(self) -> np.ndarray:
        """Commanded joint positions (N, J), rad."""
        return self._joint_array("q_des")

    @property
    def dq_des(self) -> np.ndarray:
        """Commanded joint velocities (N, J), rad/s."""
        return self._joint_array("dq_des")

    @property
    def tau_ff(self) -> np.ndarray:
        """Feed-forward joint torques (N, J), N m."""
        return self._joint_array("tau_ff")

    @property
    def contact(self) -> np.ndarray:
        """Feet in contact (N, 4), bool, as the robot senses it."""
        return self._array("contact", [f"contact_{leg}" for leg in LEGS]) > 0.5

    @property
    def force(self) -> np.ndarray:
        """Foot force (N, 4), raw, in the sensor's own unit."""
        return self._array("force", [f"force_{leg}" for leg in LEGS])

    @property
    def ref_p(self) -> np.ndarray:
        """Reference position p_GI (N, 3), m."""
        return self._array("reference", [f"ref_p_{axis}" for axis in "xyz"])

    @property
    def ref_q(self) -> np.ndarray:
        """Reference attitude (N, 4) of I in G as w, x, y, z."""
        return self._array("reference", [f"ref_q_{axis}" for axis in "wxyz"])

    @property
    def ref_R_GI(self) -> np.ndarray:
        """Reference attitude (N, 3, 3)."""
        return matrix_from_quaternion(self.ref_q)

    @property
    def ref_v(self) -> np.ndarray:
        """Reference velocity v_GI (N, 3), m/s; `reference_velocity` derives a missing one."""
        return self._array("ref_v", [f"ref_v_{axis}" for axis in "xyz"])

    @property
    def ref_ok(self) -> np.ndarray:
        """Rows (N,), bool, whose reference was measured and not interpolated over a gap."""
        self.require("reference")
        if "ref_ok" not in self.frame:
            return np.ones(len(self.frame), dtype=bool)
        return np.array(self.frame["ref_ok"] > 0.5)

    @property
    def slip(self) -> np.ndarray:
        """Truth: speed (N, 4) of each loaded foot over the ground, m/s."""
        return self._array("truth", [f"slip_{leg}" for leg in LEGS])

    @property
    def mu(self) -> np.ndarray:
        """Truth: friction coefficient (N, 4) under each foot."""
        return self._array("truth", [f"mu_{leg}" for leg in LEGS])


def _read_table(path: Path) -> pa.Table:
    if not path.is_file():
        raise LogError(f"{path}: {'is a folder' if path.is_dir() else 'no such file'}")
    try:
        with pq.ParquetFile(path, page_checksum_verification=True) as file:
            names = file.schema_arrow.names
            twice = sorted({name for name in names if names.count(name) > 1})
            if not twice:
                return file.read(use_threads=False)
    except (pa.ArrowException, OSError, ValueError, OverflowError, MemoryError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise LogError(f"{path}: not a whole Parquet file, truncated? ({reason})") from error
    raise LogError(f"{path}: column {twice[0]} is there more than once")


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"metadata holds a {type(value).__name__}, which JSON does not")


def _shorten(names: list[str]) -> str:
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
