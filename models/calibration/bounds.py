"""Bounds: the calibrated statement of an observer's errors, P(|e| <= epsilon) >= gamma."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from surefoot.models.calibration.bias_model import BiasModel
from surefoot.models.calibration.conformal import BoundsError
from surefoot.models.calibration.mixing import Mixing
from surefoot.models.observer.observer import Observer
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.files import whole_file
from surefoot.sim.common.limits import bounded_json
from surefoot.sim.common.quaternion import check_rotation

BOUNDS_FORMAT = "surefoot bounds"
BOUNDS_SCHEMA = 2
"""2: with a digest of what they say. Those of surefoot 0.1.0 are of schema 1, without one."""


@dataclass(frozen=True, eq=False)
class Bounds:
    """A calibrated coverage statement (paper, Eq. coverage_statement).

    epsilon (3,), m/s: of |v_I predicted - v_I| by axis, in the frame of an IMU mounted as R_BI
    (3, 3) says. gamma is the joint level, level_per_axis the one that each axis alone was ranked
    at: its cube root for the `conformal` method, gamma itself for one that bounds the axes jointly.
    n samples, K steps of 10 ms apart, came from `log`; `observer` is the hash of the observer they
    hold for. `mixing` is the curve behind K, None where K was given; `confidence` is that of
    `scenario` bounds over calibrations, None where the statement is about the mean of them.
    `persistent` is the persistent part of the errors, None of a log too short for it and in files
    from before it was estimated. `warnings` are what in the log was not plausible.
    """

    epsilon: np.ndarray
    gamma: float
    level_per_axis: float
    method: str
    K: int
    n: int
    observer: str
    R_BI: np.ndarray
    log: str
    mixing: Mixing | None = None
    confidence: float | None = None
    persistent: BiasModel | None = None
    warnings: tuple[str, ...] = ()

    def check_observer(self, observer: Observer) -> None:
        """Raise BoundsError where these bounds were calibrated for another observer."""
        if observer.hash != self.observer:
            raise BoundsError(
                f"the bounds belong to observer {self.observer[:12]}, not to {observer.hash[:12]}; "
                "calibrate this one"
            )

    def epsilon_at(self, R_BI: np.ndarray) -> np.ndarray:
        """Bounds (3,) for an IMU turned otherwise: the smallest box, along its axes, around ours.

        |R| epsilon with R from our frame to the new one. It keeps at least the joint level gamma,
        and is the same box where the axes are only exchanged or reversed.
        """
        return np.abs(np.asarray(R_BI).T @ self.R_BI) @ self.epsilon

    def persistent_at(self, R_BI: np.ndarray) -> BiasModel:
        """The persistent part, for another IMU mounting. Raises BoundsError where it is missing."""
        if self.persistent is None:
            raise BoundsError("--bounds have no persistent part; calibrate again, on a longer log")
        return self.persistent.turned(np.asarray(R_BI).T @ self.R_BI)

    def save(self, path: str | Path, force: bool = False) -> None:
        """Write them as JSON, whole or not at all. Raises SurefootError where `path` exists."""
        values = {"format": BOUNDS_FORMAT, "schema": BOUNDS_SCHEMA} | asdict(self)
        if self.persistent is not None:
            values["persistent"] = self.persistent.plain()
        text = json.dumps(values, indent=1, default=lambda array: array.tolist(), allow_nan=False)
        text = json.dumps({"digest": _digest(json.loads(text))} | json.loads(text), indent=1)
        with whole_file(path, force) as temporary:
            temporary.write_text(text + "\n")

    @classmethod
    def load(cls, path: str | Path) -> Bounds:
        """The bounds at `path`. Raises BoundsError, one line, where it holds no valid ones."""
        try:
            values = bounded_json(path)
        except SurefootError as error:
            raise BoundsError(str(error)) from None
        if not isinstance(values, dict) or values.get("format") != BOUNDS_FORMAT:
            raise BoundsError(f"{path}: not surefoot bounds")
        schema, digest = values.get("schema"), values.pop("digest", None)
        if schema not in (1, BOUNDS_SCHEMA):
            raise BoundsError(f"{path}: schema {schema}, this surefoot reads {BOUNDS_SCHEMA}")
        if (schema > 1 or digest is not None) and digest != _digest(values):
            raise BoundsError(f"{path}: were changed since they were calibrated; calibrate again")
        del values["format"], values["schema"]
        try:
            return _checked(values)
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
            raise BoundsError(f"{path}: not whole surefoot bounds ({error})") from error


def _digest(values: dict[str, Any]) -> str:
    """SHA-256 of what bounds say, the order of their keys aside."""
    return hashlib.sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()


def _checked(values: dict[str, Any]) -> Bounds:
    curve: Any = values["mixing"]
    if curve is not None:
        arrays = {name: np.array(curve[name]) for name in ("lags", "beta", "floor")}
        curve = Mixing(**(curve | arrays))
    arrays: dict[str, Any] = {k: np.array(values[k], dtype=float) for k in ("epsilon", "R_BI")}
    part: Any = values.get("persistent")
    part = None if part is None else BiasModel.from_plain(part)
    warnings = tuple(map(str, values.get("warnings", ())))
    values = values | arrays | {"mixing": curve, "persistent": part, "warnings": warnings}
    bounds = Bounds(**values)
    if bounds.epsilon.shape != (3,) or not np.all(bounds.epsilon > 0):
        raise ValueError("epsilon is not three positive numbers")
    if not np.all(np.isfinite(bounds.epsilon)):
        raise ValueError("epsilon is not finite")
    check_rotation(bounds.R_BI)
    if not (0 < bounds.gamma < 1 and 0 < bounds.level_per_axis < 1):
        raise ValueError("gamma and level_per_axis must lie between 0 and 1")
    if not all(isinstance(count, int) and count > 0 for count in (bounds.K, bounds.n)):
        raise ValueError("K and n must be whole and positive")
    if bounds.confidence is not None and not 0 < bounds.confidence < 1:
        raise ValueError("confidence must lie between 0 and 1")
    if not isinstance(bounds.observer, str):
        raise ValueError("observer is not a hash")
    return bounds
