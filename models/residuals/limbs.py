"""Names of a machine's legs and joints, and which joint is of which leg."""

from dataclasses import dataclass
from functools import cached_property

from surefoot.sim.log import JOINTS, LEGS


@dataclass(frozen=True)
class Limbs:
    """Names of a machine's legs, front to rear, and of its joints, leg by leg."""

    legs: tuple[str, ...]
    joints: tuple[str, ...]

    @cached_property
    def leg_of(self) -> tuple[int | None, ...]:
        """The leg of each joint, by the name of the joint: `<leg>_<kind>`."""
        return tuple(
            next((i for i, leg in enumerate(self.legs) if joint.startswith(f"{leg}_")), None)
            for joint in self.joints
        )

    def kind(self, joint: int) -> str:
        """What a joint has in common with the same one of other legs: "thigh" of "FL_thigh"."""
        leg, name = self.leg_of[joint], self.joints[joint]
        return name if leg is None else name.removeprefix(f"{self.legs[leg]}_")


def limbs_of(joints: tuple[str, ...]) -> Limbs:
    """Those of a log with these joints: a quadruped's, or a machine's on a fixed base."""
    return Limbs(LEGS, JOINTS) if joints in ((), JOINTS) else Limbs((), joints)
