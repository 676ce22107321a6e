"""Names of a machine's legs and joints, and which joint is of which leg."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

from surefoot.sim.log.schema import JOINTS, LEGS


@dataclass(frozen=True)
class Limbs:
    """Names of a machine's legs and of its joints.

    chains: of each leg, its joints as indices, from the body to the foot. Joints of no leg (of arms
    or a torso, or of a machine without legs) are in none. links: the legs' links of some length,
    but for the first of each, by the joint at the upper end.
    """

    legs: tuple[str, ...]
    joints: tuple[str, ...]
    chains: tuple[tuple[int, ...], ...]
    links: tuple[str, ...] = ()

    @cached_property
    def leg_of(self) -> tuple[int | None, ...]:
        """The leg of each joint, None where it is of no leg."""
        found: dict[int, int] = {j: leg for leg, chain in enumerate(self.chains) for j in chain}
        return tuple(found.get(joint) for joint in range(len(self.joints)))

    def kind(self, joint: int) -> str:
        """What a joint has in common with the same one of other legs: "thigh" of "FL_thigh"."""
        return self._kinds[joint]

    @cached_property
    def point_feet(self) -> bool:
        """Whether every leg has the three joints whose torques give the force on a foot's point."""
        return bool(self.chains) and all(len(chain) == 3 for chain in self.chains)

    @cached_property
    def kinds(self) -> dict[str, tuple[str, ...]]:
        """The joints of each kind that several legs have, from the body outwards."""
        found: dict[str, list[str]] = {}
        for chain in self.chains:
            for joint in chain:
                found.setdefault(self.kind(joint), []).append(self.joints[joint])
        return {kind: tuple(joints) for kind, joints in found.items() if len(joints) > 1}

    @cached_property
    def sides(self) -> dict[str, tuple[int, ...]]:
        """The legs of each side, as indices, by their names: `FL`, or `left`, or `l`."""
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

    @cached_property
    def _kinds(self) -> tuple[str, ...]:
        kinds = list(self.joints)
        for place, like in _alike(self.chains):
            if len(like) == 1:
                continue
            names = [self.joints[joint].split("_") for joint in like]
            shared = "_".join(part for part in names[0] if all(part in one for one in names[1:]))
            for joint in like:
                kinds[joint] = shared or f"joint_{place}"
        return tuple(kinds)


def _alike(chains: tuple[tuple[int, ...], ...]) -> Iterable[tuple[int, tuple[int, ...]]]:
    """Joints at the same place, counted from one, in legs of as many joints."""
    for length in {len(chain): None for chain in chains}:
        same = [chain for chain in chains if len(chain) == length]
        yield from enumerate(zip(*same, strict=True), 1)


def limbs_by_name(legs: tuple[str, ...], joints: tuple[str, ...]) -> Limbs:
    """Those of joints that are named after their leg, `<leg>_<kind>`, from the body to the foot."""
    chains = (
        tuple(i for i, joint in enumerate(joints) if joint.startswith(f"{leg}_")) for leg in legs
    )
    chains = tuple(chains)
    return Limbs(legs, joints, chains, tuple(joints[j] for chain in chains for j in chain[1:]))


QUADRUPED = limbs_by_name(LEGS, JOINTS)
"""Four legs of three joints each."""
