"""Parameters of the estimators: their defaults, overridden by robot in `tuned.toml`, and by the
user's settings of noise, priors and initial state.

These settings are a TOML file with optional entries, for the option --settings of `estimate` and
`compare`; `surefoot noise` writes one, and --set takes single lines of it.

    [noise]                  # of every filter that has the parameter
    gyro = 3e-4              # rad/s/sqrt(Hz), and gyro_walk, rad/s^2/sqrt(Hz)
    accel = 0.01             # m/s^2/sqrt(Hz), and accel_walk, m/s^3/sqrt(Hz)
    encoder = 2e-3           # rad, of a joint angle
    kinematics = 2e-3        # m, of a foot's position
    contact = 0.02           # m/s/sqrt(Hz), of a standing foot

    [start]
    kind = "moving"          # or "rest", "reference": what the first state is taken from
    tilt = 0.02              # rad, and yaw: standard deviations of the first state, in G
    velocity = 0.05          # m/s
    position = 1e-3          # m, and height, if the vertical's differs
    b_a = 0.1                # m/s^2
    b_g = 5e-3               # rad/s

    [state]                  # the first state, instead of the reference's or gravity's
    p_GI = [0.0, 0.0, 0.3]   # m, and v_GI [m/s], b_a [m/s^2], b_g [rad/s]
    q_GI = [1.0, 0.0, 0.0, 0.0]

    [filters.leg]            # parameters of one filter, which override those of [noise]
    contact = 0.01
"""

import os
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from surefoot.estimator.core.state import NavState
from surefoot.estimator.initial import REFERENCE_STD, Start, initial_state, start_covariance
from surefoot.scenarios.estimate.contract import Estimator, Parameters
from surefoot.scenarios.estimate.estimators import check_filter
from surefoot.sim.common.errors import SurefootError, check_known, errors_in
from surefoot.sim.common.files import bundled
from surefoot.sim.common.limits import check_toml_keys
from surefoot.sim.common.quaternion import matrix_from_quaternion
from surefoot.sim.common.toml import Name, NonNegative, Positive, read_toml, read_typed, typed
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot
from surefoot.sim.robot.feet import Feet

BUNDLED_PARAMETERS = bundled("surefoot.scenarios.estimate", "tuned.toml")
Three = tuple[float, float, float]


@dataclass(frozen=True)
class Tuned:
    """Tuned parameters of a robot's estimators.

    Attributes:
        mounting: standard deviation of the IMU's mounting about each axis [rad], declared for all
            of them and never tuned.
        reason: who chose the rest.
        filters: by estimator, parameters that differ from their defaults.
    """

    mounting: float
    reason: str
    filters: dict[str, dict[str, float]] = field(default_factory=dict)

    def of(self, estimator: Estimator) -> dict[str, float]:
        """Value of each parameter of an estimator. Raises SurefootError for one that it does not
        have.
        """
        values = {parameter.name: parameter.default for parameter in estimator.parameters}
        return overridden(values, self.filters.get(estimator.name, {}), estimator.name)


def overridden(values: Parameters, chosen: Parameters, where: str) -> dict[str, float]:
    """Parameters with those `chosen` instead. Raises SurefootError, beginning with `where`, for one
    that is not among `values`.
    """
    with errors_in(where):
        for name in chosen:
            check_known("parameter", name, values)
    return {**values, **chosen}


def tuned(robot: Robot | None) -> Tuned:
    """Tuned parameters for this robot: the entry of its name, else [default]."""
    every = read_tuned(tuned_file())
    return every["default"] if robot is None else every.get(robot.name, every["default"])


def tuned_file() -> Path:
    """$SUREFOOT_TUNED, such as written by `surefoot tune`, or else the bundled tuned.toml."""
    return Path(os.environ.get("SUREFOOT_TUNED", BUNDLED_PARAMETERS))


@cache
def read_tuned(path: Path = BUNDLED_PARAMETERS) -> dict[str, Tuned]:
    """Read the entries of all robots. Raises SurefootError, one line, on a bad file."""
    tables = read_typed(path, dict[str, dict[str, NonNegative | Name | dict[str, Positive]]])
    if "default" not in tables:
        raise SurefootError(f"{path}: [default] is missing")
    return {robot: _tuned(table, f"{path}: [{robot}]") for robot, table in tables.items()}


def _tuned(table: dict[str, float | str | dict[str, float]], where: str) -> Tuned:
    filters: dict[str, dict[str, float]] = {}
    mounting, reason = table.pop("mounting", None), table.pop("reason", None)
    if not isinstance(mounting, float) or not isinstance(reason, str):
        raise SurefootError(f"{where} must have mounting, a number, and reason, a string")
    for name, values in table.items():
        if not isinstance(values, dict):
            raise SurefootError(f"{where} {name} must be a table of parameters, is {values!r}")
        filters[name] = values
    return Tuned(mounting, reason, filters)


@dataclass(frozen=True)
class NoiseSettings:
    """Noise of sensors, densities and standard deviations in the units above; None keeps a
    filter's own.
    """

    gyro: Positive | None = None
    gyro_walk: Positive | None = None
    accel: Positive | None = None
    accel_walk: Positive | None = None
    encoder: Positive | None = None
    kinematics: Positive | None = None
    contact: Positive | None = None


@dataclass(frozen=True)
class StartSettings:
    """What the first state is taken from, as in `surefoot.estimator.initial.initial_state`, and its
    standard deviations, as in `InitialStd` there; None keeps the default.
    """

    kind: Start | None = None
    tilt: Positive | None = None
    yaw: Positive | None = None
    velocity: Positive | None = None
    position: Positive | None = None
    height: Positive | None = None
    b_a: Positive | None = None
    b_g: Positive | None = None


@dataclass(frozen=True)
class StateSettings:
    """Parts of the first state; None keeps the one from the log."""

    p_GI: Three | None = None
    v_GI: Three | None = None
    q_GI: tuple[float, float, float, float] | None = None
    b_a: Three | None = None
    b_g: Three | None = None

    def __post_init__(self):
        if self.q_GI is not None and abs(np.linalg.norm(self.q_GI) - 1.0) > 1e-3:
            raise SurefootError("q_GI is no unit quaternion")


@dataclass(frozen=True)
class FilterSettings:
    """A file of settings; see the module."""

    noise: NoiseSettings = field(default_factory=NoiseSettings)
    start: StartSettings = field(default_factory=StartSettings)
    state: StateSettings = field(default_factory=StateSettings)
    filters: dict[str, dict[str, Positive]] = field(default_factory=dict)

    def __post_init__(self):
        for name in self.filters:
            with errors_in("[filters]"):
                check_filter(name)

    def parameters(self, estimator: Estimator, values: Parameters) -> dict[str, float]:
        """Parameters of an estimator: these, or else those of `values`.

        Raises SurefootError for one that it does not have.
        """
        given = {name: value for name, value in _given(self.noise).items() if name in values}
        chosen = self.filters.get(estimator.name, {})
        return overridden({**values, **given}, chosen, f"[filters.{estimator.name}]")

    def beginning(self, log: Log, feet: Feet | None = None) -> tuple[NavState, np.ndarray]:
        """`surefoot.estimator.initial.initial_state` of a log, with the given parts replaced, and
        its covariance (15, 15).

        feet: how the log shows its feet; None if it does not.
        """
        start, state = _given(self.start), _given(self.state)
        found, std = initial_state(log, start.pop("kind", None), feet)
        if "b_g" in state:  # its deviation is not that of a bias estimated at rest
            std = replace(std, b_g=REFERENCE_STD.b_g)
        if "q_GI" in state:
            q = np.asarray(state.pop("q_GI"))
            state["R_GI"] = matrix_from_quaternion((q / np.linalg.norm(q))[None])[0]
        found = replace(found, **{name: np.asarray(value) for name, value in state.items()})
        return found, start_covariance(found, replace(std, **start))


def read_settings(path: Path | None, lines: Sequence[str] = ()) -> FilterSettings:
    """Read the settings of a file, and single lines `noise.gyro=1e-3` that override it.

    Raises SurefootError, one line naming the file or option, for any fault.
    """
    table = read_toml(path, "settings") if path else {}
    with errors_in(f"settings {path}"):
        found = typed(table, FilterSettings)
    for line in lines:
        with errors_in(f"set {line}"):
            _merge(table, _parsed(line))
            found = typed(table, FilterSettings)
    return found


def _parsed(line: str) -> dict[str, Any]:
    check_toml_keys(line)
    try:
        return tomllib.loads(line)
    except (ValueError, RecursionError):  # of TOML, of too many digits, of arrays too deep
        raise SurefootError("write it as noise.gyro=1e-3") from None


def _given(settings: NoiseSettings | StartSettings | StateSettings) -> dict[str, Any]:
    return {name: value for name, value in vars(settings).items() if value is not None}


def _merge(table: dict[str, Any], more: Mapping[str, Any]) -> None:
    for key, value in more.items():
        if isinstance(value, dict) and isinstance(table.get(key), dict):
            _merge(table[key], value)
        else:
            table[key] = value
