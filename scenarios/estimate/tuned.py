"""The filters' parameters by robot, from `tuned.toml`: what `scenarios.tune` found."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from surefoot.estimator.core.state import FilterNoise
from surefoot.estimator.leg import LegNoise
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.files import bundled
from surefoot.sim.common.toml import read_toml
from surefoot.sim.robot import Robot

BUNDLED = bundled("surefoot.scenarios.estimate", "tuned.toml")
GYRO_WALK, ACCEL_WALK = 1e-5, 1e-4
"""rad/s^2/sqrt(Hz) and m/s^3/sqrt(Hz), the same for all filters."""
IMU = ("accel", "gyro")
OWN: dict[str, tuple[str, ...]] = {
    "coverage": IMU,
    "coverage_gml": IMU,
    "coverage_persistent": (*IMU, "lasting"),
    "velocity": IMU,
    "velocity_inflated": (*IMU, "inflation"),
    "velocity_persistent": (*IMU, "lasting"),
    "leg": (*IMU, "contact"),
    "leg_slip": (*IMU, "contact", "slip_gate"),
    "radar_leg": (*IMU, "contact", "slip_gate", "radar"),
    "imu": IMU,
}
"""Each filter's own parameters.

accel [m/s^2/sqrt(Hz)] and gyro [rad/s/sqrt(Hz)]: a measurement errs for long stretches in one
direction, and an IMU taken at its data sheet's word would carry each such error on. contact
[m/s/sqrt(Hz)]: of a standing foot. slip_gate: a squared Mahalanobis distance of 3 degrees of
freedom. inflation: times the covariance that a gml observer predicts. lasting: times the deviations
of the persistent part's prior. radar: times a radar frame's covariance.
"""

Parameters = Mapping[str, float]


@dataclass(frozen=True)
class Tuned:
    """Parameters of one robot's filters, by filter: the names in OWN, all > 0.

    mounting [rad]: deviation of the IMU's mounting about each axis, declared for all filters and
    never tuned. reason says who chose the rest.
    """

    filters: dict[str, dict[str, float]]
    mounting: float
    reason: str


def imu_noise(values: Parameters) -> FilterNoise:
    return FilterNoise(values["gyro"], values["accel"], GYRO_WALK, ACCEL_WALK)


def leg_noise(values: Parameters) -> LegNoise:
    return LegNoise(imu_noise(values), values["contact"])


def tuned(robot: Robot) -> Tuned:
    """The parameters of this robot's filters: those of its name, else the defaults."""
    every = read_tuned()
    return every.get(robot.name, every["default"])


@cache
def read_tuned(path: Path = BUNDLED) -> dict[str, Tuned]:
    """All robots' parameters. Raises SurefootError, one line, on a bad file."""
    found = {name: _tuned(values, f"{path}: [{name}]") for name, values in read_toml(path).items()}
    if "default" not in found:
        raise SurefootError(f"{path}: [default] is missing")
    return found


def _tuned(values, where: str) -> Tuned:
    names = {"reason", "mounting", *OWN}
    if not isinstance(values, dict) or set(values) != names:
        raise SurefootError(f"{where} must have {', '.join(sorted(names))}")
    filters = {}
    for name, own in OWN.items():
        table = values[name]
        if not isinstance(table, dict) or set(table) != set(own):
            raise SurefootError(f"{where}: {name} must have {', '.join(own)}")
        for parameter, value in table.items():
            if isinstance(value, bool) or not isinstance(value, int | float) or not value > 0:
                raise SurefootError(f"{where}: {name}.{parameter} = {value!r} must be > 0")
        filters[name] = {parameter: float(table[parameter]) for parameter in own}
    return Tuned(filters, float(values["mounting"]), str(values["reason"]))
