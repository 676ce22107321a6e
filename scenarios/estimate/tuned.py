"""Parameters of the estimators by robot: their defaults, overridden by `tuned.toml`."""

import os
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

from surefoot.scenarios.estimate.contract import Estimator, Parameters
from surefoot.sim.common.errors import SurefootError, check_known, errors_in
from surefoot.sim.common.files import bundled
from surefoot.sim.common.toml import Name, NonNegative, Positive, read_typed
from surefoot.sim.robot import Robot

BUNDLED_PARAMETERS = bundled("surefoot.scenarios.estimate", "tuned.toml")
FORMER = {"lasting": "persistent"}
"""Old names of parameters, in files of surefoot 0.1.0, and the current ones."""


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


def overridden(values: Parameters, own: Parameters, where: str) -> dict[str, float]:
    """Parameters with those of `own` instead. Raises SurefootError, beginning with `where`, for one
    that is not among `values`.
    """
    with errors_in(where):
        for name in own:
            check_known("parameter", name, values)
    return {**values, **own}


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
        filters[name] = {FORMER.get(key, key): float(value) for key, value in values.items()}
    return Tuned(mounting, reason, filters)
