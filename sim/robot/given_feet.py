"""Machines known by their feet alone: logs with the feet's positions instead of joint angles."""

from dataclasses import dataclass, field

from surefoot.sim.log import Log
from surefoot.sim.robot.limbs import Limbs
from surefoot.sim.robot.robot import DeclaredExtras, Robot


@dataclass(frozen=True)
class GivenFeet:
    """A walking machine whose logs give the positions of its feet in I, such as one with closed
    chains.

    It has no model of its joints, links and masses. How a foot turns is not known either, so its
    feet are points.

    Attributes:
        limbs: names of the legs; there are no joints.
        extras: properties that effects add.
    """

    limbs: Limbs
    extras: DeclaredExtras = field(default_factory=DeclaredExtras)

    @classmethod
    def of_log(cls, log: Log) -> "GivenFeet":
        """The machine of a log. Raises LogError where it does not give feet."""
        log.require("foot")
        return cls(Limbs(log.legs, (), ()))


Walker = Robot | GivenFeet
"""A machine with legs and a floating base."""


def shows_feet(log: Log, robot: Walker) -> bool:
    """Whether a log shows where the feet are: by joint angles, or by the positions it gives."""
    return log.has("foot" if isinstance(robot, GivenFeet) else "q")


def foot_groups(robot: Walker) -> tuple[str, ...]:
    """The groups of a log that the positions and velocities of the feet depend on."""
    return ("foot",) if isinstance(robot, GivenFeet) else ("q", "dq")
