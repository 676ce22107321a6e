"""A draft of an import map from the files alone: what names say, checked against what numbers say.

Units come from magnitudes and from columns that measure the same (rates against angles, the gyro
against the turning of gravity), gravity's axis and sign from the accelerometer's mean, left and
right from the strides in turns. What is not certain carries its doubt, a question in the draft.
"""

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.importing.bag import RECEIVED, bag_fields, read_bag
from surefoot.sim.importing.columns import DEGREE, STANDARD_GRAVITY, UNITS, kind_of
from surefoot.sim.importing.layout import layout_of
from surefoot.sim.importing.names import Named, by_their_legs, read_name, words_of
from surefoot.sim.importing.recording import is_bag, is_text, read_table
from surefoot.sim.importing.sections import Source
from surefoot.sim.importing.table import columns_of
from surefoot.sim.log.derived import JOINT_WINDOW, derivative
from surefoot.sim.log.schema import JOINTS, LEGS
from surefoot.sim.robot.fixed_base import Machine, load_machine

_RATES = (8.0, 5000.0)
"""Hz between which a log's rate lies."""
_LARGEST_ANGLE = 4.0 * np.pi
"""rad that a joint turns at most: two turns. Beyond, it is in degrees."""
_SURE_ANGLE = 3.5
"""rad that a joint in radians may reach without a doubt."""
_NEAR = 1.25
"""A ratio may be off by this factor and still say which unit it is."""
_AGREE = 0.5
"""Correlation from which two columns measure the same."""
_CAN_TURN = 0.1
"""rad/s, standard deviation of the yaw rate from which strides tell left from right."""
_MOST_JOINTS, _SMALL = 100, 4096
"""Names that a list of joints has at most, and bytes of a text with such a list."""
_OTHER_SIDE_FIRST = ("FR", "FL", "RR", "RL")
"""The order of legs in which Unitree and MIT count them."""
_FEW = 8
"""Columns of a file of which nothing is used that are named."""
_STRIDES = 1.0
"""s over which the size of strides is taken."""


@dataclass(frozen=True)
class Entry:
    """A column of the log and what it is made of; doubt: a question, empty where there is none."""

    name: str
    theirs: str
    unit: str | None = None
    sign: float = 1.0
    gain: float = 1.0
    offset: float = 0.0
    doubt: str = ""

    @property
    def scale(self) -> float:
        """SI over theirs."""
        units = UNITS.get(kind_of(self.name), {})
        return self.sign * self.gain * (units[self.unit] if self.unit else 1.0)


@dataclass(frozen=True)
class Draft:
    """A draft of a map.

    main: entries of [columns]; reference: of [reference.columns]; sources: further files by name,
    with the entry of their times; notes: questions of the whole; unused: columns without a use.
    """

    files: tuple[Path, ...]
    main: tuple[Entry, ...]
    reference: tuple[Entry, ...] = ()
    reference_file: Path | None = None
    sources: Mapping[str, tuple[Path, Entry]] = field(default_factory=dict)
    layouts: Mapping[Path, Mapping[str, object]] = field(default_factory=dict)
    rate: float | None = None
    robot: str | None = None
    contact: tuple[float, float] | None = None
    notes: tuple[str, ...] = ()
    unused: tuple[str, ...] = ()

    @property
    def text(self) -> str:
        """The draft as a map's file."""
        lines = [
            "# A draft by `surefoot import --guess`. A line with a # ? is a question: answer it by",
            "# what you know of the robot, then delete it. No log tells the signs of joints.",
            *(f"# ? {' '.join(note.split())}" for note in self.notes),
            "",
            "[source]",
            f"file = {_text(self.files[0].name)}",
        ]
        lines += self._layout(self.files[0])
        lines += [f"rate = {self.rate:.6g} # ? no times found"] if self.rate else []
        for name, (path, clock) in self.sources.items():
            lines += [
                "",
                f"[sources.{name}]",
                f"file = {_text(path.name)}",
                *self._layout(path),
                _line(replace(clock, name="t")),
            ]
        lines += ["", "[columns]", *_lines(self.main)]
        if self.reference:
            lines += ["", "[reference]"]
            if self.reference_file is not None and self.reference_file != self.files[0]:
                lines.append(f"file = {_text(self.reference_file.name)}")
                lines += self._layout(self.reference_file)
            lines += [
                'frame = "imu" # ? whose pose is it, and on which clock: try surefoot align',
                "",
                "[reference.columns]",
                *_lines(self.reference),
            ]
        lines += ["", "[robot]", f"name = {_text(self.robot)}"] if self.robot else []
        if self.contact:
            on, off = self.contact
            lines += ["", "[contact] # ? half way between swing and stance", f"on = {on:.4g}"]
            lines += [f"off = {off:.4g}"]
        if self.unused:
            lines += ["", f"# not used: {' '.join(', '.join(self.unused).split())}"]
        return "\n".join(lines) + "\n"

    def _layout(self, path: Path) -> list[str]:
        return [f"{key} = {json.dumps(one)}" for key, one in self.layouts.get(path, {}).items()]


@dataclass(frozen=True)
class _File:
    """A file, or the part of one that has a clock of its own. columns: (N,) on one clock, those of
    a bag interpolated to it; recorded: as they are in the file."""

    path: Path
    label: str
    columns: dict[str, np.ndarray]
    recorded: dict[str, np.ndarray]
    names: dict[str, Named]
    lists: dict[str, tuple[str, ...]]
    layout: dict[str, Any]
    t: Entry | None
    seconds: np.ndarray | None


def guess_map(files: Sequence[str | Path], robot: str | None = None) -> Draft:
    """A draft of the map of some files, the first or the richest the main one.

    robot: of the recording: columns are named as its file names its joints, or not at all, and
    then in its order. Raises SurefootError where a file cannot be read or none has columns of
    numbers.
    """
    paths = [one for path in files for one in _parts(Path(path))]
    if not paths:
        raise SurefootError(f"{files[0]}: no .csv, .json or .mat in this folder")
    machine = load_machine(robot) if robot else None
    read = [one for path in paths for one in _read(path, machine)]
    if not read:
        raise SurefootError(f"{paths[0]}: no columns of numbers in it")
    main = max(read, key=_richness)
    others = [one for one in read if one is not main]
    poses = [one for one in others if _reference(one) and _richness(one) == 0]
    notes: list[str] = []
    found = _Columns(main, machine)
    entries = list(found.entries)
    sources: dict[str, tuple[Path, Entry]] = {}
    for one in others:
        if one in poses or one.t is None:
            continue
        label = one.label
        there = {entry.name for entry in entries}
        added = [e for e in _Columns(one, machine, label).entries if e.name not in there]
        added = [e for e in added if e.name != "t"]
        if added:
            sources[label] = (one.path, one.t)
            entries += [replace(e, theirs=f"{label}:{e.theirs}") for e in added]
    for one in others:
        if one not in poses and one.label not in sources:
            columns = ", ".join([*one.columns][:_FEW])
            what = one.path.name if one.path != main.path else f"{one.label} in {one.path.name}"
            notes.append(f"nothing of {what} is used: what are its columns {columns}?")
    entries, dropped = _complete(entries)
    notes += [*found.notes, *dropped]
    if not any(one.name != "t" for one in entries):
        notes.append("no name says what a column is: which of those not used below is what?")
    at = poses[0] if poses else main
    reference = _reference(at)
    if reference and at is not main:
        notes += _overlap(main, at)
    used = {entry.theirs for entry in (*entries, *reference)}
    contact = _threshold(main, entries)
    return Draft(
        files=tuple(dict.fromkeys((main.path, *(one.path for one in others)))),
        main=tuple(entries),
        reference=reference,
        reference_file=at.path if reference else None,
        sources=sources,
        layouts={one.path: one.layout for one in read},
        rate=found.rate if main.t is None else None,
        robot=robot,
        contact=contact,
        notes=tuple(notes),
        unused=tuple(name for name in main.columns if name not in used),
    )


def _lists_beside(path: Path) -> dict[str, tuple[str, ...]]:
    """Words in the small texts of the folder, as of the joints in their order."""
    found = {}
    for one in sorted(path.parent.glob("*.txt")):
        if one != path and one.stat().st_size < _SMALL:
            words = one.read_text(encoding="utf-8", errors="replace").split()
            if not any(map(_is_number, words)):
                found[one.name] = tuple(words)
    return found


def _parts(path: Path) -> list[Path]:
    """A file or bag itself; the tables in a folder."""
    if path.is_dir() and not is_bag(path):
        return sorted(one for one in path.iterdir() if one.suffix in (".csv", ".json", ".mat"))
    return [path]


def _read(path: Path, machine: Machine | None) -> list[_File]:
    """The file by its clocks: a bag on one, another file apart where its clocks differ."""
    if is_bag(path):
        return _read_bag(path, machine)
    layout = layout_of(path) if is_text(path) else {}
    table = read_table(path, Source(**layout))
    columns = columns_of(table)
    lists = {
        name: tuple(map(str, cells))
        for name, cells in table.cells.items()
        if len(cells) <= _MOST_JOINTS and all(isinstance(one, str) for one in cells)
    }
    found = []
    for part in _by_clock({n: v for n, v in columns.items() if len(v) > 1}):
        names = _names(part, machine)
        t = _time(part, names)
        seconds = t.scale * part[t.theirs] if t else None
        label = _label(path, part, columns)
        found.append(_File(path, label, part, part, names, lists, layout, t, seconds))
    return found


def _read_bag(path: Path, machine: Machine | None) -> list[_File]:
    fields = bag_fields(path)
    if not fields:
        return []
    seen = read_bag(path, fields)
    recorded = {name: values for name, (_, values) in seen.items()}
    names = _names(recorded, machine)
    # The rows are those of the IMU, or else of the most frequent topic.
    gyro = [n for n, one in names.items() if one.kind == "gyro" and not one.reference]
    first = gyro[0] if gyro else max(recorded, key=lambda n: len(recorded[n]))
    topic, seconds = first.partition(":")[0], seen[first][0]
    t = _time_of_topic(topic, recorded, names)
    columns = {n: np.interp(seconds, *one) for n, one in seen.items()}
    return [_File(path, _plain(path.stem), columns, recorded, names, {}, {}, t, seconds)]


def _time_of_topic(
    topic: str, columns: Mapping[str, np.ndarray], names: Mapping[str, Named]
) -> Entry:
    """The stamps in a topic's messages, or where they have none when these were received."""
    own = {n: v for n, v in columns.items() if n.startswith(f"{topic}:") and names[n].kind == "t"}
    return _time(own, names) or Entry("t", f"{topic}:{RECEIVED}", "s")


def _names(columns: Mapping[str, np.ndarray], machine: Machine | None) -> dict[str, Named]:
    return by_their_legs({name: read_name(_in_our_words(name, machine)) for name in columns})


def _by_clock(columns: Mapping[str, np.ndarray]) -> list[dict[str, np.ndarray]]:
    """The columns of as many rows together; of those, groups apart whose times are not the same."""
    parts: dict[tuple[int, str], dict[str, np.ndarray]] = {}
    for rows in dict.fromkeys(map(len, columns.values())):
        own = {n: v for n, v in columns.items() if len(v) == rows}
        clocks = [n for n in own if read_name(n).kind == "t" and np.all(np.diff(own[n]) > 0.0)]
        apart = any(not np.array_equal(own[n], own[clocks[0]]) for n in clocks)
        groups = {n.rpartition("/")[0] for n in clocks} if apart else set()
        for name, values in own.items():
            group = name.rpartition("/")[0]
            parts.setdefault((rows, group if group in groups else ""), {})[name] = values
    return list(parts.values())


def _label(path: Path, part: Mapping[str, np.ndarray], whole: Mapping[str, np.ndarray]) -> str:
    """A name for a part of a file: the file's, or of one in several parts that of its groups."""
    if len(part) == len(whole):
        return _plain(path.stem)
    groups = dict.fromkeys(name.rpartition("/")[0] or name.partition("[")[0] for name in part)
    return _plain("_".join(groups))


def _plain(text: str) -> str:
    return re.sub(r"[^A-Za-z0-9_-]+", "_", text)


def _in_our_words(name: str, machine: Machine | None) -> str:
    """A column's name with our name of the joint in place of the one in the robot's file."""
    if machine is None:
        return name
    both = zip(machine.joint_names, machine.limbs.joints, strict=True)
    for theirs, ours in sorted(both, key=lambda pair: -len(pair[0])):
        alone = rf"(?<![A-Za-z0-9]){re.escape(theirs)}(?![A-Za-z0-9])"
        if theirs != ours and re.search(alone, name, re.IGNORECASE):
            return re.sub(alone, ours, name, flags=re.IGNORECASE)
    return name


def _richness(one: _File) -> int:
    inertial = sum(n.kind in ("gyro", "accel") for n in one.names.values())
    joints = sum(n.kind in ("q", "dq", "tau") and not n.reference for n in one.names.values())
    joints -= sum(n.kind == "q" and bool(n.axis) for n in one.names.values())
    return (
        100 * inertial + 10 * joints + joints * (not any(n.commanded for n in one.names.values()))
    )


def _time(columns: Mapping[str, np.ndarray], names: Mapping[str, Named]) -> Entry | None:
    """The column of times: named so, or else one that rises by even steps."""
    rising = [n for n, v in columns.items() if len(v) > 2 and np.all(np.diff(v) > 0.0)]
    named = [n for n in rising if names[n].kind == "t"]
    even = [n for n in rising if np.std(np.diff(columns[n])) < 0.5 * np.mean(np.diff(columns[n]))]
    for name in (*named, *even):
        step = float(np.median(np.diff(columns[name])))
        said = names[name].unit
        fits = [u for u, s in UNITS["t"].items() if _RATES[0] < 1.0 / (step * s) < _RATES[1]]
        if said in fits:
            return Entry("t", name, said)
        if fits:
            doubt = "" if name in named and len(fits) == 1 else "is this the time?"
            return Entry("t", name, fits[0], doubt=doubt)
    return None


class _Columns:
    """The entries of one file, worked out kind by kind."""

    def __init__(self, file: _File, machine: Machine | None, label: str = ""):
        self.file, self.machine = file, machine
        self.notes: list[str] = []
        self.rate: float | None = None
        self.numbered = False
        self.legs: Sequence[str] = LEGS
        self.entries: list[Entry] = [file.t] if file.t else []
        self._imu()
        self._joints(commanded=label != "" and _is_command(label))
        self._feet()

    def _of(self, *kinds: str) -> dict[str, Named]:
        return {n: named for n, named in self.file.names.items() if named.kind in kinds}

    def _imu(self) -> None:
        triples = {}
        for kind in ("gyro", "accel"):
            own = {n: one for n, one in self._of(kind).items() if not one.leg and not one.commanded}
            axes = _axes(own)
            if axes is not None:
                triples[kind] = axes
            elif own:
                self.notes.append(f"which of {', '.join(own)} are the {kind}'s x, y and z?")
        values = {
            kind: np.column_stack([self.file.columns[n] for n in names])
            for kind, names in triples.items()
        }
        if "gyro" in triples:
            said = {self.file.names[name].unit for name in triples["gyro"]}
            unit, doubt = _gyro_unit(self.file.seconds, values["gyro"], values.get("accel"), said)
            for axis, name in zip("xyz", triples["gyro"], strict=True):
                self.entries.append(Entry(f"gyro_{axis}", name, unit, doubt=doubt))
        if "accel" in triples:
            unit, gain, doubt = _accel_unit(values["accel"])
            down = _gravity_doubt(values["accel"].mean(axis=0))
            for axis, name in zip("xyz", triples["accel"], strict=True):
                why = doubt or down.get(axis, "")
                self.entries.append(Entry(f"accel_{axis}", name, unit, gain=gain, doubt=why))

    def _joints(self, commanded: bool) -> None:
        poses = {one.leg for one in self._of("ref_q").values()}
        groups: dict[str, dict[str, tuple[str, str]]] = {}
        found = self._of("q", "dq", "tau")
        found = {
            n: one
            for n, one in found.items()
            if not (one.axis or one.reference or (one.leg and one.leg in poses))
        }
        named = any(one.part or one.leg for one in found.values() if one.kind == "q")
        for name, one in found.items():
            if named and not (one.part or one.leg):
                continue
            kind = one.kind
            if one.commanded or commanded:
                kind = {"q": "q_des", "dq": "dq_des", "tau": "tau_ff"}[kind]
            joint, doubt = self._joint(name, one, found)
            if joint in groups.setdefault(kind, {}):
                first = groups[kind][joint][0]
                groups[kind][joint] = (first, f"this, or {name}?")
                continue
            groups[kind][joint] = (name, doubt)
        sides = self._sides(groups)
        if sides and self.numbered:
            # Whoever counts legs begins on the left or on the right: the strides say which.
            self.legs, sides = _OTHER_SIDE_FIRST, ""
            groups = {
                kind: {
                    _other_side(j): (name, _legs_doubt(self.legs)) for j, (name, _) in of.items()
                }
                for kind, of in groups.items()
            }
        for kind, joints in groups.items():
            self._kind(kind, joints, groups, sides)

    def _joint(self, name: str, one: Named, found: dict[str, Named]) -> tuple[str, str]:
        legs = {n.leg for n in found.values() if n.leg}
        leg = _leg(one.leg, legs)
        alike = [n for n in found.values() if n.kind == one.kind and n.commanded == one.commanded]
        # A word before the numbers of a list, as of the group it is in, names no joint.
        part = "" if len({n.place for n in alike if n.part == one.part}) > 1 else one.part
        if leg:
            places = ("hip", "thigh", "calf")
            part = one.part or ("" if one.place is None else places[one.place % 3])
            joint = f"{leg if leg in LEGS else one.written}_{part}".rstrip("_")
            return joint, "" if one.part else f"which joint of {leg} is {name}?"
        if part:
            return part, ""
        if one.place is None or len(alike) == 1:
            return "joint", "" if len(alike) == 1 else f"which joint is {name}?"
        # Whether they count from 0 or from 1, and by legs first or not.
        order = sorted((n.limb or 0, n.place or 0) for n in alike)
        return self._numbered(order.index((one.limb or 0, one.place)), len(alike))

    def _numbered(self, place: int, count: int) -> tuple[str, str]:
        """The name of a joint that has only a number: by a list, by the robot, or the usual."""
        for name, there in {**self.file.lists, **_lists_beside(self.file.path)}.items():
            if len(there) == count:
                return there[place % count], f"are its joints in the order of {name}?"
        if self.machine is not None:
            joints = self.machine.limbs.joints
            if len(joints) == count:
                return joints[place % count], f"are its joints in the order of {self.machine.name}?"
        if count == len(JOINTS):
            self.numbered = True
            return JOINTS[place % count], _legs_doubt(self.legs)
        return f"joint{place}", "which joint is it?"

    def _sides(self, groups: dict[str, dict[str, tuple[str, str]]]) -> str:
        """A doubt where the strides in turns say that left and right are the other way round."""
        rates = [e for e in self.entries if e.name == "gyro_z"]
        if not rates or self.file.seconds is None:
            return ""
        yaw = rates[0].scale * self.file.columns[rates[0].theirs]
        left, right = (
            [self.file.columns[v[0]] for j, v in groups.get("q", {}).items() if j in thighs]
            for thighs in (("FL_thigh", "RL_thigh"), ("FR_thigh", "RR_thigh"))
        )
        if not (left and right):
            return ""
        outer = stride_in_turns(self.file.seconds, yaw, left, right)
        if outer is None or outer > 0.0:
            return ""
        return (
            "in left turns the strides on this robot's left are longer: are left and right swapped?"
        )

    def _kind(
        self,
        kind: str,
        joints: dict[str, tuple[str, str]],
        groups: dict[str, dict[str, tuple[str, str]]],
        sides: str,
    ) -> None:
        values = {j: self.file.columns[name] for j, (name, _) in joints.items()}
        said = {self.file.names[name].unit for name, _ in joints.values()}
        what = "q" if kind.startswith("q") else "dq" if kind.startswith("dq") else "tau"
        unit, doubt = "rad", ""
        prefix = kind
        if what == "q":
            unit, doubt = _angle_unit(values.values(), said)
        elif what == "dq":
            angles = groups.get("q" if kind == "dq" else "q_des", {})
            unit, doubt = self._rate_unit(values, angles)
        else:
            unit = "N m"
            most = max(float(np.quantile(np.abs(v), 0.99)) for v in values.values())
            doubt = "are these N m, or current?" if most > 300.0 else ""
            if all(v.min() >= 0.0 for v in values.values()) and most > 0.0:
                prefix, unit, doubt = (
                    f"x_{kind}",
                    None,
                    "never negative: magnitudes, of which unit?",
                )
        for joint, (name, own) in joints.items():
            why = own or doubt or sides
            self.entries.append(Entry(f"{prefix}_{joint}", name, unit, doubt=why))

    def _rate_unit(
        self, values: dict[str, np.ndarray], angles: dict[str, tuple[str, str]]
    ) -> tuple[str, str]:
        """The unit of rates, from the change of their angles; without times, the rows' rate too."""
        both = [j for j in values if j in angles]
        if not both:
            most = max(float(np.quantile(np.abs(v), 0.99)) for v in values.values())
            return ("rad/s", "rad/s or deg/s?") if most < 60.0 else ("deg/s", "deg/s or rad/s?")
        q = np.column_stack([self.file.columns[angles[j][0]] for j in both])
        scale = 1.0 if _angle_unit(list(q.T), set())[0] == "rad" else DEGREE
        rows = np.arange(len(q)) / 1.0
        t = self.file.seconds if self.file.seconds is not None else rows * 0.005
        window = max(JOINT_WINDOW, 5.0 * float(np.median(np.diff(t))))
        change = scale * derivative(t, q, window, causal=False)
        rates = np.column_stack([values[j] for j in both])
        alike = np.sum(change * rates) / max(np.linalg.norm(change) * np.linalg.norm(rates), 1e-12)
        ratio = np.sum(change * rates) / max(float(np.sum(rates**2)), 1e-12)
        if abs(alike) < _AGREE:
            return "rad/s", "does not follow its angle: of which joint, in which unit?"
        if self.file.seconds is None:
            # In rad/s, taken as given, and rows of 5 ms: the ratio is 200 Hz over their rate.
            self.rate = float(f"{200.0 / abs(ratio):.3g}") if abs(ratio) > 1e-3 else None
            return "rad/s", "rad/s, if the rate of the rows is right?"
        for unit, size in UNITS["dq"].items():
            if 1.0 / _NEAR < abs(ratio) / size < _NEAR:
                return unit, "" if ratio > 0.0 else "counts against its angle: sign = -1?"
        return "rad/s", f"is {1.0 / ratio:.3g} times the change of its angle: in which unit?"

    def _feet(self) -> None:
        found = self._of("contact", "force", "foot")
        legs = {one.leg for one in self.file.names.values() if one.leg}
        for kind in ("contact", "force"):
            own = {n: one for n, one in found.items() if one.kind == kind and one.leg}
            own = {n: one for n, one in own.items() if one.axis in ("", "z")}
            plain = {n: one for n, one in own.items() if not one.part}
            # A name in front of all of them, of the robot, says nothing.
            own = own if not plain and len({one.leg for one in own.values()}) == len(own) else plain
            counted = [n for n, one in found.items() if one.kind == kind and _is_counted(one)]
            if not own and len(counted) == len(self.legs):
                counted.sort(key=lambda n: found[n].place or found[n].limb or 0)
                prefix = self._foot_prefix(kind, counted)
                self.entries += [
                    Entry(f"{prefix}_{leg}", n, doubt=_legs_doubt(self.legs))
                    for leg, n in zip(self.legs, counted, strict=True)
                ]
            vectors = {
                one.leg for one in found.values() if one.kind == kind and one.axis in ("x", "y")
            }
            for name, one in own.items():
                if one.leg in vectors:
                    continue
                prefix = self._foot_prefix(kind, [name])
                doubt = "" if prefix == kind else "is not 0 or 1: a force?"
                self.entries.append(Entry(f"{prefix}_{_leg(one.leg, legs)}", name, doubt=doubt))
        feet = {n: one for n, one in found.items() if one.kind == "foot" and one.leg and one.axis}
        for name, one in feet.items():
            most = max(float(np.abs(self.file.columns[n]).max()) for n in feet)
            unit = "m" if most < 3.0 else "mm"
            self.entries.append(Entry(f"foot_{_leg(one.leg, legs)}_{one.axis}", name, unit))
        if feet:
            self.notes.append("are foot_<leg> along the IMU's axes, from its origin?")

    def _foot_prefix(self, kind: str, names: Sequence[str]) -> str:
        """contact or force, as these columns' numbers say."""
        binary = all(np.isin(self.file.columns[n], (0.0, 1.0)).all() for n in names)
        return "force" if kind == "contact" and not binary else kind


def _is_counted(one: Named) -> bool:
    """Whether a foot's column has a number in place of its leg."""
    return not (one.leg or one.part or one.axis or (one.place is None and one.limb is None))


def _other_side(joint: str) -> str:
    """The name of the joint across the body of a quadruped's."""
    return joint[0] + {"L": "R", "R": "L"}[joint[1]] + joint[2:]


def _legs_doubt(legs: Sequence[str]) -> str:
    return f"are its legs {', '.join(legs)}, each hip, thigh, calf?"


def stride_in_turns(
    t: np.ndarray, yaw: np.ndarray, left: Sequence[np.ndarray], right: Sequence[np.ndarray]
) -> float | None:
    """How the strides of right legs grow over those of left ones with the rate of turning to the
    left, in log units per rad/s: positive, for the outer legs go further. None where it cannot be
    told.

    Args:
        t: (N,) [s].
        yaw: (N,) rate of turning to the left [rad/s].
        left: angles (N,) of the left legs' thighs, in any unit.
        right: of the right legs'.
    """
    edges = np.arange(t[0], t[-1], _STRIDES)
    parts = np.split(np.arange(len(t)), np.searchsorted(t, edges[1:]))
    parts = [rows for rows in parts if len(rows) > 10]
    sizes = [[np.mean([np.std(v[rows]) for v in side]) for rows in parts] for side in (left, right)]
    turning = np.array([yaw[rows].mean() for rows in parts])
    strides = np.array(sizes)
    walking = strides.min(axis=0) > 0.3 * np.median(strides)
    if walking.sum() < 4 or np.std(turning[walking]) < _CAN_TURN:
        return None
    more = np.log(strides[1] / np.maximum(strides[0], 1e-12))[walking]
    turning = turning[walking]
    if abs(np.corrcoef(turning, more)[0, 1]) < _AGREE:
        return None
    return float(np.polyfit(turning, more, 1)[0])


def _axes(own: dict[str, Named]) -> tuple[str, ...] | None:
    """The three columns of a vector in the order x, y, z; None where it is not clear."""
    along = [(one.axis, name) for name, one in own.items() if one.axis]
    if len(along) == 3 and set(dict(along)) == set("xyz"):
        return tuple(dict(along)[axis] for axis in "xyz")
    by_place = {one.place: name for name, one in own.items() if one.place is not None}
    if len(own) == 3 and len(by_place) == 3:
        return tuple(by_place[place] for place in sorted(by_place))
    return None


def _accel_unit(accel: np.ndarray) -> tuple[str, float, str]:
    size = float(np.median(np.linalg.norm(accel, axis=1)))
    if 8.0 < size < 12.0:
        return "m/s^2", 1.0, ""
    for unit, one in (("g", 1.0), ("mg", 1e3)):
        if 0.8 * one < size < 1.2 * one:
            return unit, 1.0, ""
    gain = float(f"{STANDARD_GRAVITY / max(size, 1e-9):.4g}")
    return "m/s^2", gain, f"its length is {size:.3g} at rest: in which unit?"


def _gravity_doubt(mean: np.ndarray) -> dict[str, str]:
    """By axis, what is doubtful of the direction of gravity."""
    axis = int(np.argmax(np.abs(mean)))
    if axis == 2 and mean[2] > 0.0:
        return {}
    where = f"gravity reads {'+' if mean[axis] > 0 else '-'} on {'xyz'[axis]}"
    if axis == 2:
        why = (
            f"{where}: an IMU upside down ([robot] imu_orientation), the sign, or gravity itself"
            " (offset = 19.62)?"
        )
        return {"z": why, "x": why, "y": why}
    return dict.fromkeys("xyz", f"{where}: give [robot] imu_orientation, or other axes?")


def _gyro_unit(
    t: np.ndarray | None, gyro: np.ndarray, accel: np.ndarray | None, said: set[str]
) -> tuple[str, str]:
    """From how fast gravity turns in the accelerometer, or else as the names say (`said`), or by
    the size."""
    size = float(np.quantile(np.abs(gyro), 0.99))
    named = next(iter(said)) if len(said) == 1 and said <= set(UNITS["gyro"]) else ""
    by_size = named or ("rad/s" if size < 12.0 else "deg/s")
    if t is not None and accel is not None:
        dt = max(float(np.median(np.diff(t))), 1e-6)
        width = max(int(0.5 / dt), 1)
        smooth = np.column_stack([_smoothed(x, width) for x in accel.T])
        up = smooth / np.maximum(np.linalg.norm(smooth, axis=1, keepdims=True), 1e-9)
        turned = np.gradient(up, t, axis=0)[width:-width]
        rate = np.column_stack([_smoothed(x, width) for x in gyro.T])[width:-width]
        by_gyro = -np.cross(rate, up[width:-width])
        both = float(np.linalg.norm(turned) * np.linalg.norm(by_gyro))
        alike = float(np.sum(turned * by_gyro)) / max(both, 1e-12)
        ratio = float(np.sum(turned * by_gyro)) / max(float(np.sum(by_gyro**2)), 1e-12)
        if alike > 0.7 and 1 / 3 < ratio < 3:
            return "rad/s", ""
        if alike > 0.7 and 1 / 3 < ratio / DEGREE < 3:
            return "deg/s", ""
        if alike < -0.7:
            return by_size, "turns against the accelerometer: signs of one of them?"
    return by_size, "" if named or not 4.0 < size < 60.0 else "rad/s or deg/s?"


def _angle_unit(values, said: set[str]) -> tuple[str, str]:
    if "deg" in said:
        return "deg", ""
    if "rad" in said:
        return "rad", ""
    most = max(float(np.quantile(np.abs(v), 0.99)) for v in values)
    if most > 800.0:
        return "rad", f"reaches {most:.3g}: counts, with which gain?"
    if most > _LARGEST_ANGLE:
        return "deg", ""
    return "rad", "" if most < _SURE_ANGLE else "rad or deg?"


def _reference(one: _File) -> tuple[Entry, ...]:
    """Entries of a pose, of a bag those of one topic: the one whose name says that it is tracked,
    or else the first that has a pose."""
    if not is_bag(one.path):
        return _pose(one)
    topics = list(dict.fromkeys(name.partition(":")[0] for name in one.recorded))
    topics.sort(key=lambda topic: not read_name(topic.strip("/") + "/x").reference)
    for topic in topics:
        columns = {n: v for n, v in one.recorded.items() if n.startswith(f"{topic}:")}
        t = _time_of_topic(topic, columns, one.names)
        names = {n: one.names[n] for n in columns}
        if found := _pose(replace(one, columns=columns, names=names, t=t)):
            return found
    return ()


def _pose(one: _File) -> tuple[Entry, ...]:
    """Entries of a pose: three places, and four or three numbers of an attitude."""
    t = one.t
    if t is None:
        return ()
    own = {n: named for n, named in one.names.items() if not named.leg and not named.commanded}
    inertial = any(named.kind in ("gyro", "q") and not named.reference for named in own.values())
    place = {n: x for n, x in own.items() if x.kind == "ref_p"}
    if not place:
        place = {
            n: x
            for n, x in own.items()
            if x.kind == "q" and (x.reference or (x.axis and not inertial))
        }
    p = _axes(place)
    if p is None:
        return ()
    most = max(float(np.ptp(one.columns[n])) for n in p)
    said = {own[n].unit for n in p} & set(UNITS["ref_p"])
    unit = said.pop() if len(said) == 1 else "m" if most < 50.0 else "mm"
    found = [Entry(f"ref_p_{a}", n, unit) for a, n in zip("xyz", p, strict=True)]
    turned = {n: x for n, x in own.items() if x.kind == "ref_q"}
    by_axis = {x.axis: n for n, x in turned.items() if x.axis}
    euler = {x.part: n for n, x in own.items() if x.kind == "euler"}
    places = sorted((x.place, n) for n, x in turned.items() if x.place is not None)
    if set(by_axis) == set("wxyz"):
        found += [Entry(f"ref_q_{a}", by_axis[a]) for a in "wxyz"]
    elif set(euler) >= {"roll", "pitch", "yaw"}:
        unit, doubt = _angle_unit([one.columns[euler["yaw"]]], set())
        found += [Entry(f"ref_{n}", euler[n], unit, doubt=doubt) for n in ("roll", "pitch", "yaw")]
    elif len(places) == 4:
        q = np.column_stack([one.columns[n] for _, n in places])
        said = [one for one in ("wxyz", "xyzw") if all(one in words_of(n) for _, n in places)]
        first = np.mean(np.abs(q[:, 0])) > np.mean(np.abs(q[:, 3]))
        why = "" if said else "is w the first, or the last?"
        order = said[0] if said else "wxyz" if first else "xyzw"
        found += [
            Entry(f"ref_q_{a}", n, doubt=why) for a, (_, n) in zip(order, places, strict=True)
        ]
    elif len(places) == 3:
        unit, _ = _angle_unit([one.columns[n] for _, n in places], set())
        why = "roll, pitch, yaw in this order?"
        angles = zip(("roll", "pitch", "yaw"), places, strict=True)
        found += [Entry(f"ref_{a}", n, unit, doubt=why) for a, (_, n) in angles]
    else:
        return ()
    return (t, *found)


def _complete(entries: list[Entry]) -> tuple[list[Entry], list[str]]:
    """Without the kinds of joints' columns that not every joint has, which no log may have."""
    joints = {
        e.name[2:] for e in entries if e.name.startswith("q_") and not e.name.startswith("q_des_")
    }
    kept, said = list(entries), []
    for prefix in ("dq_des_", "q_des_", "tau_ff_", "dq_", "tau_"):
        own = {e.name for e in kept if e.name.startswith(prefix)}
        own = {n for n in own if prefix != "dq_" or not n.startswith("dq_des_")}
        own = {n for n in own if prefix != "tau_" or not n.startswith("tau_ff_")}
        if own and {n.removeprefix(prefix) for n in own} != joints:
            kept = [e for e in kept if e.name not in own]
            said.append(f"{', '.join(sorted(own)[:3])}: not of every joint, left out")
    return kept, said


def _threshold(main: _File, entries: list[Entry]) -> tuple[float, float] | None:
    forces = [main.columns[e.theirs] for e in entries if e.name.startswith("force_")]
    if not forces or any(e.name.startswith("contact_") for e in entries):
        return None
    low, high = np.quantile(np.concatenate(forces), (0.1, 0.9))
    return float(low + 0.5 * (high - low)), float(low + 0.4 * (high - low))


def _overlap(main: _File, at: _File) -> list[str]:
    if main.seconds is None or at.seconds is None:
        return []
    if at.seconds[0] > main.seconds[-1] or at.seconds[-1] < main.seconds[0]:
        return ["the reference's clock is another: which [reference] offset?"]
    return []


def _leg(name: str, legs: set[str]) -> str:
    """A leg's name: of a robot that has no rear legs, the front ones are left and right."""
    if name in ("FL", "FR") and not legs & {"RL", "RR"}:
        return "left" if name == "FL" else "right"
    return name


def _is_command(label: str) -> bool:
    return any(word in label.lower() for word in ("cmd", "command", "control", "target", "des"))


def _is_number(text: object) -> bool:
    try:
        float(str(text))
    except ValueError:
        return False
    return True


def _smoothed(x: np.ndarray, width: int) -> np.ndarray:
    return np.convolve(x, np.ones(width) / width, mode="same")


def _lines(entries: Sequence[Entry]) -> list[str]:
    """Lines of entries; a doubt stands above the first of those that share it, and marks each."""
    lines, above = [], ""
    for entry in entries:
        if entry.doubt and entry.doubt != above:
            lines.append(f"# ? {' '.join(entry.doubt.split())}")
        above = entry.doubt
        lines.append(_line(entry))
    return lines


def _line(entry: Entry) -> str:
    keys = [f"column = {_text(entry.theirs)}"]
    keys += [f'unit = "{entry.unit}"'] if entry.unit else []
    keys += [f"sign = {entry.sign:g}"] if entry.sign != 1.0 else []
    keys += [f"gain = {entry.gain:g}"] if entry.gain != 1.0 else []
    keys += [f"offset = {entry.offset:g}"] if entry.offset else []
    return f"{_key(entry.name)} = {{ {', '.join(keys)} }}" + (" # ?" if entry.doubt else "")


def _key(name: str) -> str:
    plain = all(c.isalnum() or c in "_-" for c in name)
    return name if plain else _text(name)


def _text(text: str) -> str:
    """A text in TOML, whose basic strings escape as JSON's do."""
    return json.dumps(text, ensure_ascii=False)
