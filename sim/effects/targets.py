"""Targets of effects: a part of a machine, or a group of parts that share one size."""

from typing import Literal

from surefoot.sim.robot.limbs import Limbs

Part = Literal["joint", "link", "link_axis", "leg", "leg_link", "leg_axis"]
"""A joint; the link that it moves, by its name; that link along one of its body's axes,
`<joint>_<axis>`; a leg; a link of a leg, named after the joint at its upper end; a leg along one of
the base's axes, `<leg>_<axis>`.
"""
AXES = ("x", "y", "z")


def parts(part: Part, limbs: Limbs) -> tuple[str, ...]:
    """Names of the parts of this kind on a machine with these limbs."""
    names = {
        "joint": limbs.joints,
        "link": limbs.joints,
        "leg": limbs.legs,
        "leg_link": limbs.links,
    }
    if part in names:
        return names[part]
    return tuple(f"{one}_{axis}" for one in names[part.removesuffix("_axis")] for axis in AXES)


def groups(part: Part, limbs: Limbs) -> dict[str, tuple[str, ...]]:
    """Groups of parts of this kind for which one size makes sense, with their members.

    Joints and links are grouped by kind (`thigh`), but for links of legs also by side and as `all`;
    legs as `front`, `rear`, `left`, `right` and `all`. A group has at least two members, and no two
    have the same.
    """
    single = parts(part, limbs)
    found: dict[str, tuple[str, ...]] = {}
    if part in ("joint", "link", "leg_link"):
        for kind, joints in limbs.kinds.items():
            found[kind] = tuple(joint for joint in joints if joint in single)
    for side, legs in limbs.sides.items():
        if part in ("joint", "link") and side in ("left", "right"):
            found[side] = tuple(limbs.joints[j] for leg in legs for j in limbs.chains[leg])
        elif part == "leg":
            found[side] = tuple(limbs.legs[leg] for leg in legs)
    if part in ("joint", "link", "leg"):
        found["all"] = single
    distinct: dict[frozenset[str], str] = {}
    for name, members in found.items():
        if len(members) > 1 and name not in single:
            distinct.setdefault(frozenset(members), name)
    return {name: found[name] for name in distinct.values()}
