"""The Log: one walk as one Parquet file, the only data passed between the packages.

A row holds gyro and accel as means over (t[k-1], t[k]], and joints, contacts and reference at t[k]:
a filter predicts over row k, then updates with row k. `sim.log.schema` defines what is valid.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
import pandas as pd

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.files import whole_file
from surefoot.sim.common.quaternion import matrix_from_quaternion
from surefoot.sim.log.file import LogError, LogReader, LogWriter
from surefoot.sim.log.schema import (
    ALIGNED,
    GROUPS,
    JOINTS,
    LOG_NAME,
    Meta,
    group_columns,
    joint_names,
    leg_names,
)

T = TypeVar("T")


class _Columns:
    """A property of a log: its columns (N, C) of a group whose names begin with `prefix`."""

    def __init__(self, group: str, prefix: str = ""):
        self._group, self._prefix = group, prefix

    def __get__(self, log: Log, _owner: type) -> np.ndarray:
        names = [name for name in log._names(self._group) if name.startswith(self._prefix)]
        return log._stacked(self._group, names)


@dataclass(frozen=True)
class Log:
    """One walk: `frame` has float64 columns (`t`, `gyro_x`, `q_FL_hip` ...) and one row per sample.

    The properties return new contiguous arrays in SI units; each raises LogError where its columns
    are missing. J and L are the numbers of joints and legs that the columns name. A quadruped's are
    in canonical order (leg by leg over FL, FR, RL, RR), so that `q.reshape(N, 4, 3)` is (row, leg,
    joint). A `MemoisedLog` of a log computes each array once.
    """

    frame: pd.DataFrame
    meta: Meta
    name: str = "log"

    @classmethod
    def read(cls, path: str | Path) -> Log:
        """Read the log at `path`. Raises LogError, one line with file, column and row, if not
        valid.
        """
        (log,) = cls.chunks(LogReader(path))
        return log

    @classmethod
    def chunks(cls, reader: LogReader, seconds: float = np.inf) -> Iterator[Log]:
        """The log of a file in pieces of about `seconds`, by default all rows in one.

        Raises LogError, one line with file, column and row, at the first fault.
        """
        name = reader.path.stem
        if name == ALIGNED:
            name = reader.meta.model.get(LOG_NAME, name)
        for frame in reader.frames(seconds):
            yield Log(frame, reader.meta, name)

    def write(self, path: str | Path, force: bool = False) -> None:
        """Write the whole file or none. Raises LogError if it exists (without `force`) or is
        invalid.
        """
        path = Path(path)
        try:
            with whole_file(path, force) as temporary, LogWriter(temporary, self.meta) as writer:
                writer.write(self.frame)
        except LogError as error:
            raise LogError(f"{path}: not written, {error}") from error
        except SurefootError as error:
            raise LogError(str(error)) from error

    def with_columns(self, columns: Mapping[str, np.ndarray]) -> Log:
        """The log with some columns replaced or added, and a frame of its own."""
        return replace(self, frame=self.frame.assign(**columns))

    def once(self, what: str, uses: Iterable[str], make: Callable[[], T], *given: Any) -> T:
        """A value derived from the log, which a `MemoisedLog` computes once.

        Args:
            what: its name, unique for this log.
            uses: groups (see `require`) and single columns that it depends on, besides time.
            make: computes it.
            given: other objects that it depends on; it is recomputed if these are not identical.
        """
        return make()

    def rows(self, which: slice | np.ndarray) -> Log:
        """Select rows by a slice (a step divides the rate), a mask (N,) or indices."""
        step = which.step or 1 if isinstance(which, slice) else 1
        frame = self.frame.iloc[which].reset_index(drop=True)
        return replace(self, frame=frame, meta=replace(self.meta, rate=self.meta.rate / step))

    def has(self, group: str) -> bool:
        """Whether every column of a group is present (see `require` for the groups)."""
        return not self._missing(group)

    def require(self, *groups: str) -> None:
        """Raise LogError naming the groups and columns that are missing.

        Groups: imu (or gyro, accel individually), q, dq, tau, commands (or q_des, dq_des, tau_ff
        individually), contact, force, foot, force_xyz, reference, ref_v, truth; a column `x_<name>`
        is a group by itself.
        """
        missing = {group: self._missing(group) for group in groups}
        lacking = [f"{group} ({_shorten(names)})" for group, names in missing.items() if names]
        if lacking:
            raise LogError(f"{self.name}: the log lacks {', '.join(lacking)}")

    def _missing(self, group: str) -> list[str]:
        if group not in GROUPS and not group.startswith("x_"):
            raise KeyError(f"no log group {group!r}; groups are {', '.join(GROUPS)}")
        return [name for name in self._names(group) if name not in self.columns]

    def _names(self, group: str) -> Sequence[str]:
        """The columns of a group; any other name is a column's own."""
        return group_columns(group, self.joints, self.legs) if group in GROUPS else (group,)

    def _stacked(self, group: str, names: Sequence[str]) -> np.ndarray:
        def stacked() -> np.ndarray:
            self.require(group)
            if any(np.iscomplexobj(self.columns[name]) for name in names):
                raise LogError(f"{self.name}: {names[0]}, ... are complex numbers, not real ones")
            # Column by column: selecting them together takes pandas several times as long.
            return np.column_stack([np.asarray(self.columns[n], dtype=float) for n in names])

        return self.once(names[0], names, stacked)

    def _leg_vectors(self, group: str, prefix: str) -> np.ndarray:
        names = [f"{prefix}_{leg}_{axis}" for leg in self.legs for axis in "xyz"]
        return self._stacked(group, names).reshape(-1, len(self.legs), 3)

    @cached_property
    def columns(self) -> dict[str, np.ndarray]:
        """The frame's columns (N,) by name, not to be written to."""
        return {str(name): self.frame[name].to_numpy() for name in self.frame}

    @cached_property
    def joints(self) -> tuple[str, ...]:
        """Joint names, canonical for a quadruped, else in the order of the columns."""
        names = joint_names(self.columns)
        return JOINTS if set(names) == set(JOINTS) else names

    @cached_property
    def legs(self) -> tuple[str, ...]:
        """Leg names, FL, FR, RL, RR for a quadruped, else in the order of the columns."""
        return leg_names(self.columns)

    @property
    def rate(self) -> float:
        """Nominal sampling rate, Hz."""
        return self.meta.rate

    @property
    def t(self) -> np.ndarray:
        """Time (N,), s, strictly increasing."""
        return self.once("t", (), lambda: np.array(self.columns["t"], dtype=float))

    gyro = _Columns("imu", "gyro_")
    """Angular velocity (N, 3) in I, rad/s, mean over the sample."""

    accel = _Columns("imu", "accel_")
    """Specific force (N, 3) in I, m/s^2, mean over the sample."""

    q = _Columns("q")
    """Joint positions (N, J), rad."""

    dq = _Columns("dq")
    """Joint velocities (N, J), rad/s, as logged; `joint_velocity` derives missing ones."""

    tau = _Columns("tau")
    """Joint torques (N, J), N m."""

    q_des = _Columns("q_des")
    """Commanded joint positions (N, J), rad."""

    dq_des = _Columns("dq_des")
    """Commanded joint velocities (N, J), rad/s."""

    tau_ff = _Columns("tau_ff")
    """Feed-forward joint torques (N, J), N m."""

    _contact = _Columns("contact")

    @property
    def contact(self) -> np.ndarray:
        """Feet in contact (N, L), bool, as the robot senses it."""
        return self.once("contact", ["contact"], lambda: self._contact > 0.5)

    force = _Columns("force")
    """Foot force (N, L), raw, in the sensor's own unit."""

    @property
    def foot_I(self) -> np.ndarray:
        """Foot positions (N, L, 3) in I, m, where the robot gives them."""
        return self._leg_vectors("foot", "foot")

    @property
    def force_I(self) -> np.ndarray:
        """Forces (N, L, 3) of the ground on the feet in I, N."""
        return self._leg_vectors("force_xyz", "force")

    ref_p = _Columns("reference", "ref_p_")
    """Reference position p_GI (N, 3), m."""

    ref_q = _Columns("reference", "ref_q_")
    """Reference attitude (N, 4) of I in G as w, x, y, z."""

    @property
    def ref_R_GI(self) -> np.ndarray:
        """Reference attitude (N, 3, 3)."""
        return self.once("ref_R_GI", ["reference"], lambda: matrix_from_quaternion(self.ref_q))

    ref_v = _Columns("ref_v")
    """Reference velocity v_GI (N, 3), m/s; `reference_velocity` derives a missing one."""

    @property
    def ref_ok(self) -> np.ndarray:
        """Rows (N,), bool, with a measured reference, not one interpolated over a gap."""
        self.require("reference")
        if "ref_ok" not in self.columns:
            return np.ones(len(self.columns["t"]), dtype=bool)
        return self.columns["ref_ok"] > 0.5

    slip = _Columns("truth", "slip_")
    """Truth: speed (N, L) of each loaded foot over the ground, m/s."""

    mu = _Columns("truth", "mu_")
    """Truth: friction coefficient (N, L) under each foot."""


class MemoisedLog(Log):
    """A log that computes its arrays, and whatever else is derived from it, once.

    They must not be written to. With other columns (`with_columns`), the view keeps all that does
    not depend on these.
    """

    def __init__(self, frame: pd.DataFrame, meta: Meta, name: str = "log"):
        super().__init__(frame, meta, name)
        self._derived: dict[str, _Derived] = {}

    @classmethod
    def of(cls, log: Log) -> MemoisedLog:
        """A view of this log."""
        return cls(log.frame, log.meta, log.name)

    @property
    def frame(self) -> pd.DataFrame:
        # Assigned on first use, since most views need none.
        if self._replaced:
            self._frame, self._replaced = self._frame.assign(**self._replaced), {}
        return self._frame

    @frame.setter
    def frame(self, frame: pd.DataFrame):  # pyright: ignore[reportIncompatibleVariableOverride]
        self._frame, self._replaced = frame, {}

    def with_columns(self, columns: Mapping[str, np.ndarray]) -> MemoisedLog:
        view = MemoisedLog(self._frame.copy(deep=False), self.meta, self.name)
        view._replaced = self._replaced | {name: np.asarray(x) for name, x in columns.items()}
        # Unchanged columns remain the same arrays, so comparisons can go by identity.
        view.columns = self.columns | view._replaced
        if self.columns.keys() >= columns.keys():
            view.joints, view.legs = self.joints, self.legs
        view._derived = {k: x for k, x in self._derived.items() if x.columns.isdisjoint(columns)}
        return view

    def once(self, what: str, uses: Iterable[str], make: Callable[[], T], *given: Any) -> T:
        found = self._derived.get(what)
        if found is None or not all(a is b for a, b in zip(found.given, given, strict=True)):
            columns = frozenset(("t", *(name for one in uses for name in self._names(one))))
            self._derived[what] = found = _Derived(columns, given, make())
        return found.value


class _Derived(NamedTuple):
    """A derived value, with the columns and objects that it depends on."""

    columns: frozenset[str]
    given: tuple[Any, ...]
    value: Any


def _shorten(names: list[str]) -> str:
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
