"""Interpretation of a column's name: kind, leg and joint, axis and unit."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace

from surefoot.sim.log.schema import LEGS


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


_KINDS: dict[str, str] = {
    word: kind
    for kind, words in {
        "t": "t time stamp timestamp timestamps secs sec seconds clock ts tick utime epoch",
        "gyro": "gyro gyros gyr gyroscope omega angvel w angular",
        "accel": "acc accel acceleration accelerometer a",
        "q": "q qpos pos position positions angle angles jpos enc encoder theta translation p",
        "dq": "dq qd qvel vel velocity velocities speed speeds jvel encvel qdot dtheta rate rates",
        "tau": "tau torque torques effort trq jtau moment",
        "force": "force forces load grf fsr pressure",
        "contact": "contact contacts stance touch touchdown",
        "ref_q": "quat quaternion orientation attitude rot rotation rpy euler",
        "euler": "roll pitch yaw",
    }.items()
    for word in words.split()
}
_COMMANDED = _words(
    "des desired cmd command commanded target setpoint goal sp ff feedforward con ctrl control"
)
_FILTERED = _words("filt filtered smooth smoothed lp lpf lowpass")
_NOT_READ = _words("fric friction err error")
"""Words of joint columns that are neither readings nor commands, such as compensated friction."""
_REFERENCE = _words(
    "ref reference vicon mocap gt truth groundtruth optitrack opti motive qualisys base pose"
)
_FEET = _words("foot feet toe")
_SIDES = {"left": "L", "l": "L", "right": "R", "r": "R"}
_ENDS = {"front": "F", "fore": "F", "rear": "R", "hind": "R", "back": "R"}
_LEGS = {
    **dict.fromkeys(("fl", "lf"), "FL"),
    **dict.fromkeys(("fr", "rf"), "FR"),
    **dict.fromkeys(("rl", "hl", "lh", "bl", "lr"), "RL"),
    **dict.fromkeys(("rr", "hr", "rh", "br"), "RR"),
    **dict.fromkeys(("left", "l"), "left"),
    **dict.fromkeys(("right", "r"), "right"),
}
_ABDUCTIONS = _words(
    "haa abad abd abduct abductor abduction adduction hx hipx hip_x hip_aa hip_roll"
)
_FLEXIONS = _words("thigh hfe hy hipy hip_y hip_fe hip_pitch upper femur")
_OF_A_LEG = {
    "hip": "hip",
    **dict.fromkeys(_ABDUCTIONS, "hip"),
    **{f"hip_{word}": "hip" for word in ("abduct", "abduction", "adduction")},
    **dict.fromkeys(_FLEXIONS, "thigh"),
    **{f"hip_{word}": "thigh" for word in ("flexion", "extension")},
    **dict.fromkeys(_words("calf knee kfe kn shank shin lower tibia knee_fe knee_pitch"), "calf"),
}
"""Word -> hinge of a quadruped in our convention. If a leg also has an abduction joint, "hip" means
our thigh (`by_their_legs`).
"""
_UNITS = _words("ms us ns deg rad mm cm nm rpm turn degs rads dps mg g m s")
_OF_A_SECOND = {"dps": "deg/s", "degs": "deg/s", "rads": "rad/s"}
_FILLER = _words(
    "joint joints jnt motor motors state states imu body link linear measured meas actual of robot"
    " data estimator sensor header msg value raw leg ang per est estimate estimated lin is in flag"
    " field"
)
_QUALIFIERS = _COMMANDED | _FILTERED | _NOT_READ
_NO_PART = _QUALIFIERS | _FILLER
"""Words that do not belong to a joint's name."""
_TURNING = _words("ang rot rotational imu body")
_RATES = _words("vel velocity rate rates speed")
_KINDS_OF_VECTORS = {
    **dict.fromkeys(("ang", "w", "omega", "gyro", "gyr", "g"), "gyro"),
    **dict.fromkeys(("a", "acc", "accel"), "accel"),
    **dict.fromkeys(("q", "quat"), "ref_q"),
    **dict.fromkeys(("p", "pos", "t"), "ref_p"),
}


@dataclass(frozen=True)
class Named:
    """Information in a name; None or "" where there is none.

    Attributes:
        kind: of the log's column, `euler` for an angle of an attitude, `foot` for a foot's
            position.
        leg: FL, FR, RL, RR, left or right.
        written: the leg as written in the name.
        part: the joint's name without the leg's; hip, thigh or calf for FL to RR.
        joint: of the robot's file, where its name occurs.
        place: index in a list.
        limb: number of the leg.
        axis: of a vector.
        unit: as written.
        commanded: whether it is a command.
        filtered: whether it is a filtered reading.
        reference: whether it is of a tracked body.
    """

    kind: str = ""
    leg: str = ""
    written: str = ""
    part: str = ""
    joint: str = ""
    place: int | None = None
    limb: int | None = None
    axis: str = ""
    unit: str = ""
    commanded: bool = False
    filtered: bool = False
    reference: bool = False


def words_of(name: str) -> list[str]:
    """The words of a name in lower case, separated at punctuation and capitals."""
    # Frames in between, as in EuRoC's a_RS_S_x.
    name = re.sub(r"\b([apqw])_[A-Z]{2}(?:_[A-Z])?_([wxyz])\b", r"\1\2", name)
    name = name.replace("°", " deg ")
    apart = re.sub(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z]{2})", " ", name)
    words = [word.lower() for word in re.split(r"[^A-Za-z0-9]+", apart) if word]
    return _legs_in_one(words)


def _legs_in_one(words: list[str]) -> list[str]:
    """Replace "front" and "left", in either order, by "fl"."""
    ends = [k for k, word in enumerate(words) if word in _ENDS]
    for k in ends:
        for other in (k + 1, k - 1):
            if 0 <= other < len(words) and words[other] in _SIDES:
                leg = (_ENDS[words[k]] + _SIDES[words[other]]).lower()
                first = min(k, other)
                return [*words[:first], leg, *words[first + 2 :]]
    return words


def read_name(name: str) -> Named:
    """Interpret a single name."""
    words = words_of(name)
    kind, leg, written, axis, unit, place, limb = "", "", "", "", "", None, None
    part: list[str] = []
    # A vector's letter needs an axis or index; without one, as in "motor 0A", it is not a vector.
    vectors = any(word in tuple("xyz") or word.isdigit() for word in words)
    for word in words:
        letters, digits = re.fullmatch(r"([a-z]*)([0-9]*).*", word).groups()  # pyright: ignore
        if digits and letters in _QUALIFIERS:
            place = int(digits)
            continue
        vector = re.fullmatch(r"(ang|w|omega|gyro|gyr|g|a|acc|accel|q|quat|p|pos|t)([wxyz])", word)
        if word in _NO_PART or (word in _REFERENCE and len(words) > 1):
            continue
        if word.isdigit():
            place = int(word)
        elif word in _LEGS and not leg and len(words) > 1:
            leg, written = _LEGS[word], word
        elif word in _FEET:
            kind = kind or "foot"
        elif (word in "xyz" or (word == "w" and kind in ("q", "ref_q"))) and len(words) > 1:
            axis = word
        elif word in _UNITS and (kind or axis):
            unit = f"{unit}/{word}" if unit else word
        elif vector and vector[1] not in _KINDS_OF_VECTORS:
            part.append(word)
        elif vector:
            kind, axis = _KINDS_OF_VECTORS[vector[1]], vector[2]
        elif (word in ("a", "w") and not vectors) or (
            _KINDS.get(word) == "euler" and (leg or part or kind == "q")
        ):
            part.append(word)
        elif word in _KINDS:
            found = _KINDS[word]
            # "linear acceleration", "angular velocity" and "foot force" have two words for a kind.
            kind = found if kind in ("", "foot") or (kind, found) == ("t", "q") else kind
            part += [word] if found == "euler" else []
        elif letters in _KINDS and digits and not kind:
            kind, place = _KINDS[letters], int(digits)
        elif letters in _FEET and digits:
            kind, place = kind or "foot", int(digits)
        elif letters == "leg" and digits:
            limb = int(digits)
        elif letters in _FILLER and digits:
            place = int(digits)
        else:
            part.append(word)
    if kind == "force" and leg in LEGS and _of_a_leg(part) in ("hip", "thigh", "calf"):
        kind = "tau"  # the load of a joint
    tracked = bool(_REFERENCE & set(words))
    roots = {word.rstrip("0123456789") for word in words}
    if roots & _NOT_READ:
        kind = ""
    if kind == "gyro" and leg and not axis:
        kind = "dq"  # "angular velocity" of a joint
    if not kind and axis and tracked and not part and not leg:
        kind = "ref_p"
    if kind == "q" and axis and tracked and "q" in words:
        kind = "ref_q"
    if not kind and [word for word in words if word not in _UNITS] in (["x"], ["y"], ["z"]):
        kind, axis = "ref_p", axis or words[0]
    if kind in ("dq", "ref_q") and axis and not leg and _TURNING & set(words):
        # "ang_vel", "imu_rate" and similar; "rot" alone is an attitude.
        kind = "gyro" if kind == "dq" or _RATES & set(words) else kind
    return Named(
        kind=kind,
        leg=leg,
        limb=limb,
        part=_of_a_leg(part) if leg in LEGS else "_".join(part),
        written=written,
        place=place,
        axis=axis,
        unit=_OF_A_SECOND.get(unit, unit),
        commanded=bool(_COMMANDED & roots),
        filtered=bool(_FILTERED & roots),
        reference=tracked,
    )


def _of_a_leg(part: list[str]) -> str:
    """Our name of a quadruped's hinge, from the longest matching suffix; other words are the
    robot's.
    """
    for first in range(len(part)):
        if known := _OF_A_LEG.get("_".join(part[first:])):
            return known
    return "_".join(part)


def by_their_legs(names: Mapping[str, Named]) -> dict[str, Named]:
    """Interpret the names of one recording together: "abduct, hip, knee" of a quadruped are our
    hip, thigh, calf.
    """
    found = dict(names)
    hinges = {n: set(words_of(n)) for n, one in names.items() if one.leg in LEGS and one.part}
    written = set().union(*hinges.values()) if hinges else set()
    if written & _ABDUCTIONS and not written & _FLEXIONS:
        for name, words in hinges.items():
            if names[name].part == "hip" and "hip" in words and not words & _ABDUCTIONS:
                found[name] = replace(names[name], part="thigh")
    return found
