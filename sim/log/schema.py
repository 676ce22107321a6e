"""What makes a log valid: its columns, its metadata, its numbers. Each fault is one clear line.

The messages name column and row (counted from 0); `sim.log.log` puts the file in front.
"""

import json
from collections.abc import Iterable
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa

from surefoot.sim.common.errors import SurefootError

LEGS = ("FL", "FR", "RL", "RR")
JOINTS = tuple(f"{leg}_{joint}" for leg in LEGS for joint in ("hip", "thigh", "calf"))
_JOINT_PREFIXES = ("q_des_", "dq_des_", "tau_ff_", "q_", "dq_", "tau_")
_BINARY_PREFIXES = ("contact_", "ref_ok")
_UNIT_TOLERANCE = 1e-5


def _axes(name: str, axes: str = "xyz") -> tuple[str, ...]:
    return tuple(f"{name}_{axis}" for axis in axes)


def _legs(name: str) -> tuple[str, ...]:
    return tuple(f"{name}_{leg}" for leg in LEGS)


# A name that ends in an underscore stands for one column a joint.
GROUPS: dict[str, tuple[str, ...]] = {
    "imu": _axes("gyro") + _axes("accel"),
    "q": ("q_",),
    "dq": ("dq_",),
    "tau": ("tau_",),
    "q_des": ("q_des_",),
    "dq_des": ("dq_des_",),
    "tau_ff": ("tau_ff_",),
    "commands": ("q_des_", "dq_des_", "tau_ff_"),
    "contact": _legs("contact"),
    "force": _legs("force"),
    "reference": _axes("ref_p") + _axes("ref_q", "wxyz"),
    "ref_v": _axes("ref_v"),
    "truth": _legs("slip") + _legs("mu"),
}
_WHOLE = ("imu", "contact", "force", "reference", "ref_v")

# Metadata: key -> the JSON types it may have, and whether it must be there.
_METADATA: dict[str, tuple[tuple[type, ...], bool]] = {
    "schema": ((int,), True),
    "rate": ((int, float), True),
    "robot": ((str, type(None)), False),
    "scenario": ((str, type(None)), False),
    "seed": ((int, type(None)), False),
    "effects": ((list,), False),
    "motor_law": ((dict, type(None)), False),
    "derived": ((list,), False),
    "versions": ((dict,), False),
    "model": ((dict,), False),
}


def joint_prefix(column: str) -> str | None:
    """`q_`, `dq_des_`, ... of a joint's column; None for any other column."""
    for prefix in _JOINT_PREFIXES:
        if column.startswith(prefix) and len(column) > len(prefix):
            return prefix
    return None


def joint_names(columns: Iterable[str]) -> tuple[str, ...]:
    """The joints that have a position column, in the order of the columns."""
    near = [name for name in columns if name.startswith("q_")]
    return tuple(name[2:] for name in near if joint_prefix(name) == "q_")


def check_table(schema: pa.Schema) -> None:
    """Raise unless every column of the Parquet schema is float64."""
    for column in schema:
        if column.type != pa.float64():
            raise SurefootError(f"column {column.name} has type {column.type}, not float64")


def check_metadata(metadata: dict[bytes, bytes], key: bytes, schema: int) -> dict[str, Any]:
    """The metadata under `key`, of a schema no newer than `schema`, as a checked dictionary."""
    if key not in metadata:
        raise SurefootError(f"no {key.decode()!r} metadata in the Parquet schema; not a log")
    try:
        values = json.loads(metadata[key])
    except ValueError as error:
        raise SurefootError(f"the metadata is not JSON ({error})") from error
    if not isinstance(values, dict):
        raise SurefootError("the metadata is not a JSON object")
    version = values.get("schema")
    if type(version) is int and version > schema:
        raise SurefootError(
            f"written with log schema {version}, newer than {schema}: update surefoot to read it"
        )
    for name, (types, required) in _METADATA.items():
        if name not in values:
            if required:
                raise SurefootError(f"metadata key {name!r} is missing")
        elif type(values[name]) not in types:
            raise SurefootError(f"metadata key {name!r} is a {type(values[name]).__name__}")
    unknown = sorted(set(values) - set(_METADATA))
    if unknown:
        raise SurefootError(f"unknown metadata key {unknown[0]!r}")
    if values["schema"] < 1:
        raise SurefootError(f"metadata key 'schema' is {values['schema']}")
    if not 0.0 < values["rate"] < np.inf:
        raise SurefootError(f"metadata key 'rate' is {values['rate']}, not a rate in Hz")
    for name, kind in (("effects", dict), ("derived", str)):
        if not all(isinstance(item, kind) for item in values.get(name, ())):
            raise SurefootError(f"metadata key {name!r} holds something else than {kind.__name__}")
    for effect in values.get("effects", ()):
        kinds = {"name": (str,), "target": (str,), "value": (int, float)}
        if any(type(effect.get(key)) not in kind for key, kind in kinds.items()):
            raise SurefootError("metadata key 'effects' holds one without name, target or value")
    _check_model(values.get("model", {}))
    return values


def _check_model(model: dict[str, Any]) -> None:
    """Raise unless what the metadata say of the robot are numbers of the right shape."""
    known = {"p_BI": ((3,),), "q_BI": ((4,),), "foot_radius": ((), (4,)), "ground_evenness": ((),)}
    for name, shapes in known.items():
        try:
            value = np.array(model.get(name, np.ones(shapes[0])), dtype=float)
        except (TypeError, ValueError):
            value = np.array(np.nan)
        if value.shape not in shapes or not np.isfinite(value).all():
            raise SurefootError(f"metadata key 'model': {name} is {model[name]!r}")
    if "q_BI" in model and abs(np.linalg.norm(model["q_BI"]) - 1.0) > _UNIT_TOLERANCE:
        raise SurefootError(f"metadata key 'model': q_BI is {model['q_BI']!r}, not of unit length")


def check_frame(frame: pd.DataFrame, rate: float) -> None:
    """Raise SurefootError at the first fault of the columns and numbers of a log."""
    _check_columns([str(name) for name in frame.columns])
    for name, dtype in frame.dtypes.items():
        if dtype != np.float64:
            raise SurefootError(f"column {name} has type {dtype}, not float64")
    if len(frame) == 0:
        raise SurefootError("the log has no rows")
    for name in frame.columns:
        _check_finite(str(name), frame[name].to_numpy())
    _check_time(frame["t"].to_numpy(), rate)
    for name in frame.columns:
        if str(name).startswith(_BINARY_PREFIXES):
            _check_binary(str(name), frame[name].to_numpy())
    if "ref_q_w" in frame:
        norm = np.linalg.norm(frame[list(_axes("ref_q", "wxyz"))].to_numpy(), axis=1)
        bad = np.flatnonzero(np.abs(norm - 1.0) > _UNIT_TOLERANCE)
        if bad.size:
            row = bad[0]
            raise SurefootError(
                f"columns ref_q_w..z, row {row}: not a unit quaternion (norm {norm[row]:.6g})"
            )


def _check_columns(names: list[str]) -> None:
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise SurefootError(f"column {name} is there more than once")
        seen.add(name)
    if "t" not in seen:
        raise SurefootError("column t is missing")
    groups = {name for columns in GROUPS.values() for name in columns if not name.endswith("_")}
    for name in names:
        known = name in groups or name in ("t", "ref_ok") or name.startswith("x_")
        if not known and joint_prefix(name) is None:
            raise SurefootError(f"unknown column {name} (a column of your own is named x_<name>)")
    for group in _WHOLE:
        _check_whole(GROUPS[group], seen)
    for name in ("slip", "mu"):
        _check_whole(_legs(name), seen)
    if seen & {"ref_ok", *GROUPS["ref_v"]} and "ref_p_x" not in seen:
        raise SurefootError("column ref_p_x is missing beside the other reference columns")
    joints = joint_names(names)
    for prefix in _JOINT_PREFIXES:
        own = [name.removeprefix(prefix) for name in names if joint_prefix(name) == prefix]
        for joint in own:
            if joint not in joints:
                raise SurefootError(f"column q_{joint} is missing beside {prefix}{joint}")
        for joint in joints:
            if own and joint not in own:
                raise SurefootError(f"column {prefix}{joint} is missing")


def _check_whole(columns: tuple[str, ...], seen: set[str]) -> None:
    missing = [name for name in columns if name not in seen]
    if missing and len(missing) < len(columns):
        raise SurefootError(f"column {missing[0]} is missing")


def _check_finite(name: str, values: np.ndarray) -> None:
    bad = ~np.isfinite(values)
    if not bad.any():
        return
    row = int(np.argmax(bad))
    after = bad[row:]
    run = len(after) if after.all() else int(np.argmin(after))
    what = "NaN" if np.isnan(values[row]) else "infinite"
    raise SurefootError(f"column {name}, row {row}: {what}, for {run} row{'s' if run > 1 else ''}")


def _check_time(t: np.ndarray, rate: float) -> None:
    step = np.diff(t)
    bad = np.flatnonzero(step <= 0.0)
    if bad.size:
        row = bad[0] + 1
        how = "stops" if step[row - 1] == 0.0 else f"jumps back by {-step[row - 1]:.6g} s"
        raise SurefootError(f"column t, row {row}: time {how} at {t[row]:.6f} s")
    if step.size:
        actual = 1.0 / float(np.median(step))
        if not 0.5 < actual / rate < 2.0:
            raise SurefootError(f"column t runs at {actual:.6g} Hz, the metadata says {rate:.6g}")


def _check_binary(name: str, values: np.ndarray) -> None:
    bad = np.flatnonzero((values != 0.0) & (values != 1.0))
    if bad.size:
        raise SurefootError(f"column {name}, row {bad[0]}: {values[bad[0]]:.6g} is not 0 or 1")
