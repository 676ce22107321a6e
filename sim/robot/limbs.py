"""Names of a machine's legs and joints, and the assignment of joints to legs."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.log.schema import JOINTS, LEGS


@dataclass(frozen=True)
class Limbs:
    """Names of a machine's legs and joints.

    Attributes:
        legs: names.
        joints: names.
        chains: indices of each leg's joints, from the body to the foot. Joints of no leg (of arms
            or a torso, or of a machine without legs) are in none.
        links: the legs' links of non-zero length except the first of each, named by the joint at
            the upper end.
        slides: joints that slide.
        inertia: (J,) moved by each joint in the zero posture, by the model [kg m^2; kg of slides];
            empty for a machine with legs, as is `slides`.
        mass: all that the joints move, by the model [kg]; 0 for a machine with legs.
        declared: ((effect, joint), size) of what a fixed base has by declaration and may have less
            of, such as friction.
    """

    legs: tuple[str, ...]
    joints: tuple[str, ...]
    chains: tuple[tuple[int, ...], ...]
    links: tuple[str, ...] = ()
    slides: tuple[str, ...] = ()
    inertia: tuple[float, ...] = ()
    mass: float = 0.0
    declared: tuple[tuple[tuple[str, str], float], ...] = ()

    @cached_property
    def leg_of(self) -> tuple[int | None, ...]:
        """Index of each joint's leg, None if it belongs to no leg."""
        found: dict[int, int] = {j: leg for leg, chain in enumerate(self.chains) for j in chain}
        return tuple(found.get(joint) for joint in range(len(self.joints)))

    @cached_property
    def kind_of(self) -> tuple[str, ...]:
        """Name that each joint shares with its counterparts on other legs, of as many joints:
        "thigh" for "FL_thigh".
        """
        kinds = list(self.joints)
        for length in {len(chain) for chain in self.chains}:
            alike = zip(*(chain for chain in self.chains if len(chain) == length), strict=True)
            for place, like in enumerate(alike, 1):
                names = [self.joints[joint].split("_") for joint in like]
                shared = [part for part in names[0] if all(part in one for one in names)]
                for joint in like:
                    kinds[joint] = "_".join(shared) or f"joint_{place}"
        return tuple(kinds)

    @property
    def feet_alone(self) -> bool:
        """Whether nothing is known of the legs but their feet (`sim.robot.machine`)."""
        return bool(self.legs) and not self.chains

    @cached_property
    def point_feet(self) -> bool:
        """Whether every leg has three joints, whose torques determine the force on a point foot."""
        return bool(self.chains) and all(len(chain) == 3 for chain in self.chains)

    @cached_property
    def kinds(self) -> dict[str, tuple[str, ...]]:
        """The joints of each kind that several legs have, from the body outwards."""
        found: dict[str, list[str]] = {}
        for chain in self.chains:
            for joint in chain:
                found.setdefault(self.kind_of[joint], []).append(self.joints[joint])
        return {kind: tuple(joints) for kind, joints in found.items() if len(joints) > 1}

    @cached_property
    def sides(self) -> dict[str, tuple[int, ...]]:
        """Indices of the legs of each side, by name: `FL`, or `left`, or `l`."""
        marks = {"front": ("F", 0), "rear": ("R", 0), "left": ("L", 1), "right": ("R", 1)}
        found = {
            side: tuple(
                i
                for i, leg in enumerate(self.legs)
                if (len(leg) == 2 and leg[at] == mark)
                or (side in ("left", "right") and leg.lower() in (side, side[0]))
            )
            for side, (mark, at) in marks.items()
        }
        return {side: legs for side, legs in found.items() if legs}


def refuse_foreign(there: Iterable[str], known: tuple[str, ...], what: str, machine: str) -> None:
    """Raise SurefootError for a joint or leg that a machine does not have.

    Args:
        there: names of joints or legs.
        known: those of the machine.
        what: "LOG: joint", say.
        machine: its name.
    """
    for one in there:
        if one not in known:
            raise SurefootError(f"{what} {one} is not one of {machine}'s: {', '.join(known)}")


QUADRUPED = Limbs(
    LEGS,
    JOINTS,
    chains=tuple((3 * leg, 3 * leg + 1, 3 * leg + 2) for leg in range(len(LEGS))),
    links=tuple(joint for joint in JOINTS if not joint.endswith("hip")),
)
"""Four legs of three joints each."""
