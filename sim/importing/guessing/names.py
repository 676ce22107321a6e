"""Interpretation of a column's name.

The names of a robot's own joints and legs go first (`name_in_file`), which may be called anything,
in any language. Then each word of a name votes: for a quantity, for the kind of its source (a
sensor by default), for what it belongs to (a joint, a foot, the body), for a leg, a joint, an axis,
a unit. `words.toml` says what each word votes for; `read_name` weighs the votes.
"""

import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

from surefoot.sim.common.files import bundled
from surefoot.sim.common.toml import read_toml
from surefoot.sim.importing.columns import UNITS
from surefoot.sim.log.schema import LEGS
from surefoot.sim.robot.machine import Machine

_SAID = read_toml(bundled("surefoot.sim.importing.guessing", "words.toml"))


def _by_word(said: Mapping[str, str]) -> dict[str, str]:
    """Word -> what it stands for."""
    return {word: meaning for meaning, words in said.items() for word in words.split()}


_HINGES, _SPELT, _OF_UNIT = (_by_word(_SAID.pop(one)) for one in ("hinge", "spelt", "of_unit"))
_WORDS: dict[str, tuple[str, str]] = {
    word: (vote, which)
    for vote, said in _SAID.items()
    for word, which in _by_word(said if isinstance(said, dict) else {"": said}).items()
}
"""Word -> what it votes for, and which."""
_SOURCES = tuple(_SAID["source"])
"""Kinds of source, the deciding one of several first."""
_ENDS = {"front": "f", "fore": "f", "rear": "r", "hind": "r", "back": "r"}
_SIDES = {"left": "l", "l": "l", "right": "r", "r": "r"}
"""Words of a leg of two, and the letters that they are short for."""
HINGES = ("hip", "thigh", "calf")
_GLUED = re.compile(r"(ang|w|omega|gyro|gyr|g|a|acc|accel|q|quat|p|pos|t)([wxyz])")
"""Words of vectors that their axis may follow at once, as in "gx"."""
_OF_JOINTS = ("q", "dq", "tau")
_SPOKEN = (*LEGS, "left", "right")
"""Legs that names of columns have words for; those of six are named after their bodies."""


@dataclass(frozen=True)
class Named:
    """Information in a name; None or "" where there is none.

    Attributes:
        kind: of the log's column, `euler` for an angle of an attitude, `foot` for a foot's
            position, `ref_v` for the body's velocity, `other` for what no log has.
        source: "" for a sensor, else bias, error, parameter, command, estimate, filtered or
            reference (of a tracked body).
        stem: the words that say neither axis, number, unit, leg nor hinge; those of one vector or
            list share it.
        leg: FL, FR, RL, RR, left or right.
        written: the leg as written in the name.
        part: the joint's name without the leg's; hip, thigh or calf for FL to RR.
        joint: of the robot's file, where its name occurs.
        place: index in a list.
        limb: number of the leg.
        axis: of a vector.
        unit: as written.
    """

    kind: str = ""
    source: str = ""
    stem: str = ""
    leg: str = ""
    written: str = ""
    part: str = ""
    joint: str = ""
    place: int | None = None
    limb: int | None = None
    axis: str = ""
    unit: str = ""

    @property
    def commanded(self) -> bool:
        """Whether it is a set point."""
        return self.source == "command"

    @property
    def joint_of_log(self) -> str:
        """Name of its joint in the log."""
        leg = self.leg if self.leg in LEGS else self.written
        return self.joint or f"{leg}_{self.part}".strip("_")


def words_of(name: str) -> list[str]:
    """The words of a name in lower case, separated at punctuation and capitals."""
    # Frames in between, as in EuRoC's a_RS_S_x.
    name = re.sub(r"\b([apqw])_[A-Z]{2}(?:_[A-Z])?_([wxyz])\b", r"\1 \2", name)
    name = name.replace("°", " deg ")
    apart = re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z]{2})", " ", name)
    words: list[str] = []
    for word in re.split(r"[^a-z0-9]+", apart.lower()):
        vector = _GLUED.fullmatch(word)
        words += ["gyro" if vector[1] == "g" else vector[1], vector[2]] if vector else [word]
    return _legs_in_one([word for word in words if word])


def _says_what_part(word: str) -> bool:
    """Whether a word may name a part of a robot: it is no number, quantity, unit or other word that
    names of columns share.
    """
    vote, _ = _WORDS.get(word, ("leg", ""))
    return vote == "leg" and not word.isdigit()


def _legs_in_one(words: list[str]) -> list[str]:
    """Replace "front" and "left", in either order, by "fl"."""
    for k, pair in enumerate(pairwise(words)):
        for end, side in (pair, pair[::-1]):
            if end in _ENDS and side in _SIDES:
                return [*words[:k], _ENDS[end] + _SIDES[side], *words[k + 2 :]]
    return words


def read_name(name: str) -> Named:
    """Interpret a single name."""
    words = words_of(name)
    leg, written, axis, unit, limb = "", "", "", "", None
    numbers: list[int] = []
    stem: list[str] = []
    votes: dict[str, list[str]] = defaultdict(list)
    # A vector's letter needs an axis or index; without one, as in "motor 0A", it is not a vector.
    vectors = any(word in tuple("xyz") or word.isdigit() for word in words)
    for word in words:
        letters, digits = re.fullmatch(r"([a-z]*)([0-9]*).*", word).groups()  # pyright: ignore
        what, which = _WORDS.get(word) or (_WORDS.get(letters) if digits else None) or ("part", "")
        if word.isdigit():
            numbers.append(int(word))
            continue
        if word in ("x", "y", "z") or (word == "w" and {"q", "ref_q"} & {*votes["quantity"]}):
            axis = word
            continue
        if what == "leg" and not leg and len(words) > 1 and not digits:
            leg, written = which, word
            continue
        if what == "unit" and word in _OF_UNIT and not (votes["quantity"] or axis):
            votes["quantity"].append(_OF_UNIT[word])
        if what == "unit" and (votes["quantity"] or axis or votes["time"]) and not digits:
            word = _SPELT.get(word, word)
            unit = f"{unit}/{word}" if unit else word
            continue
        if _SPELT.get(word) == "s":
            what = "time"
        if word == "w" and (votes["quantity"] or votes["turning"] or votes["linear"]):
            what, which = "world", ""  # as in Isaac Lab's root_ang_vel_w
        if what == "quantity" and (
            (word in ("a", "w") and not vectors)
            or (which == "euler" and (leg or votes["part"] or "q" in votes["quantity"]))
            or (digits and votes["quantity"])
        ):
            what = "part"
        what = "part" if what in ("leg", "unit") else what
        votes[what].append(word if what == "part" else which)
        if (what, which) == ("quantity", "euler"):
            votes["part"].append(word)
        elif word not in _HINGES:
            stem.append(word if what == "part" else letters)
        if digits and what == "limb":
            limb = int(digits)
        elif digits and what != "part":
            numbers.append(int(digits))
    if len(numbers) > 1 and limb is None:
        limb = numbers[-2]
    hinge = _of_a_leg(votes["part"]) if leg in LEGS else "_".join(votes["part"])
    source = next((one for one in _SOURCES if one in votes["source"]), "")
    kind = _kind(votes, axis, bool(numbers), leg)
    if kind == "force" and leg in LEGS and hinge in HINGES:
        kind = "tau"  # the load of a joint
    if kind in ("gyro", "accel") and votes["world"]:
        kind = "ref_v"  # no sensor's axes are the world's
    if kind in ("q", "dq", "tau") and source == "reference":
        source = "command"
    if axis and not (kind or votes["quantity"] or leg):
        alone = not stem or source == "reference" or {*votes["of"]} == {"body"}
        if unit in UNITS["ref_p"] or (alone and not votes["part"]):
            kind = "ref_p"  # "marker_x_mm", "vicon_x"
    return Named(
        kind=kind,
        source=source,
        stem=" ".join(stem),
        leg=leg,
        limb=limb,
        part=hinge,
        written=written,
        place=numbers[-1] if numbers else None,
        axis=axis,
        unit=unit,
    )


def _kind(votes: Mapping[str, list[str]], axis: str, counted: bool, leg: str) -> str:
    """The quantity that the votes of a name agree on: its last noun, by what it belongs to.

    Args:
        votes: of the words in their order, by what they are for.
        axis: of a vector, or "".
        counted: whether there is an index.
        leg: its name, or "".
    """
    if votes["time"]:
        return "t"
    of, turning = votes["of"], bool(votes["turning"])
    of_joint = bool(leg or "joint" in of)
    before, kind = ("", "", *votes["quantity"])[-2:]
    if votes["specific"] and kind == "force":
        return "accel"  # force per mass, of an accelerometer
    if kind in ("velocity", "rate"):
        turning = turning or before == "ref_q" or (kind == "rate" and axis != "")
        if before in ("gyro", "dq", "q"):
            return "dq" if before == "q" else before
        if "foot" in of or (before == "euler" and not of_joint and len(votes["part"]) == 1):
            return "other"
        if turning and not of_joint and (axis or counted):
            return "gyro"
        of_body = not of_joint and (axis or "body" in of or votes["linear"])
        return "ref_v" if of_body else "dq"
    if kind == "accel":
        return "other" if turning or of_joint or "foot" in of else kind
    if kind == "gyro" and not axis and (of_joint or "foot" in of):
        return "dq" if of_joint else "other"  # "omega" of a joint
    if kind == "position":
        tracked = axis or "body" in of or "reference" in votes["source"]
        return "foot" if "foot" in of else "ref_p" if tracked and not of_joint else "q"
    if kind == "t" and axis:
        return "ref_p"  # a translation, as TUM's "tx"
    if kind == "q" and not of_joint and (axis or (before == "euler" and len(votes["part"]) == 1)):
        return "ref_q" if axis else "euler"
    if not kind and turning:
        return "q" if of_joint else "gyro" if axis else ""
    return kind or ("foot" if "foot" in of else "")


def _of_a_leg(part: list[str]) -> str:
    """Our name of a quadruped's hinge, from the longest matching suffix; other words are the
    robot's.
    """
    for first in range(len(part)):
        if known := _HINGES.get("_".join(part[first:])):
            return known.replace("abduction", "hip")
    return "_".join(part)


def by_their_legs(names: Mapping[str, Named]) -> dict[str, Named]:
    """Interpret the names of one recording together: "abduct, hip, knee" of a quadruped are our
    hip, thigh, calf; without rear legs, the front ones are left and right.
    """
    found = dict(names)
    hinges = {
        n: {_HINGES.get(word) for word in words_of(n)}
        for n, one in names.items()
        if one.leg in LEGS and one.part
    }
    written = set().union(*hinges.values())
    if "abduction" in written and "thigh" not in written:
        for name, said in hinges.items():
            if names[name].part == "hip" and "hip" in said and "abduction" not in said:
                found[name] = replace(names[name], part="thigh")
    if not {one.leg for one in names.values()} & {"RL", "RR"}:
        sides = {"FL": "left", "FR": "right"}
        found = {n: replace(one, leg=sides.get(one.leg, one.leg)) for n, one in found.items()}
    return found


def lists_of(names: Mapping[str, Named], *shared: str) -> dict[tuple, dict[str, Named]]:
    """The names that agree in these attributes, by their values."""
    found: dict[tuple, dict[str, Named]] = {}
    for name, one in names.items():
        found.setdefault(tuple(getattr(one, key) for key in shared), {})[name] = one
    return found


def by_their_lists(names: Mapping[str, Named]) -> dict[str, Named]:
    """Interpret the elements of each list of one recording together: vectors of the feet, joints
    where a vector has too many elements, the pose (and velocities) of a body in one list, and a
    position of three elements, or of a body's axes, beside its quaternion, which are a pose.
    """
    found = dict(names)
    bodies = {one.stem.rpartition(" ")[0] for one in names.values() if one.kind == "ref_q"}
    for name, one in names.items():
        if one.axis and one.stem in bodies and not (one.kind or one.leg):
            found[name] = replace(one, kind="ref_p")  # "trunk_x" beside "trunk_qx"
    plain = {n: one for n, one in names.items() if not (one.axis or one.leg or one.joint)}
    plain = {n: one for n, one in plain.items() if one.place is not None}
    lists = lists_of(plain, "kind", "source", "stem")
    posed = {one[1] for one, members in lists.items() if one[0] == "ref_q" and len(members) == 4}
    for (kind, source, stem), members in lists.items():
        votes = {_WORDS.get(word) for word in stem.split()}
        limbs = {one.limb for one in members.values()}
        places = sorted({one.place or 0 for one in members.values()})
        for name, one in members.items():
            at = places.index(one.place or 0)
            if kind in ("force", "foot") and len(limbs) > 1 and len(places) == 3:
                found[name] = replace(one, axis="xyz"[at])
            elif kind in ("gyro", "ref_p", "ref_v") and len(members) > 3:
                kind_of_joint = "q" if kind == "ref_p" else "dq"
                command = "command" if source == "reference" else source
                found[name] = replace(one, kind=kind_of_joint, source=command)
            elif not kind and ("of", "body") in votes and len(members) in (7, 13):
                what = "ref_p" if at < 3 else "ref_q" if at < 7 else "ref_v"
                found[name] = replace(one, kind=what)
            elif (
                kind == "q" and len(members) == 3 and source in posed
                and ("quantity", "position") in votes and ("of", "joint") not in votes
            ):  # fmt: skip
                found[name] = replace(one, kind="ref_p")
    return found


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
            enough = any(map(_says_what_part, apart))
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
    return [one for one in called if any(map(_says_what_part, one.needed))]
