"""Validity of a log: its columns, metadata and values. Each fault is one clear line.

The messages name column and row (counted from 0); `sim.log.file` prepends the file. Joints and legs
are those that the columns name: a quadruped's, a biped's, an arm's.
"""

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass, field, fields
from functools import lru_cache
from pathlib import PurePath
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa

from surefoot.sim.common.errors import SurefootError, errors_in
from surefoot.sim.common.limits import check_limit, limits, parse_json
from surefoot.sim.common.toml import SLOWEST_RATE, Count, Name, SampleRate, typed

SCHEMA = 1
KEY = b"surefoot"
DIGEST_KEY = b"surefoot.sha256"
"""Digest of a log's metadata; the pages of values have checksums of their own."""
LEGS = ("FL", "FR", "RL", "RR")
"""A quadruped's legs, in the order of all arrays."""
JOINTS = tuple(f"{leg}_{joint}" for leg in LEGS for joint in ("hip", "thigh", "calf"))
"""A quadruped's joints, in the order of all arrays."""
ALIGNED = "aligned"
"""Name of the file of an aligned log, which keeps its own name (LOG_NAME); others have their
file's.
"""
LOG_NAME = "log_name"
"""Key of a log's `meta.model`: its name in a file that is called ALIGNED."""
_BINARY_PREFIXES = ("contact_", "ref_ok")
_UNIT_TOLERANCE = 1e-5


def _axes(name: str, axes: str = "xyz") -> tuple[str, ...]:
    return tuple(f"{name}_{axis}" for axis in axes)


GROUPS: dict[str, tuple[str, ...]] = {
    "imu": _axes("gyro") + _axes("accel"),
    "gyro": _axes("gyro"),
    "accel": _axes("accel"),
    "q": ("q_<joint>",),
    "dq": ("dq_<joint>",),
    "tau": ("tau_<joint>",),
    "q_des": ("q_des_<joint>",),
    "dq_des": ("dq_des_<joint>",),
    "tau_ff": ("tau_ff_<joint>",),
    "commands": ("q_des_<joint>", "dq_des_<joint>", "tau_ff_<joint>"),
    "contact": ("contact_<leg>",),
    "force": ("force_<leg>",),
    "foot": _axes("foot_<leg>"),
    "force_xyz": _axes("force_<leg>"),
    "reference": _axes("ref_p") + _axes("ref_q", "wxyz"),
    "ref_v": _axes("ref_v"),
    "truth": ("slip_<leg>", "mu_<leg>"),
}
"""Columns by group; a name with <joint> or <leg> means one column for each."""
_PLAIN = {name for names in GROUPS.values() for name in names if "<" not in name} | {"t", "ref_ok"}


def _of_each(placeholder: str) -> tuple[str, ...]:
    names = (name for names in GROUPS.values() for name in names if placeholder in name)
    return tuple(dict.fromkeys(names))


_OF_JOINTS, _OF_LEGS = _of_each("<joint>"), _of_each("<leg>")


@lru_cache(maxsize=128)
def group_columns(group: str, joints: tuple[str, ...], legs: tuple[str, ...]) -> tuple[str, ...]:
    """The columns of a group for these joints and legs; without any, the name with its
    placeholder.
    """
    names = (
        name.replace("<joint>", joint).replace("<leg>", leg)
        for name in GROUPS[group]
        for joint in joints or ("<joint>",)
        for leg in legs or ("<leg>",)
    )
    return tuple(dict.fromkeys(names))


def named_columns(
    prefix: str, values: np.ndarray, parts: Iterable[str] = "xyz"
) -> dict[str, np.ndarray]:
    """Columns `<prefix>_<part>` of values (N, C), one for each of C parts."""
    return {f"{prefix}_{part}": column for part, column in zip(parts, values.T, strict=True)}


def joint_prefix(column: str) -> str | None:
    """Prefix of a joint's column, `q_`, `dq_des_`, ...; None for any other column."""
    found = _pattern(column, _OF_JOINTS)
    return found[0].removesuffix("<joint>") if found else None


def foot_vector(column: str) -> str | None:
    """Group, foot or force_xyz, of a leg's column along an axis; None for any other column."""
    found = _pattern(column, _OF_LEGS)
    return next((g for g in ("foot", "force_xyz") if found and found[0] in GROUPS[g]), None)


def is_column(name: str) -> bool:
    """Whether a log may have a column of this name."""
    is_of_part = _pattern(name, (*_OF_JOINTS, *_OF_LEGS)) is not None
    return is_of_part or name in _PLAIN or name.startswith("x_")


def joint_names(columns: Iterable[str]) -> tuple[str, ...]:
    """Joints with a position column, in the order of the columns."""
    return tuple(name[2:] for name in columns if joint_prefix(name) == "q_")


def leg_names(columns: Iterable[str]) -> tuple[str, ...]:
    """Legs with a contact, or else a force, position or truth; a quadruped's in the order of LEGS,
    else in the order of the columns.
    """
    found = [_pattern(name, _OF_LEGS) for name in columns]
    for pattern in _OF_LEGS:
        legs = tuple(one[1] for one in found if one and one[0] == pattern)
        if legs:
            return LEGS if set(legs) <= set(LEGS) else legs
    return ()


def _pattern(column: str, patterns: tuple[str, ...]) -> tuple[str, str] | None:
    """The most specific matching pattern, and the joint or leg: force_<leg>_x and FL for
    force_FL_x.
    """
    for pattern in sorted(patterns, key=len, reverse=True):
        start, end = pattern.split("<")[0], pattern.split(">")[1]
        part = column[len(start) : len(column) - len(end)]
        if part and column == f"{start}{part}{end}":
            return pattern, part
    return None


@dataclass(frozen=True)
class Meta:
    """Metadata of a log.

    Attributes:
        rate: [Hz].
        schema: version.
        robot: name or file.
        scenario: of a simulation.
        seed: of a simulation.
        effects: declared ones, each a dict of name, target, value, unit.
        motor_law: {"kp": (J,), "kd": (J,)} in N m/rad and N m s/rad.
        derived: columns that were derived.
        versions: of the software.
        model: properties of the robot from an import map, which override the MJCF (p_BI in m, q_BI
            as w, x, y, z, foot_radius in m, feet: body or site by leg), and of its ground
            (ground_evenness in m); `reference_offset`, the clock offset of its reference [s];
            `reference_samples`, the time of its first sample and the interval between them [s];
            `log_name`, its name in a file that is called aligned;
            `file`, the model's file if it has no known name (`sim.robot.catalog`); `ground`,
            if it includes height fields from a file (`sim.ground.ground_metadata`).
        warnings: about what was not plausible on import, one line each (`sim.plausibility`).
    """

    rate: SampleRate
    schema: Count = SCHEMA
    robot: str | None = None
    scenario: str | None = None
    seed: int | None = None
    effects: tuple[dict[str, Any], ...] = ()
    motor_law: dict[str, Any] | None = None
    derived: tuple[str, ...] = ()
    versions: dict[str, Any] = field(default_factory=dict)
    model: dict[str, Any] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Effect:
    name: str
    target: str
    value: float
    unit: str = ""


@dataclass(frozen=True)
class _ModelFile:
    path: str
    sha256: str
    text: str | None = None


@dataclass(frozen=True)
class _Model:
    p_BI: tuple[float, float, float] | None = None
    q_BI: tuple[float, float, float, float] | None = None
    foot_radius: float | tuple[float, ...] | None = None
    ground_evenness: float | None = None
    reference_offset: float | None = None
    reference_samples: tuple[float, float] | None = None
    log_name: Name | None = None
    feet: dict[str, str] | None = None
    file: _ModelFile | None = None

    def __post_init__(self):
        if self.log_name is not None and PurePath(self.log_name).name != self.log_name:
            raise SurefootError(f"{LOG_NAME} is {self.log_name!r}, which is no file's name")
        if self.q_BI and abs(np.linalg.norm(self.q_BI) - 1.0) > _UNIT_TOLERANCE:
            raise SurefootError(f"q_BI is {list(self.q_BI)}, not of unit length")


def check_types(columns: Iterable[tuple[str, object]]) -> None:
    """Raise unless every column is float64 and unique; columns: names, and types as NumPy or Arrow
    has them.
    """
    seen: set[str] = set()
    for name, kind in columns:
        if name in seen:
            raise SurefootError(f"column {name} is there more than once")
        if kind not in (np.float64, pa.float64()):
            raise SurefootError(f"column {name} has type {kind}, not float64")
        seen.add(name)


def metadata_digest(text: bytes) -> bytes:
    """SHA-256 of a log's metadata, as hexadecimal digits."""
    return hashlib.sha256(text).hexdigest().encode()


def read_metadata(metadata: dict[bytes, bytes] | None) -> Meta:
    """Parse the metadata of a Parquet schema, of a log schema no newer than SCHEMA.

    Raises SurefootError, one line with the key, also where they do not match their digest.
    """
    if not metadata or KEY not in metadata:
        raise SurefootError(f"no {KEY.decode()!r} metadata in the Parquet schema; not a log")
    digest = metadata.get(DIGEST_KEY)
    if digest and digest != metadata_digest(metadata[KEY]):
        raise SurefootError("damaged: the metadata do not match their digest")
    values = parse_json(metadata[KEY], "the metadata is ")
    if not isinstance(values, dict):
        raise SurefootError("the metadata is not a JSON object")
    version = values.get("schema")
    if type(version) is int and version > SCHEMA:
        raise SurefootError(
            f"written with log schema {version}, newer than {SCHEMA}: update surefoot to read it"
        )
    with errors_in("metadata"):
        if version is None:
            raise SurefootError("schema is missing")
        meta = typed(values, Meta)
        # A model may have further entries.
        model = {f.name: meta.model[f.name] for f in fields(_Model) if f.name in meta.model}
        typed({"effects": list(meta.effects)}, dict[str, tuple[_Effect, ...]])
        typed({"model": model}, dict[str, _Model])
        return meta


def check_frame(
    frame: pd.DataFrame, rate: float, first_row: int = 0, before: float = -np.inf
) -> None:
    """Raise SurefootError at the first fault of the columns and values of a log.

    Args:
        frame: of the whole log, or of a section of its rows.
        rate: in the metadata [Hz].
        first_row: index of the frame's first row in the log.
        before: time of the row before it [s].
    """
    _check_columns([str(name) for name in frame.columns])
    check_types((str(name), dtype) for name, dtype in frame.dtypes.items())
    if len(frame) == 0:
        raise SurefootError("the log has no rows")
    for name in frame.columns:
        _check_finite(str(name), frame[name].to_numpy(), first_row)
    _check_time(frame["t"].to_numpy(), rate, first_row, before)
    for name in frame.columns:
        if str(name).startswith(_BINARY_PREFIXES):
            _check_binary(str(name), frame[name].to_numpy(), first_row)
    if "ref_q_w" in frame:
        norm = np.linalg.norm(frame[list(_axes("ref_q", "wxyz"))].to_numpy(), axis=1)
        bad = np.flatnonzero(np.abs(norm - 1.0) > _UNIT_TOLERANCE)
        if bad.size:
            row = bad[0]
            raise SurefootError(
                f"columns ref_q_w..z, row {first_row + row}: not a unit quaternion "
                f"(norm {norm[row]:.6g})"
            )


def _check_columns(names: list[str]) -> None:
    seen = set(names)
    if "t" not in seen:
        raise SurefootError("column t is missing")
    for name in names:
        if not is_column(name):
            raise SurefootError(f"unknown column {name} (a column of your own is named x_<name>)")
    legs = leg_names(names)
    for group in ("imu", "reference", "ref_v", "foot", "force_xyz"):
        wanted = group_columns(group, (), legs)
        missing = [name for name in wanted if name not in seen]
        if missing and len(missing) < len(wanted):
            raise SurefootError(f"column {missing[0]} is missing")
    if seen & {"ref_ok", *GROUPS["ref_v"]} and "ref_p_x" not in seen:
        raise SurefootError("column ref_p_x is missing beside the other reference columns")
    _check_each(names, _OF_JOINTS, joint_names(names), "q_<joint>")
    first = (p for p in _OF_LEGS if legs and p.replace("<leg>", legs[0]) in seen)
    _check_each(names, _OF_LEGS, legs, next(first, "contact_<leg>"))


def _check_each(
    names: list[str], patterns: tuple[str, ...], parts: tuple[str, ...], first: str
) -> None:
    """Raise unless all joints or legs have the same columns; `parts` are those with `first`."""
    found = [_pattern(name, patterns) for name in names]
    for pattern in patterns:
        start, end = pattern.split("<")[0], pattern.split(">")[1]
        there = [one[1] for one in found if one and one[0] == pattern]
        for part in there:
            if part not in parts:
                needed = f"{first.split('<')[0]}{part}{first.split('>')[1]}"
                raise SurefootError(f"column {needed} is missing beside {start}{part}{end}")
        for part in parts:
            if there and part not in there:
                raise SurefootError(f"column {start}{part}{end} is missing")


def _check_finite(name: str, values: np.ndarray, first_row: int) -> None:
    bad = ~np.isfinite(values)
    if not bad.any():
        most = np.inf if name.startswith("x_") else limits().magnitude
        if len(values) and max(values.max(), -values.min()) > most:
            row = int(np.argmax(np.abs(values) > most))
            raise SurefootError(
                f"column {name}, row {first_row + row}: {values[row]:.3g} is beyond {most:g}"
            )
        return
    row = int(np.argmax(bad))
    after = bad[row:]
    run = len(after) if after.all() else int(np.argmin(after))
    what = "NaN" if np.isnan(values[row]) else "infinite"
    raise SurefootError(
        f"column {name}, row {first_row + row}: {what}, for {run} row{'s' if run > 1 else ''}"
    )


def _check_time(t: np.ndarray, rate: float, first_row: int, before: float) -> None:
    step = np.diff(t, prepend=before)
    bad = np.flatnonzero(step <= 0.0)
    if bad.size:
        row = bad[0]
        how = "stops" if step[row] == 0.0 else f"jumps back by {-step[row]:.6g} s"
        raise SurefootError(f"column t, row {first_row + row}: time {how} at {t[row]:.6f} s")
    if len(t) > 1:
        actual = 1.0 / float(np.median(step[1:]))
        if actual < SLOWEST_RATE:
            raise SurefootError(
                f"column t runs at {actual:.3g} Hz, as if it were in us or ns: it is in s"
            )
        if not 0.5 < actual / rate < 2.0:
            raise SurefootError(f"column t runs at {actual:.6g} Hz, the metadata says {rate:.6g}")
        # Computations at even times would otherwise need more of them than rows.
        check_limit("walk", t[-1] - t[0] - 2.0 * len(t) / rate, "column t: seconds without rows")


def _check_binary(name: str, values: np.ndarray, first_row: int) -> None:
    bad = np.flatnonzero((values != 0.0) & (values != 1.0))
    if bad.size:
        row = bad[0]
        raise SurefootError(
            f"column {name}, row {first_row + row}: {values[row]:.6g} is not 0 or 1"
        )
