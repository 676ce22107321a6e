"""Machines known by their feet alone: logs with the feet's positions instead of joint angles."""

from dataclasses import dataclass, field
from typing import ClassVar

from surefoot.sim.log import Log
from surefoot.sim.robot.feet import PointFeet
from surefoot.sim.robot.limbs import Limbs
from surefoot.sim.robot.robot import DeclaredExtras


@dataclass(frozen=True)
class GivenFeet:
    """A walking machine whose logs give the positions of its feet in I, such as one with closed
    chains.

    It has no model of its joints, links and masses.

    Attributes:
        limbs: names of the legs; there are no joints.
        extras: properties that effects add.
        fixed: as of `Machine`, as are `feet`, `legged` and `dynamics`.
    """

    limbs: Limbs
    extras: DeclaredExtras = field(default_factory=DeclaredExtras)
    fixed: ClassVar[bool] = False
    feet: ClassVar[PointFeet] = PointFeet()
    legged: ClassVar[None] = None
    dynamics: ClassVar[None] = None

    @classmethod
    def of_log(cls, log: Log) -> "GivenFeet":
        """The machine of a log. Raises LogError where it does not give feet."""
        log.require("foot")
        return cls(Limbs(log.legs, (), ()))
