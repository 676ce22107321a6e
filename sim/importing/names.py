"""What the name of a column says: its kind, its leg and joint, its axis and its unit."""

import re
from dataclasses import dataclass

from surefoot.sim.log.schema import LEGS


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


_KINDS: dict[str, str] = {
    word: kind
    for kind, words in {
        "t": "t time stamp timestamp timestamps secs sec seconds clock",
        "gyro": "gyro gyr gyroscope omega angvel w angular",
        "accel": "acc accel acceleration accelerometer a",
        "q": "q qpos pos position positions angle angles jpos enc encoder theta",
        "dq": "dq qd qvel vel velocity velocities speed speeds jvel encvel qdot dtheta rate",
        "tau": "tau torque torques effort trq jtau moment",
        "force": "force forces load grf fsr pressure",
        "contact": "contact contacts stance touch touchdown",
        "ref_q": "quat quaternion orientation attitude rot rotation rpy euler",
        "euler": "roll pitch yaw",
    }.items()
    for word in words.split()
}
_COMMANDED = _words("des desired cmd command commanded target setpoint goal sp")
_REFERENCE = _words("ref reference vicon mocap gt truth groundtruth optitrack qualisys base")
_FEET = _words("foot feet toe")
_LEGS = {
    **dict.fromkeys(("fl", "lf"), "FL"),
    **dict.fromkeys(("fr", "rf"), "FR"),
    **dict.fromkeys(("rl", "hl", "lh", "bl", "lr"), "RL"),
    **dict.fromkeys(("rr", "hr", "rh", "br"), "RR"),
    **dict.fromkeys(("left", "l"), "left"),
    **dict.fromkeys(("right", "r"), "right"),
}
_OF_A_LEG = {
    **dict.fromkeys(("hip", "haa", "abad", "abduction", "hipx"), "hip"),
    **dict.fromkeys(("thigh", "hfe", "hipy"), "thigh"),
    **dict.fromkeys(("calf", "knee", "kfe", "shank"), "calf"),
}
_UNITS = _words("ms us ns deg rad mm cm nm rpm turn degs rads m s")
_FILLER = _words(
    "joint joints jnt motor motors state states imu body link linear measured meas actual of robot"
    " data estimator sensor header msg value raw leg ang per"
)
_KINDS_OF_VECTORS = {
    **dict.fromkeys(("ang", "w", "omega", "gyro", "gyr", "g"), "gyro"),
    **dict.fromkeys(("a", "acc", "accel"), "accel"),
    **dict.fromkeys(("q", "quat"), "ref_q"),
    **dict.fromkeys(("p", "pos"), "ref_p"),
}


@dataclass(frozen=True)
class Named:
    """What a name says; None or "" where it says nothing.

    kind: of the log's column, `euler` for an angle of an attitude, `foot` for a foot's place; leg:
    FL, FR, RL, RR, left or right; written: as the name has it; part: the joint's name beside the
    leg's, of FL to RR hip, thigh or calf; place: in a list; axis; unit: as written; commanded: a
    command; reference: of a tracked body.
    """

    kind: str = ""
    leg: str = ""
    written: str = ""
    part: str = ""
    place: int | None = None
    axis: str = ""
    unit: str = ""
    commanded: bool = False
    reference: bool = False


def words_of(name: str) -> list[str]:
    """The words of a name in small letters: parts between signs and capitals."""
    apart = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", " ", name)
    return [word.lower() for word in re.split(r"[^A-Za-z0-9]+", apart) if word]


def read_name(name: str) -> Named:
    """What a name says by itself."""
    words = words_of(name)
    kind, leg, written, axis, unit, place = "", "", "", "", "", None
    part: list[str] = []
    for word in words:
        letters, digits = re.fullmatch(r"([a-z]*)([0-9]*).*", word).groups()  # pyright: ignore
        vector = re.fullmatch(r"(ang|w|omega|gyro|gyr|g|a|acc|accel|q|quat|p|pos)([wxyz])", word)
        if word in _COMMANDED or word in _FILLER or (word in _REFERENCE and len(words) > 1):
            continue
        if word.isdigit():
            place = int(word)
        elif word in _LEGS and not leg and len(words) > 1:
            leg, written = _LEGS[word], word
        elif word in _FEET:
            kind = kind or "foot"
        elif (word in "xyz" or (word == "w" and kind == "ref_q")) and len(words) > 1:
            axis = word
        elif word in _UNITS and kind:
            unit = f"{unit}/{word}" if unit else word
        elif vector and vector[1] not in _KINDS_OF_VECTORS:
            part.append(word)
        elif vector:
            kind, axis = _KINDS_OF_VECTORS[vector[1]], vector[2]
        elif _KINDS.get(word) == "euler" and (leg or part or kind == "q"):
            part.append(word)
        elif word in _KINDS:
            found = _KINDS[word]
            # "linear acceleration", "angular velocity" and "foot force" have two words of a kind.
            kind = found if kind in ("", "foot") or (kind, found) == ("t", "q") else kind
            part += [word] if found == "euler" else []
        elif letters in _KINDS and digits and not kind:
            kind, place = _KINDS[letters], int(digits)
        elif letters in _FILLER and digits:
            place = int(digits)
        else:
            part.append(word)
    if not kind and words and words[-1] in "xyz" and len(words) == 1:
        kind, axis = "ref_p", words[0]
    return Named(
        kind=kind,
        leg=leg,
        part=_OF_A_LEG.get("_".join(part), "_".join(part)) if leg in LEGS else "_".join(part),
        written=written,
        place=place,
        axis=axis,
        unit=unit,
        commanded=bool(_COMMANDED & set(words)),
        reference=bool(_REFERENCE & set(words)),
    )
