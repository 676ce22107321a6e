"""Draft an import map from the files of a recording.

Names suggest what a column is, and values verify it (`guess_columns`, `guess_units`); uncertain
entries carry a question in the draft (`draft`). This module assigns the files: the main file,
further ones with columns of their own, and the reference.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.importing.bag import is_bag
from surefoot.sim.importing.columns import EULER, UNITS
from surefoot.sim.importing.draft import Draft, Entry
from surefoot.sim.importing.guess_columns import guess_columns, three_axes
from surefoot.sim.importing.guess_units import unit_of_angles
from surefoot.sim.importing.names import read_name, words_of
from surefoot.sim.importing.recorded_file import RecordedFile, recorded_files, times_of_topic
from surefoot.sim.log.schema import joint_prefix
from surefoot.sim.robot.machine import load_machine

_FEW = 8
"""Largest number of columns that are listed for an unused file."""


def guess_map(files: Sequence[str | Path], robot: str | None = None) -> Draft:
    """Draft the map of some files; the first or the most complete is the main one.

    robot: of the recording; unnamed columns, and those named as in its file, are assigned to its
    joints. Raises SurefootError where a file cannot be read or none has numeric columns.
    """
    paths = [one for path in files for one in _parts(Path(path))]
    if not paths:
        raise SurefootError(f"{files[0]}: no .csv, .json or .mat in this folder")
    machine = load_machine(robot) if robot else None
    read = [one for path in paths for one in recorded_files(path, machine)]
    if not read:
        raise SurefootError(f"{paths[0]}: no columns of numbers in it")
    main = max(read, key=_richness)
    others = [one for one in read if one is not main]
    poses = [one for one in others if _reference(one) and _richness(one) == 0]
    notes: list[str] = []
    found = guess_columns(main, machine)
    entries = list(found.entries)
    sources: dict[str, tuple[Path, Entry]] = {}
    for one in others:
        if one in poses or one.t is None:
            continue
        label = one.label
        there = {"t", *(entry.name for entry in entries)}
        added = guess_columns(one, machine, commands=_is_command(label)).entries
        added = [e for e in added if e.name not in there]
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
    return Draft(
        files=tuple(dict.fromkeys((main.path, *(one.path for one in others)))),
        main=tuple(entries),
        reference=reference,
        reference_file=at.path if reference else None,
        sources=sources,
        layouts={one.path: one.layout for one in read},
        rate=found.rate if main.t is None else None,
        robot=robot,
        contact=_threshold(main, entries),
        notes=tuple(notes),
        unused=tuple(name for name in main.columns if name not in used),
    )


def _parts(path: Path) -> list[Path]:
    """A file or bag itself; the tables in a folder."""
    if path.is_dir() and not is_bag(path):
        return sorted(one for one in path.iterdir() if one.suffix in (".csv", ".json", ".mat"))
    return [path]


def _richness(one: RecordedFile) -> int:
    names = one.names.values()
    inertial = sum(n.kind in ("gyro", "accel") for n in names)
    measured = [n for n in names if n.kind in ("q", "dq", "tau") and not n.reference]
    joints = sum(n.kind != "q" or not n.axis for n in measured)
    return 100 * inertial + joints * (10 if any(n.commanded for n in names) else 11)


def _reference(one: RecordedFile) -> tuple[Entry, ...]:
    """Entries of a pose; in a bag, those of one topic, preferably one named as a tracked body."""
    if not is_bag(one.path):
        return _pose(one)
    topics = list(dict.fromkeys(name.partition(":")[0] for name in one.recorded))
    topics.sort(key=lambda topic: not read_name(topic.strip("/") + "/x").reference)
    for topic in topics:
        columns = {n: v for n, v in one.recorded.items() if n.startswith(f"{topic}:")}
        t = times_of_topic(topic, columns, one.names)
        names = {n: one.names[n] for n in columns}
        if found := _pose(replace(one, columns=columns, names=names, t=t)):
            return found
    return ()


def _pose(one: RecordedFile) -> tuple[Entry, ...]:
    """Entries of a pose: three positions, and four or three values of an attitude."""
    t = one.t
    if t is None:
        return ()
    own = {n: named for n, named in one.names.items() if not named.leg and not named.commanded}
    inertial = any(named.kind in ("gyro", "q") and not named.reference for named in own.values())
    positions = {n: x for n, x in own.items() if x.kind == "ref_p"} or {
        n: x for n, x in own.items() if x.kind == "q" and (x.reference or (x.axis and not inertial))
    }
    p = three_axes(positions)
    if p is None:
        return ()
    most = max(float(np.ptp(one.columns[n])) for n in p)
    said = {own[n].unit for n in p} & set(UNITS["ref_p"])
    unit = said.pop() if len(said) == 1 else "m" if most < 50.0 else "mm"
    found = [Entry(f"ref_p_{a}", n, unit) for a, n in zip("xyz", p, strict=True)]
    attitude = {n: x for n, x in own.items() if x.kind == "ref_q"}
    by_axis = {x.axis: n for n, x in attitude.items() if x.axis}
    euler = {x.part: n for n, x in own.items() if x.kind == "euler"}
    places = sorted((x.place, n) for n, x in attitude.items() if x.place is not None)
    columns, unit, doubt = [n for _, n in places], None, ""
    if set(by_axis) == set("wxyz"):
        axes, columns = [f"ref_q_{a}" for a in "wxyz"], [by_axis[a] for a in "wxyz"]
    elif set(euler) >= {"roll", "pitch", "yaw"}:
        axes, columns = EULER, [euler[n] for n in ("roll", "pitch", "yaw")]
        unit, doubt = unit_of_angles([one.columns[euler["yaw"]]], set())
    elif len(places) == 4:
        said = [order for order in ("wxyz", "xyzw") if all(order in words_of(n) for n in columns)]
        first, last = (np.mean(np.abs(one.columns[n])) for n in (columns[0], columns[3]))
        doubt = "" if said else "is w the first, or the last?"
        order = said[0] if said else "wxyz" if first > last else "xyzw"
        axes = [f"ref_q_{a}" for a in order]
    elif len(places) == 3:
        unit, _ = unit_of_angles([one.columns[n] for n in columns], set())
        axes, doubt = EULER, "roll, pitch, yaw in this order?"
    else:
        return ()
    turned = [Entry(a, n, unit, doubt=doubt) for a, n in zip(axes, columns, strict=True)]
    return (t, *found, *turned)


def _complete(entries: list[Entry]) -> tuple[list[Entry], list[str]]:
    """Drop the kinds of joint columns that not every joint has, as a log may not have them."""
    joints = {e.name[2:] for e in entries if joint_prefix(e.name) == "q_"}
    kept, said = list(entries), []
    for prefix in ("dq_des_", "q_des_", "tau_ff_", "dq_", "tau_"):
        own = {e.name for e in kept if joint_prefix(e.name) == prefix}
        if own and {n.removeprefix(prefix) for n in own} != joints:
            kept = [e for e in kept if e.name not in own]
            said.append(f"{', '.join(sorted(own)[:3])}: not of every joint, left out")
    return kept, said


def _threshold(main: RecordedFile, entries: list[Entry]) -> tuple[float, float] | None:
    forces = [main.columns[e.theirs] for e in entries if e.name.startswith("force_")]
    if not forces or any(e.name.startswith("contact_") for e in entries):
        return None
    low, high = np.quantile(np.concatenate(forces), (0.1, 0.9))
    return float(low + 0.5 * (high - low)), float(low + 0.4 * (high - low))


def _overlap(main: RecordedFile, at: RecordedFile) -> list[str]:
    if main.seconds is None or at.seconds is None:
        return []
    apart = at.seconds[0] > main.seconds[-1] or at.seconds[-1] < main.seconds[0]
    return ["the reference's clock is another: which [reference] offset?"] * bool(apart)


def _is_command(label: str) -> bool:
    return any(word in label.lower() for word in ("cmd", "command", "control", "target", "des"))
