"""Entries of an import map for one file of a recording, from names and values of its columns."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from surefoot.sim.importing.draft import Entry
from surefoot.sim.importing.guess_units import (
    gravity_doubt,
    stride_in_turns,
    unit_of_accel,
    unit_of_angles,
    unit_of_gyro,
    unit_of_rates,
)
from surefoot.sim.importing.layout import is_number
from surefoot.sim.importing.names import Named, read_name, words_of
from surefoot.sim.importing.recorded_file import RecordedFile
from surefoot.sim.log.schema import JOINTS, LEGS
from surefoot.sim.robot.machine import Machine

_SMALL = 4096
"""Size [bytes] below which a text may be a list of joints."""
_OTHER_SIDE_FIRST = ("FR", "FL", "RR", "RL")
"""Order of the legs in software of Unitree and MIT."""


@dataclass(frozen=True)
class GuessedColumns:
    """Interpretation of a file's columns.

    Attributes:
        entries: of the map.
        notes: questions that concern no single column.
        rate: of the rows [Hz] by the joints' rates, for a file without times.
    """

    entries: tuple[Entry, ...]
    notes: tuple[str, ...]
    rate: float | None


def guess_columns(
    file: RecordedFile, machine: Machine | None = None, commands: bool = False
) -> GuessedColumns:
    """Entries for times, IMU, joints and feet of a file.

    Args:
        file: of the recording.
        machine: its joint order is used for unnamed columns; or None.
        commands: whether its joint columns are targets and not readings.
    """
    imu, imu_notes = _imu_entries(file)
    joints, legs, rate = _joint_entries(file, machine, commands, imu)
    feet, feet_notes = _feet_entries(file, legs, machine)
    times = [file.t] if file.t else []
    return GuessedColumns((*times, *imu, *joints, *feet), (*imu_notes, *feet_notes), rate)


def _of(file: RecordedFile, *kinds: str) -> dict[str, Named]:
    """The columns of these kinds."""
    return {name: named for name, named in file.names.items() if named.kind in kinds}


def _imu_entries(file: RecordedFile) -> tuple[list[Entry], list[str]]:
    """Entries of gyro and accelerometer, and notes."""
    entries: list[Entry] = []
    notes: list[str] = []
    triples: dict[str, tuple[str, ...]] = {}
    values: dict[str, np.ndarray] = {}
    for kind in ("gyro", "accel"):
        own = {n: one for n, one in _of(file, kind).items() if not one.leg and not one.commanded}
        axes = three_axes(own)
        if axes is not None:
            triples[kind] = axes
            values[kind] = np.column_stack([file.columns[name] for name in axes])
        elif own:
            notes.append(f"which of {', '.join(own)} are the {kind}'s x, y and z?")
    if "gyro" in triples:
        named = {file.names[name].unit for name in triples["gyro"]}
        unit, doubt = unit_of_gyro(file.seconds, values["gyro"], values.get("accel"), named)
        for axis, name in zip("xyz", triples["gyro"], strict=True):
            entries.append(Entry(f"gyro_{axis}", name, unit, doubt=doubt))
    if "accel" in triples:
        unit, gain, doubt = unit_of_accel(values["accel"])
        doubts = gravity_doubt(values["accel"].mean(axis=0))
        for axis, name in zip("xyz", triples["accel"], strict=True):
            why = doubt or doubts.get(axis, "")
            entries.append(Entry(f"accel_{axis}", name, unit, gain=gain, doubt=why))
    return entries, notes


def three_axes(own: Mapping[str, Named]) -> tuple[str, ...] | None:
    """The three columns of a vector in the order x, y, z; None if unclear."""
    along = [(one.axis, name) for name, one in own.items() if one.axis]
    if len(along) == 3 and set(dict(along)) == set("xyz"):
        return tuple(dict(along)[axis] for axis in "xyz")
    by_place = {one.place: name for name, one in own.items() if one.place is not None}
    if len(own) == 3 and len(by_place) == 3:
        return tuple(by_place[place] for place in sorted(by_place))
    return None


class _JointColumn(NamedTuple):
    """A column of a joint, with a doubt, and whether the joint's name is only assumed."""

    column: str
    doubt: str
    assumed: bool = False


_Joints = dict[str, dict[str, _JointColumn]]
"""Kind of column -> joint -> its column."""


def _joint_entries(
    file: RecordedFile, machine: Machine | None, commands: bool, imu: Sequence[Entry]
) -> tuple[list[Entry], Sequence[str], float | None]:
    """Entries of the joints, order of the legs, and rate of the rows."""
    joints = _joint_columns(file, machine, commands)
    swapped = _sides_doubt(file, joints.get("q", {}), imu)
    legs: Sequence[str] = LEGS
    if swapped and any(one.assumed for of in joints.values() for one in of.values()):
        # Some robots count their legs from the left, others from the right; strides show which.
        legs, swapped = _OTHER_SIDE_FIRST, ""
        doubt = _legs_doubt(legs)
        joints = {
            kind: {_other_side(joint): one._replace(doubt=doubt) for joint, one in of.items()}
            for kind, of in joints.items()
        }
    entries: list[Entry] = []
    rate = None
    for kind in joints:
        of_kind, rows = _entries_of_kind(file, kind, joints, swapped)
        entries += of_kind
        rate = rows or rate
    return entries, legs, rate


def _joint_columns(file: RecordedFile, machine: Machine | None, commands: bool) -> _Joints:
    """Columns of joints: q, dq and tau, or q_des, dq_des and tau_ff for commands."""
    poses = {one.leg for one in _of(file, "ref_q").values() if one.leg}
    found = {
        name: one
        for name, one in _of(file, "q", "dq", "tau").items()
        if one.joint or not (one.axis or one.reference or one.leg in poses)
    }
    raw = {(one.kind, one.commanded) for one in found.values() if not one.filtered}
    found = {n: x for n, x in found.items() if not x.filtered or (x.kind, x.commanded) not in raw}
    named = any(one.part or one.leg or one.joint for one in found.values() if one.kind == "q")
    joints: _Joints = {}
    for name, one in found.items():
        if named and not (one.part or one.leg or one.joint):
            continue
        kind = one.kind
        if one.commanded or commands:
            kind = {"q": "q_des", "dq": "dq_des", "tau": "tau_ff"}[kind]
        joint, column = _joint_of(file, machine, name, found)
        of = joints.setdefault(kind, {})
        if joint in of:
            column = of[joint]._replace(doubt=f"this, or {name}?")
        of[joint] = column
    return joints


def _joint_of(
    file: RecordedFile, machine: Machine | None, name: str, found: Mapping[str, Named]
) -> tuple[str, _JointColumn]:
    """The joint of a column, among all `found` columns of joints."""
    one = found[name]
    if one.joint:
        return one.joint, _JointColumn(name, "")
    leg = _leg(one.leg, {n.leg for n in found.values() if n.leg})
    alike = [n for n in found.values() if n.kind == one.kind and n.commanded == one.commanded]
    if leg:
        places = ("hip", "thigh", "calf")
        part = one.part or ("" if one.place is None else places[one.place % 3])
        joint = f"{leg if leg in LEGS else one.written}_{part}".rstrip("_")
        return joint, _JointColumn(name, "" if one.part else f"which joint of {leg} is {name}?")
    # A word common to all elements of a list names a group, not a joint.
    if one.part and len({n.place for n in alike if n.part == one.part}) <= 1:
        return one.part, _JointColumn(name, "")
    if one.place is None or len(alike) == 1:
        return "joint", _JointColumn(name, "" if len(alike) == 1 else f"which joint is {name}?")
    # Independent of counting from 0 or 1, and of the order of leg and joint numbers.
    order = sorted({(n.limb or 0, n.place or 0) for n in alike})
    place, count = order.index((one.limb or 0, one.place)), len(order)
    # Unnamed joints: in the order of a list, of the robot, or the usual one.
    orders = [*{**file.lists, **_lists_beside(file.path)}.items()]
    orders += [(machine.name, machine.limbs.joints)] if machine is not None else []
    for source, listed in orders:
        if len(listed) == count:
            return listed[place], _JointColumn(name, f"are its joints in the order of {source}?")
    if count == len(JOINTS):
        return JOINTS[place], _JointColumn(name, _legs_doubt(LEGS), assumed=True)
    return f"joint{place}", _JointColumn(name, "which joint is it?")


def _sides_doubt(
    file: RecordedFile, angles: Mapping[str, _JointColumn], imu: Sequence[Entry]
) -> str:
    """A doubt if the strides in turns suggest that left and right are exchanged; else empty."""
    rates = [entry for entry in imu if entry.name == "gyro_z"]
    if not rates or file.seconds is None:
        return ""
    yaw = rates[0].scale * file.columns[rates[0].theirs]
    left, right = (
        [file.columns[one.column] for joint, one in angles.items() if joint in thighs]
        for thighs in (("FL_thigh", "RL_thigh"), ("FR_thigh", "RR_thigh"))
    )
    growth = stride_in_turns(file.seconds, yaw, left, right) if left and right else None
    if growth is None or growth > 0.0:
        return ""
    return "in left turns the strides on this robot's left are longer: are left and right swapped?"


def _entries_of_kind(
    file: RecordedFile, kind: str, joints: _Joints, swapped: str
) -> tuple[list[Entry], float | None]:
    """Entries of one kind of joint columns, and the rate of the rows [Hz] where joint rates
    determine it.

    swapped: a doubt about left and right, for columns without another.
    """
    own = joints[kind]
    values = {joint: file.columns[one.column] for joint, one in own.items()}
    prefix, rate = kind, None
    if kind.startswith("q"):
        named = {file.names[one.column].unit for one in own.values()}
        unit, doubt = unit_of_angles(list(values.values()), named)
    elif kind.startswith("dq"):
        angles = joints.get("q" if kind == "dq" else "q_des", {})
        both = [joint for joint in values if joint in angles]
        unit, doubt, rate = unit_of_rates(
            file.seconds,
            [values[joint] for joint in both or values],
            [file.columns[angles[joint].column] for joint in both],
        )
    else:
        unit = "N m"
        most = max(float(np.quantile(np.abs(v), 0.99)) for v in values.values())
        doubt = "are these N m, or current?" if most > 300.0 else ""
        if all(v.min() >= 0.0 for v in values.values()) and most > 0.0:
            prefix, unit = f"x_{kind}", None
            doubt = "never negative: magnitudes, of which unit?"
    entries = [
        Entry(f"{prefix}_{joint}", one.column, unit, doubt=one.doubt or doubt or swapped)
        for joint, one in own.items()
    ]
    return entries, rate


def _feet_entries(
    file: RecordedFile, legs: Sequence[str], machine: Machine | None
) -> tuple[list[Entry], list[str]]:
    """Entries of contacts, forces and positions of the feet, and notes.

    Args:
        file: of the recording.
        legs: order of the legs for feet without names.
        machine: robot whose legs are recognised by the words of their joints.
    """
    entries: list[Entry] = []
    found = _of(file, "contact", "force", "foot")
    own_words = _words_of_legs(machine)
    for name, one in found.items():
        words = set(words_of(name))
        named = [leg for leg, theirs in own_words.items() if theirs <= words]
        if len(named) == 1:
            found[name] = replace(one, leg=named[0], part="")
    named_legs = {one.leg for one in file.names.values() if one.leg}
    for kind in ("contact", "force"):
        own = {n: x for n, x in found.items() if x.kind == kind and x.leg and x.axis in ("", "z")}
        plain = {n: one for n, one in own.items() if not one.part}
        # A word that all names begin with belongs to the robot and is ignored.
        own = own if not plain and len({one.leg for one in own.values()}) == len(own) else plain
        lists: dict[str, list[str]] = {}
        for name, one in found.items():
            if one.kind == kind and _is_counted(name, one):
                lists.setdefault(re.sub(r"[0-9]+", "", name), []).append(name)
        of_legs = [names for names in lists.values() if len(names) == len(legs)]
        counted = of_legs[0] if len(of_legs) == 1 else []
        if not own and counted:
            counted.sort(key=lambda n: found[n].place or found[n].limb or 0)
            prefix = _contact_or_force(file, kind, counted)
            entries += [
                Entry(f"{prefix}_{leg}", n, doubt=_legs_doubt(legs))
                for leg, n in zip(legs, counted, strict=True)
            ]
        vectors = {one.leg for one in found.values() if one.kind == kind and one.axis in ("x", "y")}
        for name, one in own.items():
            if one.leg not in vectors:
                prefix = _contact_or_force(file, kind, [name])
                doubt = "" if prefix == kind else "is not 0 or 1: a force?"
                entries.append(Entry(f"{prefix}_{_leg(one.leg, named_legs)}", name, doubt=doubt))
    feet = {n: one for n, one in found.items() if one.kind == "foot" and one.leg and one.axis}
    most = max((float(np.abs(file.columns[n]).max()) for n in feet), default=0.0)
    unit = "m" if most < 3.0 else "mm"
    entries += [
        Entry(f"foot_{_leg(one.leg, named_legs)}_{one.axis}", name, unit)
        for name, one in feet.items()
    ]
    return entries, ["are foot_<leg> along the IMU's axes, from its origin?"] if feet else []


def _words_of_legs(machine: Machine | None) -> dict[str, set[str]]:
    """Words that all joints of a leg share and that not all legs share, for machines with other
    than two or four legs, whose legs have no names of their own.
    """
    if machine is None or len(machine.limbs.legs) in (0, 2, 4):
        return {}
    limbs = machine.limbs
    shared = [
        set.intersection(*(set(words_of(limbs.joints[joint])) for joint in chain))
        for chain in limbs.chains
    ]
    of_all = set.intersection(*shared)
    return {
        leg: words - of_all for leg, words in zip(limbs.legs, shared, strict=True) if words - of_all
    }


def _contact_or_force(file: RecordedFile, kind: str, names: Sequence[str]) -> str:
    """Kind of these columns: contacts with values other than 0 and 1 are forces."""
    binary = all(np.isin(file.columns[name], (0.0, 1.0)).all() for name in names)
    return "force" if kind == "contact" and not binary else kind


def _is_counted(name: str, one: Named) -> bool:
    """Whether a foot's column, in any group of a file, has a number instead of a leg's name."""
    own = read_name(name.rpartition("/")[2])
    return not (one.leg or own.part or one.axis or (one.place is None and one.limb is None))


def _other_side(joint: str) -> str:
    """Name of the joint on the other side of a quadruped."""
    return joint[0] + {"L": "R", "R": "L"}[joint[1]] + joint[2:]


def _legs_doubt(legs: Sequence[str]) -> str:
    return f"are its legs {', '.join(legs)}, each hip, thigh, calf?"


def _leg(name: str, legs: set[str]) -> str:
    """Name of a leg: without rear legs, the front ones are left and right."""
    if name in ("FL", "FR") and not legs & {"RL", "RR"}:
        return "left" if name == "FL" else "right"
    return name


def _lists_beside(path: Path) -> dict[str, tuple[str, ...]]:
    """Words of small text files in the file's folder, which may list its joints in order."""
    found = {}
    for one in sorted(path.parent.glob("*.txt")):
        if one != path and one.stat().st_size < _SMALL:
            words = one.read_text(encoding="utf-8", errors="replace").split()
            if not any(map(is_number, words)):
                found[one.name] = tuple(words)
    return found
