"""Entries of an import map for one file of a recording, from names and values of its columns."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from surefoot.sim.importing.clock import Columns
from surefoot.sim.importing.columns import UNITS
from surefoot.sim.importing.guessing.draft import Entry
from surefoot.sim.importing.guessing.names import (
    HINGES,
    Named,
    by_their_legs,
    lists_of,
    name_in_file,
)
from surefoot.sim.importing.guessing.recorded_file import RecordedFile
from surefoot.sim.importing.guessing.units import (
    stride_in_turns,
    unit_of_accel,
    unit_of_angles,
    unit_of_gyro,
    unit_of_rates,
    unit_of_travels,
    usual_size,
)
from surefoot.sim.log.schema import JOINTS, LEGS, joint_prefix

_OTHER_SIDE_FIRST = ("FR", "FL", "RR", "RL")
"""Order of the legs in software of Unitree and MIT."""
_SOURCES = ("", "filtered", "estimate")
"""Sources of readings, the best first."""
_INSIDE = 0.9
"""Share of angles within a joint's limits from which a column may be of that joint."""
_BEYOND = 0.1
"""Angle by which a joint may be beyond its limits, as its zero is not exact [rad]."""
_TURN = 400.0
"""Largest angle of a joint [degrees]."""
_SWAPPED = "in left turns the strides on this robot's left are longer: are left and right swapped?"


def guess_columns(
    file: RecordedFile, notes: list[str], commands: bool = False
) -> tuple[list[Entry], float | None]:
    """Entries for times, IMU, joints and feet of a file and, for a file without times, the rate of
    its rows [Hz] by the joints' rates.

    Questions that concern no single column are added to the notes. `commands` says whether its
    joint columns are targets and not readings.
    """
    imu = _imu_entries(file, notes)
    yaw = next((e.scale * file.columns[e.theirs] for e in imu if e.name == "gyro_z"), None)
    file = replace(file, yaw=yaw)
    columns = _joint_columns(file, commands)
    joints, rate = _joint_entries(file, columns)
    notes += _beyond_limits(file, joints)
    # Feet without names are in the order of the joints' legs.
    legs = file.limbs.legs or LEGS
    order = [*dict.fromkeys(joint.partition("_")[0] for joint in columns.get("q", {}))]
    legs = order if {*order} == {*legs} else legs
    times = [file.t] if file.t else []
    return [*times, *imu, *joints, *_feet_entries(file, legs, notes)], rate


def _of(file: RecordedFile, *kinds: str) -> dict[str, Named]:
    """The columns of these kinds."""
    return {name: named for name, named in file.names.items() if named.kind in kinds}


def _imu_entries(file: RecordedFile, notes: list[str]) -> list[Entry]:
    """Entries of gyro and accelerometer."""
    entries: list[Entry] = []
    accel = None
    # The accelerometer first, as the gyro's unit follows from it.
    for kind in ("accel", "gyro"):
        given = {n: one for n, one in _of(file, kind).items() if not one.leg}
        found = vectors(given, _SOURCES[:2])
        if not found:
            unclear = ", ".join(n for n, one in given.items() if not one.source)
            notes += [f"which of {unclear} are the {kind}'s x, y and z?"] * bool(unclear)
            continue
        source = given[found[0][0]].source
        others = [other[0] for other in found[1:] if given[other[0]].source == source]
        values = np.column_stack([file.columns[n] for n in found[0]])
        if kind == "accel":
            accel = values
            unit, gain, doubt = unit_of_accel(values)
        else:
            units = {given[n].unit for n in found[0]}
            unit, doubt = unit_of_gyro(file.seconds, values, accel, units)
            gain = 1.0
        asked = f"this, or {others[0]}?" if others else _source_doubt(source) or doubt
        axes = zip("xyz", found[0], strict=True)
        entries = [*(Entry(f"{kind}_{a}", n, unit, gain, asked) for a, n in axes), *entries]
    return entries


def vectors(given: Mapping[str, Named], sources: Sequence[str]) -> list[tuple[str, ...]]:
    """The columns of each vector in the order x, y, z: three of a stem, those of the first of the
    sources first.
    """
    given = {name: one for name, one in given.items() if one.source in sources}
    groups = (*lists_of(given, "source", "stem").values(), given)
    found = [axes for group in groups if (axes := _three_axes(group))]
    return sorted(dict.fromkeys(found), key=lambda axes: sources.index(given[axes[0]].source))


def _three_axes(given: Mapping[str, Named]) -> tuple[str, ...] | None:
    along = [(one.axis, name) for name, one in given.items() if one.axis]
    if len(along) == 3 and set(dict(along)) == set("xyz"):
        return tuple(dict(along)[axis] for axis in "xyz")
    by_place = {one.place: name for name, one in given.items() if one.place is not None}
    if len(given) == 3 and len(by_place) == 3:
        return tuple(by_place[place] for place in sorted(by_place))
    return None


def _source_doubt(source: str) -> str:
    return f"{'an' if source == 'estimate' else 'a'} {source} value, no reading?" if source else ""


_Joints = dict[str, dict[str, Entry]]
"""Kind of column -> joint -> its column, with a doubt."""


def _joint_columns(file: RecordedFile, commands: bool) -> _Joints:
    """Columns of joints: q, dq and tau, or q_des, dq_des and tau_ff for commands.

    `commands` says whether the joint columns of the file are targets and not readings.
    """
    poses = {one.leg for one in _of(file, "ref_q").values() if one.leg}
    found = {
        name: one
        for name, one in _of(file, "q", "dq", "tau").items()
        if one.source in (*_SOURCES, "command")
        and (one.joint or not (one.axis or one.leg in poses))
    }
    if not any(one.kind == "q" and not one.commanded for one in found.values()):
        found |= _bare_angles(file)
    lists = lists_of(found, "kind", "commanded")
    angles = lists.get(("q", False), {})
    joints: _Joints = {}
    for (kind, commanded), given in lists.items():
        if not commanded:
            best = min((one.source for one in given.values()), key=_SOURCES.index)
            given = {name: one for name, one in given.items() if one.source == best}
        if commanded or commands:
            kind = {"q": "q_des", "dq": "dq_des", "tau": "tau_ff"}[kind]
        of = joints.setdefault(kind, {})
        for one in _named_joints(file, given) or _counted_joints(file, given, angles):
            first = of.get(one.name)
            of[one.name] = replace(first, doubt=f"this, or {one.theirs}?") if first else one
    return joints


def _bare_angles(file: RecordedFile) -> dict[str, Named]:
    """Columns that are named after a joint and say nothing else, if their sizes are of angles."""
    return {
        name: replace(one, kind="q")
        for name, one in file.names.items()
        if not (one.kind or one.source)
        and (one.joint or (one.leg and one.part in HINGES))
        and np.abs(file.columns[name]).max() <= _TURN
    }


def _named_joints(file: RecordedFile, given: Mapping[str, Named]) -> list[Entry]:
    """The joint of each column whose name has one, of columns of one kind."""
    found: list[Entry] = []
    by_part = lists_of(given, "part")
    for name, one in given.items():
        # A word common to all elements of a list names a group, not a joint.
        alone = len({other.place for other in by_part[(one.part,)].values()}) == 1
        if one.joint or one.leg or (one.part and alone):
            part = one.part or ("" if one.place is None else HINGES[one.place % 3])
            joint = replace(one, part=part).joint_of_log
            doubt = "" if file.names[name].kind else "angles, by their sizes?"
            if one.leg and not (one.part or one.joint):
                doubt = f"which joint of {one.leg} is {name}?"
            if file.machine is not None and joint not in file.limbs.joints:
                doubt = f"{file.machine.name} has no joint {joint}: which is it?"
            found.append(Entry(joint, name, doubt=doubt))
    return found


def _counted_joints(
    file: RecordedFile, given: Mapping[str, Named], angles: Iterable[str]
) -> list[Entry]:
    """The joint of each column by its number: in the order of a list of joints or, of those that
    are usual, in the one that fits the angles.

    `given` are the columns, of one kind; `angles` the names of the columns of angles.
    """
    if len(given) == 1:
        return [Entry("joint", name) for name in given]
    # Independent of counting from 0 or 1, and of the order of leg and joint numbers.
    number = {n: (one.limb or 0, one.place) for n, one in file.names.items()}
    places = sorted({number[n] for n, one in given.items() if one.place is not None})
    values = {number[n]: file.columns[n] for n in angles}
    # The last of a list may be places without a motor, as of the twenty of a Go2.
    motors = len(file.limbs.joints or JOINTS)
    silent = not any(values[at].any() for at in places[motors:] if at in values)
    if silent and len(places) not in map(len, file.lists.values()):
        places = places[:motors]
    joints, doubt = _listed_order(file, len(places))
    if joints is None:
        joints, asked = _fitting_order(file, [values.get(at) for at in places])
        doubt = f"{asked}{doubt}"
    joint_at = dict(zip(places, joints, strict=True))
    found = [Entry(joint_at[number[n]], n, doubt=doubt) for n in given if number[n] in joint_at]
    others = [n for n, one in given.items() if one.place is None]
    return [*found, *(Entry("joint", n, doubt=f"which joint is {n}?") for n in others)]


def _listed_order(file: RecordedFile, count: int) -> tuple[Sequence[str] | None, str]:
    """Names of so many joints in the order of a list of the recording, and a question; None, and
    which lists have another number of names, if none has theirs.
    """
    others = ""
    for source, listed in file.lists.items():
        read = by_their_legs({one: name_in_file(one, file.machine) for one in listed})
        if len(read) == len(listed) == count:
            names = [
                one.joint_of_log if one.joint or (one.leg in LEGS and one.part) else text
                for text, one in read.items()
            ]
            order = names if len(set(names)) == count else listed
            return order, f"are its joints in the order of {source}?"
        if sum(bool(one.leg or one.joint) for one in read.values()) > len(read) / 2:
            others += f" {source} has {len(listed)} names, not {count}."
    return None, others


def _fitting_order(
    file: RecordedFile, angles: Sequence[np.ndarray | None]
) -> tuple[Sequence[str], str]:
    """Names of joints in the usual order that fits their angles best, and a question.

    The angles of a robot's joints are within its limits; the strides of a quadruped's outer legs
    are the longer ones in turns. Angles are (N,) in any unit, None of a joint without.
    """
    joints = file.limbs.joints
    if file.machine is not None and len(joints) == len(angles):
        kinds = dict(zip(joints, file.limbs.kind_of, strict=True))
        by_kind = sorted(joints, key=lambda joint: [*kinds.values()].index(kinds[joint]))
        known = {k: x for k, x in enumerate(angles) if x is not None}
        scale = UNITS["q"][unit_of_angles(known.values(), set())[0]]
        fits = [
            sum(_share_inside(file, order[k], scale * x) for k, x in known.items())
            for order in (joints, by_kind)
        ]
        if fits[0] >= fits[1]:
            return joints, f"are its joints in the order of {file.machine.name}?"
        return by_kind, f"are its joints in the order {', '.join(by_kind)}?"
    if len(angles) == len(JOINTS):
        known = {joint: x for joint, x in zip(JOINTS, angles, strict=True) if x is not None}
        legs = _OTHER_SIDE_FIRST if _longer_inside(file, known) else LEGS
        doubt = f"are its legs {', '.join(legs)}, each hip, thigh, calf?"
        return [f"{leg}_{hinge}" for leg in legs for hinge in HINGES], doubt
    return [f"joint{k}" for k in range(len(angles))], "which joint is it?"


def _share_inside(file: RecordedFile, joint: str, angles: np.ndarray) -> float:
    """Share of the angles (N,) [rad] within the limits of the robot's joint; 1 without limits."""
    robot = file.machine.legged if file.machine is not None else None
    if robot is None or joint not in file.limbs.joints:
        return 1.0
    low, high = robot.joint_range[file.limbs.joints.index(joint)]
    return float(np.mean((angles > low - _BEYOND) & (angles < high + _BEYOND)))


def _longer_inside(file: RecordedFile, angles: Columns) -> bool:
    """Whether the strides of a quadruped's inner legs, by the angles' joints, are the longer ones
    in turns: left and right are exchanged.
    """
    left, right = (
        [x for joint, x in angles.items() if joint in thighs]
        for thighs in (("FL_thigh", "RL_thigh"), ("FR_thigh", "RR_thigh"))
    )
    if file.yaw is None or file.seconds is None or not left or not right:
        return False
    growth = stride_in_turns(file.seconds, file.yaw, left, right)
    return growth is not None and growth <= 0.0


def _joint_entries(file: RecordedFile, joints: _Joints) -> tuple[list[Entry], float | None]:
    """Entries of the joints, those that turn and those that slide, and the rate of the rows [Hz]
    where joint rates determine it.
    """
    entries: list[Entry] = []
    rate = None
    for slide, unit_of, rates_in, force in (
        (False, unit_of_angles, UNITS["dq"], "N m"),
        (True, unit_of_travels, UNITS["ref_v"], "N"),
    ):
        alike = {
            kind: [one for joint, one in of_kind.items() if (joint in file.limbs.slides) is slide]
            for kind, of_kind in joints.items()
        }
        values = {k: {one.name: file.columns[one.theirs] for one in of} for k, of in alike.items()}
        swapped = _SWAPPED if _longer_inside(file, values.get("q", {})) else ""
        for kind, of_kind in ((k, of) for k, of in alike.items() if of):
            prefix, readings = kind, values[kind]
            names = [file.names[one.theirs] for one in of_kind]
            if kind.startswith("q"):
                unit, doubt = unit_of(readings.values(), {one.unit for one in names})
            elif kind.startswith("dq"):
                angles = values.get("q" if kind == "dq" else "q_des", {})
                both = [joint for joint in readings if joint in angles]
                rates = [readings[joint] for joint in both or readings]
                scale = UNITS["q"][unit_of(angles.values(), set())[0]]
                angles = [scale * angles[joint] for joint in both]
                unit, doubt, rows = unit_of_rates(file.seconds, rates, angles, rates_in)
                rate = rate or rows
            else:
                unit = force
                most = usual_size(readings.values())
                doubt = f"are these {unit}, or current?" if most > 300.0 else ""
                if all(v.min() >= 0.0 for v in readings.values()) and most > 0.0:
                    prefix, unit = f"x_{kind}", None
                    doubt = "never negative: magnitudes, of which unit?"
            if kind in ("q", "dq"):
                doubt = doubt or _source_doubt(names[0].source)
            entries += [
                replace(
                    one,
                    name=f"{prefix}_{one.name}",
                    unit=unit,
                    doubt=one.doubt or doubt or swapped,
                )
                for one in of_kind
            ]
    return entries, rate


def _beyond_limits(file: RecordedFile, entries: Sequence[Entry]) -> list[str]:
    """A question where angles are beyond the limits of the robot's joints."""
    beyond = [
        e.name[2:]
        for e in entries
        if joint_prefix(e.name) == "q_"
        and _share_inside(file, e.name[2:], e.scale * file.columns[e.theirs]) < _INSIDE
    ]
    which = ", ".join(beyond[:3]) + ", ..." * (len(beyond) > 3)
    question = f"{which} beyond the limits of the robot: other joints, signs or zeros?"
    return [question] * bool(beyond)


def _feet_entries(file: RecordedFile, legs: Sequence[str], notes: list[str]) -> list[Entry]:
    """Entries of contacts, forces and positions of the feet; `legs` is the order of the legs for
    feet without names.
    """
    found = {n: x for n, x in _of(file, "contact", "force", "foot").items() if x.source in _SOURCES}
    counted = _counted_legs(found, legs)
    found |= {name: replace(found[name], leg=leg) for name, leg in counted.items()}
    entries: dict[str, Entry] = {}
    in_order = f"are its feet in the order {', '.join(legs)}?"
    for kind in ("contact", "force"):
        of_kind = {
            n: x for n, x in found.items() if x.kind == kind and x.leg and x.axis in ("", "z")
        }
        # The stem of fewest words: "contact" goes before "contact threshold".
        groups = sorted(
            lists_of(of_kind, "source", "stem").items(),
            key=lambda one: (_SOURCES.index(one[0][0]), len(one[0][1].split())),
        )
        for name, one in groups[0][1].items() if groups else ():
            binary = all(np.isin(file.columns[n], (0.0, 1.0)).all() for n in groups[0][1])
            doubt = "" if binary or kind == "force" else "is not 0 or 1: a force?"
            if name in counted:
                doubt = in_order
            elif len(groups) > 1 and groups[1][0][0] == one.source:
                doubt = f"this, or {next(iter(groups[1][1]))}?"
            elif one.axis:
                doubt = "the z of a force: is that what presses on the foot?"
            column = f"{kind if binary else 'force'}_{one.leg}"
            entries.setdefault(column, Entry(column, name, doubt=doubt))
    feet = {n: one for n, one in found.items() if one.kind == "foot" and one.leg and one.axis}
    most = max((float(np.abs(file.columns[n]).max()) for n in feet), default=0.0)
    for name, one in feet.items():
        column = f"foot_{one.leg}_{one.axis}"
        doubt = in_order if name in counted else ""
        entries.setdefault(column, Entry(column, name, "m" if most < 3.0 else "mm", doubt=doubt))
    notes += ["are foot_<leg> along the IMU's axes, from its origin?"] * bool(feet)
    notes += _missing_feet(file, found, entries)
    return list(entries.values())


def _missing_feet(
    file: RecordedFile, found: Mapping[str, Named], entries: Mapping[str, Entry]
) -> list[str]:
    """Questions where only some of the feet have a column of a kind: there is no other for a leg of
    the robot, or there are columns with one more word, which may be a leg's.
    """
    asked = []
    for kind in ("contact", "force", "foot"):
        used = {e.theirs for e in entries.values() if found[e.theirs].kind == kind}
        there = {found[name].leg for name in used}
        stems = {(found[name].source, *found[name].stem.split()) for name in used}
        alike = [
            name
            for name, one in found.items()
            if one.kind == kind and not one.leg and _with_a_word_less(one) & stems
        ]
        if used and (alike or there < {*file.limbs.legs}):
            others = f", as {', '.join(alike)}" if alike else ""
            asked.append(
                f"{kind} of {', '.join(sorted(there))} alone: which are the others{others}?"
            )
    return asked


def _with_a_word_less(one: Named) -> set[tuple[str, ...]]:
    """Source and stem of a name, without one of its words."""
    words = one.stem.split()
    return {(one.source, *words[:k], *words[k + 1 :]) for k in range(len(words))}


def _counted_legs(found: Mapping[str, Named], legs: Sequence[str]) -> dict[str, str]:
    """The leg of each column of a list of as many feet as there are legs."""
    without = {name: one for name, one in found.items() if not one.leg}
    legs_of: dict[str, str] = {}
    for members in lists_of(without, "kind", "source", "stem").values():
        # Of a vector's two numbers, the first is of the foot, the second of the axis.
        number = {
            name: one.limb
            if one.limb is not None and (one.axis or one.place is None)
            else one.place
            for name, one in members.items()
        }
        numbers = sorted({one for one in number.values() if one is not None})
        if len(numbers) == len(legs):
            of = dict(zip(numbers, legs, strict=True))
            legs_of |= {name: of[one] for name, one in number.items() if one is not None}
    return legs_of
