"""Bounds: the calibrated statement about an observer's errors, P(|e| <= epsilon) >= gamma."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from surefoot.models.calibration.bias_model import BiasModel
from surefoot.models.calibration.mixing import Mixing
from surefoot.models.calibration.regions import BoundsError
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.files import json_digest, plain_json, write_whole
from surefoot.sim.common.limits import bounded_json
from surefoot.sim.common.quaternion import check_rotation

BOUNDS_FORMAT = "surefoot bounds"
BOUNDS_SCHEMA = 2
"""2: with a digest of the content. Schema 1, of surefoot 0.1.0, has none."""


@dataclass(frozen=True, eq=False)
class Bounds:
    """A calibrated coverage statement (paper, Eq. coverage_statement).

    Attributes:
        epsilon: bounds of |v_I predicted - v_I| (3,), along the axes of an IMU mounted as R_BI, in
            m/s or, if `scaled`, in the standard deviations that the observer predicts.
        gamma: joint level.
        level_per_axis: level at which the score was ranked: the cube root of gamma for the
            `conformal` method, gamma itself for methods that bound the axes jointly.
        method: of calibration.
        K: spacing of the samples, in steps of 10 ms.
        n: number of samples.
        observer: hash of the observer that they hold for.
        R_BI: mounting of the IMU (3, 3).
        log: that they were calibrated on.
        mixing: the curve from which K was chosen; None where K was given.
        confidence: of `scenario` bounds, over calibrations; None where the statement is about their
            mean.
        persistent: the persistent part of the errors; None for a log too short for it, and in old
            files.
        warnings: about what in the log was not plausible.
        scaled: whether the bounds change with the predicted standard deviations, as those of a
            `gml` observer do; in files of surefoot 0.1.0 none does.
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
    scaled: bool = False

    def __post_init__(self):
        """Raises ValueError where a value is no number of its kind."""
        if np.shape(self.epsilon) != (3,) or not np.all(np.greater(self.epsilon, 0)):
            raise ValueError("epsilon is not three positive numbers")
        if not np.all(np.isfinite(self.epsilon)):
            raise ValueError("epsilon is not finite")
        check_rotation(self.R_BI)
        if not (0 < self.gamma < 1 and 0 < self.level_per_axis < 1):
            raise ValueError("gamma and level_per_axis must lie between 0 and 1")
        if not all(isinstance(count, int) and count > 0 for count in (self.K, self.n)):
            raise ValueError("K and n must be whole and positive")
        if self.confidence is not None and not 0 < self.confidence < 1:
            raise ValueError("confidence must lie between 0 and 1")
        if not isinstance(self.scaled, bool):
            raise ValueError("scaled is neither true nor false")
        if not isinstance(self.observer, str):
            raise ValueError("observer is not a hash")

    @property
    def unit(self) -> str:
        """Unit of `epsilon`."""
        return "predicted std" if self.scaled else "m/s"

    @property
    def words(self) -> str:
        """The bounds of each axis."""
        sizes = ", ".join(f"{one:.4f}" for one in self.epsilon)
        return f"|error| <= {sizes} {self.unit} (forward, lateral, vertical)"

    def epsilon_at(self, R_BI: np.ndarray, covariance: np.ndarray | None = None) -> np.ndarray:
        """Bounds [m/s] for a rotated IMU: the smallest box along its axes that contains ours.

        These are |R| epsilon with R from our frame to the new one. The box has at least the joint
        level gamma, and is the same if axes are only exchanged or reversed. The result is (3,), or
        (M, 3) if the bounds are `scaled`. Raises BoundsError where these have no covariances.

        Args:
            R_BI: mounting of the IMU (3, 3).
            covariance: predicted for it (M, 3, 3) [m^2/s^2].
        """
        R = np.asarray(R_BI).T @ self.R_BI
        return self.epsilon * self._units(R, covariance) @ np.abs(R).T

    def relative(
        self, errors: np.ndarray, R_BI: np.ndarray, covariance: np.ndarray | None = None
    ) -> np.ndarray:
        """Errors (M, 3) [m/s] of an IMU mounted as R_BI along our own axes, in our unit.

        They are within the bounds where all are at most `epsilon`. covariance as in `epsilon_at`.
        """
        R = np.asarray(R_BI).T @ self.R_BI
        return errors @ R / self._units(R, covariance)

    def _units(self, R: np.ndarray, covariance: np.ndarray | None) -> np.ndarray | float:
        """Our unit along our axes [m/s], (M, 3) if `scaled`; R turns our frame to the new one."""
        if not self.scaled:
            return 1.0
        if covariance is None:
            raise BoundsError("bounds in predicted standard deviations, but none are predicted")
        return np.sqrt(np.einsum("ji,mjk,ki->mi", R, covariance, R))

    def persistent_at(self, R_BI: np.ndarray) -> BiasModel:
        """The persistent part for another IMU mounting. Raises BoundsError where it is missing."""
        if self.persistent is None:
            raise BoundsError("bounds have no persistent part; calibrate again, on a longer log")
        return self.persistent.turned(np.asarray(R_BI).T @ self.R_BI)

    def save(self, path: str | Path, force: bool = False) -> None:
        """Write as JSON, whole or not at all. Raises SurefootError where `path` exists."""
        values = {"format": BOUNDS_FORMAT, "schema": BOUNDS_SCHEMA} | plain_json(self)
        if self.persistent is not None:
            values["persistent"]["reach"] = values["persistent"].pop("max_error")
        values = {"digest": json_digest(values)} | values
        write_whole(path, json.dumps(values, indent=1) + "\n", force)

    @classmethod
    def load(cls, path: str | Path) -> Bounds:
        """Read the bounds at `path`. Raises BoundsError, one line, where it holds no valid ones."""
        try:
            values = bounded_json(path)
        except SurefootError as error:
            raise BoundsError(str(error)) from None
        if not isinstance(values, dict) or values.get("format") != BOUNDS_FORMAT:
            raise BoundsError(f"{path}: not surefoot bounds")
        schema, digest = values.get("schema"), values.pop("digest", None)
        if schema not in (1, BOUNDS_SCHEMA):
            raise BoundsError(f"{path}: schema {schema}, this surefoot reads {BOUNDS_SCHEMA}")
        if (schema > 1 or digest is not None) and digest != json_digest(values):
            raise BoundsError(f"{path}: were changed since they were calibrated; calibrate again")
        del values["format"], values["schema"]
        try:
            return _checked(values)
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
            raise BoundsError(f"{path}: not whole surefoot bounds ({error})") from error


def _checked(values: dict[str, Any]) -> Bounds:
    curve, part = values["mixing"], values.get("persistent")
    if curve is not None:
        arrays = {name: np.array(curve[name]) for name in ("lags", "beta", "floor")}
        curve = Mixing(**(curve | arrays))
    part = None if part is None else BiasModel.from_plain(part)
    arrays: dict[str, Any] = {k: np.array(values[k], dtype=float) for k in ("epsilon", "R_BI")}
    warnings = tuple(map(str, values.get("warnings", ())))
    return Bounds(**values | arrays | {"mixing": curve, "persistent": part, "warnings": warnings})
