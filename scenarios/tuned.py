"""The filters' parameters by robot, from `tuned.toml`, one set for all courses."""

from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path

from estimator.leg import LegNoise
from estimator.state import FilterNoise
from sim.errors import SurefootError
from sim.files import read_toml
from sim.robot import Robot

BUNDLED = Path(__file__).with_name("tuned.toml")
GYRO, GYRO_WALK, ACCEL_WALK = 3e-4, 1e-5, 1e-4
"""rad/s/sqrt(Hz), rad/s^2/sqrt(Hz) and m/s^3/sqrt(Hz), the same for all filters."""


@dataclass(frozen=True)
class Tuned:
    """Parameters of one robot's filters.

    accel [m/s^2/sqrt(Hz)] by filter: a learnt velocity errs for long stretches in one direction,
    and an accelerometer taken at its data sheet's word would carry each such error on. contact
    [m/s/sqrt(Hz)] by leg filter; inflation multiplies the covariance that a gml observer predicts;
    slip_gate is a squared Mahalanobis distance of 3 degrees of freedom. reason says who chose them.
    """

    accel: dict[str, float]
    contact: dict[str, float]
    inflation: float
    slip_gate: float
    reason: str

    def learnt_noise(self, name: str) -> FilterNoise:
        """The IMU's noise for the filter `name`."""
        return FilterNoise(GYRO, self.accel[name], GYRO_WALK, ACCEL_WALK)

    def leg_noise(self, name: str) -> LegNoise:
        """The noise of the leg filter `name`."""
        return LegNoise(self.learnt_noise(name), self.contact[name])


def tuned(robot: Robot) -> Tuned:
    """The parameters of this robot's filters: those of its name, else the defaults."""
    every = read_tuned()
    return every.get(robot.name, every["default"])


@cache
def read_tuned(path: Path = BUNDLED) -> dict[str, Tuned]:
    """All robots' parameters. Raises SurefootError, one line, on a bad file."""
    names = {f.name for f in fields(Tuned)}
    found = {}
    for robot, values in read_toml(path).items():
        if not isinstance(values, dict) or set(values) != names:
            raise SurefootError(f"{path}: [{robot}] must have {', '.join(sorted(names))}")
        found[robot] = Tuned(**values)
    if "default" not in found:
        raise SurefootError(f"{path}: [default] is missing")
    return found
