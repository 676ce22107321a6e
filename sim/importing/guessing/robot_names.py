"""Interpretation of a column's name by the names of a robot's own joints and legs.

These go before the words of `words.toml`: a robot's legs may be called anything, in any language.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from surefoot.sim.importing.guessing.names import Named, read_name, says_what_part, words_of
from surefoot.sim.log.schema import LEGS
from surefoot.sim.robot.machine import Machine

_OF_JOINTS = ("q", "dq", "tau")
_SPOKEN = (*LEGS, "left", "right")
"""Legs that names of columns have words for; those of six are named after their bodies."""


@dataclass(frozen=True)
class _Called:
    """Words for a joint or a leg.

    Attributes:
        ours: its name in a log.
        needed: words that say that it is meant.
        every: all words of its name in the file.
    """

    ours: str
    needed: frozenset[str]
    every: frozenset[str]


def name_in_file(name: str, machine: Machine | None) -> Named:
    """Interpret a name that may contain words of a joint or a leg of the robot, as the log or the
    robot's file calls it.

    Words of the joint's name are ignored for the kind of the column: "wrist_rotation_joint_effort".
    """
    if machine is None:
        return read_name(name)
    words = words_of(name)
    if joint := _meant(words, _joints(machine)):
        rest = _without(words, joint.every)
        alone, whole = read_name(rest), read_name(f"{joint.ours} {rest}")
        found = whole if whole.kind in _OF_JOINTS and alone.kind not in _OF_JOINTS else alone
        if not found.kind or found.kind in _OF_JOINTS:
            return replace(found, joint=joint.ours, leg=whole.leg)
    if leg := _meant(words, _legs(machine)):
        said = leg.ours if leg.ours in _SPOKEN else ""
        return replace(read_name(f"{said} {_without(words, leg.needed)}"), leg=leg.ours)
    return read_name(name)


def _meant(words: Sequence[str], known: Sequence[_Called]) -> _Called | None:
    """The one of which all needed words are there; of several, the one that needs most."""
    there = [one for one in known if one.needed and one.needed <= {*words}]
    most = max((len(one.needed) for one in there), default=0)
    best = {one.ours: one for one in there if len(one.needed) == most}
    return next(iter(best.values())) if len(best) == 1 else None


def _without(words: Sequence[str], left_out: frozenset[str]) -> str:
    return " ".join(word for word in words if word not in left_out)


def _joints(machine: Machine) -> list[_Called]:
    """The joints, by their names in the file and in a log, without words that all of them share."""
    found = []
    for names in (machine.joint_names, machine.limbs.joints):
        words = [frozenset(words_of(name)) for name in names]
        shared = frozenset.intersection(*words) if words else frozenset()
        for ours, every in zip(machine.limbs.joints, words, strict=True):
            apart = every - shared
            enough = any(map(says_what_part, apart))
            found.append(_Called(ours, apart if enough else every, every))
    return found


def _legs(machine: Machine) -> list[_Called]:
    """The legs, by the words that all joints of one share, and not those of all legs."""
    limbs = machine.limbs
    words = [frozenset(words_of(name)) for name in machine.joint_names]
    shared = [frozenset.intersection(*(words[k] for k in chain)) for chain in limbs.chains]
    of_all = frozenset.intersection(*shared) if shared else frozenset()
    legs = zip(limbs.legs, shared, strict=False)  # of feet alone, no joints are known
    called = [_Called(leg, every - of_all, every) for leg, every in legs]
    return [one for one in called if any(map(says_what_part, one.needed))]
