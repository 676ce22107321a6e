"""Draft an import map from the files of a recording.

Names suggest what a column is, and values verify it (`guess_columns`, `guess_units`); uncertain
entries carry a question in the draft (`draft`). This module assigns the files: the main file,
further ones with columns of their own, and the reference.
"""

from collections.abc import Mapping, Sequence, Set
from dataclasses import replace
from os.path import relpath
from pathlib import Path

import numpy as np

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.importing.clock import Columns
from surefoot.sim.importing.columns import EULER, UNITS
from surefoot.sim.importing.guessing.draft import Draft, Entry
from surefoot.sim.importing.guessing.entries import guess_columns, vectors
from surefoot.sim.importing.guessing.names import Named, lists_of, read_name, words_of
from surefoot.sim.importing.guessing.recorded_file import (
    RecordedFile,
    recorded_files,
    refuse_texts,
    times_of_topic,
)
from surefoot.sim.importing.guessing.units import unit_of_angles
from surefoot.sim.importing.readers.bag import is_bag
from surefoot.sim.importing.readers.table import topic_of
from surefoot.sim.log.schema import joint_prefix
from surefoot.sim.robot.catalog import SUFFIXES
from surefoot.sim.robot.machine import load_machine
from surefoot.sim.sensors.streams import SLOWEST

_FEW = 8
"""Largest number of columns that are listed for an unused file."""
_UNUSED = {
    **dict.fromkeys(("bias", "error", "parameter"), "biases, errors, parameters"),
    **dict.fromkeys(("estimate", "filtered"), "estimates, filtered values"),
    **dict.fromkeys(
        ("reference", "ref_p", "ref_q", "ref_v", "euler"),
        "motion of a body, no reading of a sensor",
    ),
    "command": "set points",
    "t": "other times, or too coarse or set back between rows",
    "other": "of no use in a log",
    "": "names not understood",
}
"""Source or kind of a column -> why it has no use."""
_POSES = {"reference": 0, "": 1, "estimate": 2}
"""Sources of poses, in the order in which they are a reference."""


def guess_map(
    files: Sequence[str | Path], robot: str | None = None, folder: Path | None = None
) -> Draft:
    """Draft the map of some files; the first or the most complete is the main one.

    Raises SurefootError where a file cannot be read or none has numeric columns.

    Args:
        files: of the recording.
        robot: its name or file; unnamed columns, and those named as in its file, are assigned to
            its joints.
        folder: in which the map will be, to which a robot's file is then relative.
    """
    paths = [one for path in files for one in _parts(Path(path))]
    if not paths:
        raise SurefootError(f"{files[0]}: no .csv, .json or .mat in this folder")
    machine = load_machine(robot) if robot else None
    read = [one for path in paths for one in recorded_files(path, machine)]
    if not read:
        refuse_texts(paths[0])
    main = max(read, key=_richness)
    others = [one for one in read if one is not main]
    poses = [one for one in others if _reference(one) and _richness(one) == 0]
    notes: list[str] = []
    entries, rate = guess_columns(main, notes)
    sources: dict[str, tuple[Path, Entry]] = {}
    for one in (one for one in others if one not in poses):
        label, there = one.label, {"t", *(entry.name for entry in entries)}
        added, _ = guess_columns(one, [], commands=read_name(label).commanded)
        added = [replace(e, theirs=f"{label}:{e.theirs}") for e in added if e.name not in there]
        if added and (clock := one.t or one.counter):
            sources[label] = (one.path, clock)
            entries += added
        else:
            columns = ", ".join([*one.columns][:_FEW])
            what = one.path.name if one.path != main.path else f"{label} in {one.path.name}"
            notes.append(f"nothing of {what} is used: what are its columns {columns}?")
    entries = _complete(entries, notes)
    at = poses[0] if poses else main
    reference = _reference(at)
    stated = None if main.t else main.stated or ((rate, "rates of joints") if rate else None)
    notes += _missing(main, entries, rated=stated is not None)
    # Columns of other files are named as in a map.
    labels = {"": main} | {f"{one.label}:": one for one in others}
    used = {entry.theirs for entry in entries}
    used |= {f"{label}:{clock.theirs}" for label, (_, clock) in sources.items()}
    used |= {stated[1]} if stated else set()
    used |= {f"{'' if at is main else at.label + ':'}{entry.theirs}" for entry in reference}
    columns = {f"{label}{n}": v for label, one in labels.items() for n, v in one.columns.items()}
    return Draft(
        file=main.path,
        main=tuple(entries),
        reference=reference,
        reference_file=at.path if reference else None,
        sources=sources,
        layouts={one.path: one.layout for one in read},
        rate=stated,
        robot=_robot_in_map(robot, folder) if robot else None,
        contact=_threshold(columns, entries),
        notes=tuple(notes),
        unused=_unused(labels, used),
    )


def _robot_in_map(robot: str, folder: Path | None) -> str:
    """A known robot's name, or the path of its file as a map in this folder has it."""
    if Path(robot).suffix not in SUFFIXES:
        return robot
    file = Path(robot).resolve()
    return (file if folder is None else Path(relpath(file, folder.resolve()))).as_posix()


def _parts(path: Path) -> list[Path]:
    """A file or bag itself; the tables in a folder."""
    if path.is_dir() and not is_bag(path):
        return sorted(one for one in path.iterdir() if one.suffix in (".csv", ".json", ".mat"))
    return [path]


def _richness(one: RecordedFile) -> int:
    names = one.names.values()
    inertial = sum(n.kind in ("gyro", "accel") and not n.source for n in names)
    joints = sum(n.kind in ("q", "dq", "tau") and not n.axis for n in names)
    return 100 * inertial + joints * (10 if any(n.commanded for n in names) else 11)


def _reference(one: RecordedFile) -> tuple[Entry, ...]:
    """Entries of a pose; in a bag, those of one topic, preferably one named as a tracked body, of
    transforms the one that travels farthest.
    """
    if not is_bag(one.path):
        return _pose(one)
    topics: dict[str, Columns] = {}
    for name, values in one.columns.items():
        topics.setdefault(topic_of(name), {})[name] = values

    def order(topic: str) -> tuple[int, float]:
        travelled = [np.ptp(x) for n, x in topics[topic].items() if ".translation." in n]
        source = read_name(f"{topic}/x").source
        return _POSES.get(source, 1), -float(max(travelled, default=np.inf))

    for topic in sorted(topics, key=order):
        columns = topics[topic]
        t = times_of_topic(topic, columns, one.names)
        names = {n: one.names[n] for n in columns}
        if found := _pose(replace(one, columns=columns, names=names, t=t)):
            return found
    return ()


def _pose(one: RecordedFile) -> tuple[Entry, ...]:
    """Entries of a pose: three positions, and four or three values of an attitude."""
    tracked = {n: x for n, x in one.names.items() if not x.leg and x.source in _POSES}
    positions = vectors({n: x for n, x in tracked.items() if x.kind == "ref_p"}, tuple(_POSES))
    t = one.t or one.counter
    if t is None or not positions:
        return ()
    p = positions[0]
    most = max(float(np.ptp(one.columns[n])) for n in p)
    said = {tracked[n].unit for n in p} & set(UNITS["ref_p"])
    unit = said.pop() if len(said) == 1 else "m" if most < 50.0 else "mm"
    source = tracked[p[0]].source
    doubt = "an estimate, no measurement: compare with it?" if source == "estimate" else ""
    found = [Entry(f"ref_p_{a}", n, unit, doubt=doubt) for a, n in zip("xyz", p, strict=True)]
    turned = {n: x for n, x in tracked.items() if x.kind in ("ref_q", "euler")}
    turned = {n: x for n, x in turned.items() if x.source == source}
    # That of the most words in common with the position.
    words = set(tracked[p[0]].stem.split())
    by_stem = lists_of(turned, "stem")
    for stem in sorted(by_stem, key=lambda stem: -len(words & {*stem[0].split()})):
        if entries := _attitude(one, by_stem[stem]):
            return (t, *found, *entries)
    return ()


def _attitude(one: RecordedFile, turned: Mapping[str, Named]) -> list[Entry]:
    """Entries of an attitude from columns of one stem; none where they are no attitude."""
    by_axis = {x.axis: n for n, x in turned.items() if x.kind == "ref_q" and x.axis}
    euler = {x.part.split("_")[-1]: n for n, x in turned.items() if x.kind == "euler"}
    places = sorted((x.place, n) for n, x in turned.items() if x.place is not None)
    columns, unit, doubt = [n for _, n in places], None, ""
    if set(by_axis) == set("wxyz"):
        axes, columns = [f"ref_q_{a}" for a in "wxyz"], [by_axis[a] for a in "wxyz"]
    elif set(euler) >= {"roll", "pitch", "yaw"}:
        axes, columns = EULER, [euler[n] for n in ("roll", "pitch", "yaw")]
        unit, doubt = unit_of_angles([one.columns[euler["yaw"]]], set())
    elif len(places) == 4:
        said = [order for order in ("wxyz", "xyzw") if all(order in words_of(n) for n in columns)]
        # Upright in a world with z up, whatever its heading, a body has x and y near 0.
        first, third = (np.mean(np.abs(one.columns[n])) for n in (columns[0], columns[2]))
        doubt = "" if said else "is w the first, or the last?"
        order = said[0] if said else "wxyz" if first > third else "xyzw"
        axes = [f"ref_q_{a}" for a in order]
    elif len(places) == 3:
        unit, _ = unit_of_angles([one.columns[n] for n in columns], set())
        axes, doubt = EULER, "roll, pitch, yaw in this order?"
    else:
        return []
    return [Entry(a, n, unit, doubt=doubt) for a, n in zip(axes, columns, strict=True)]


def _complete(entries: Sequence[Entry], notes: list[str]) -> list[Entry]:
    """The entries but for kinds of joint columns that not every joint has, as a log may not have
    them; these are noted.
    """
    joints = {e.name[2:] for e in entries if joint_prefix(e.name) == "q_"}
    kept = list(entries)
    for prefix in ("dq_des_", "q_des_", "tau_ff_", "dq_", "tau_"):
        of_kind = {e.name for e in kept if joint_prefix(e.name) == prefix}
        if of_kind and {n.removeprefix(prefix) for n in of_kind} != joints:
            kept = [e for e in kept if e.name not in of_kind]
            notes.append(f"{', '.join(sorted(of_kind)[:3])}: not of every joint, left out")
    return kept


def _missing(main: RecordedFile, entries: Sequence[Entry], rated: bool) -> list[str]:
    """Questions for what is missing beside what was found; `rated` says that the rate of the main
    file's rows is known, which have no times.
    """
    there = {entry.name for entry in entries}
    groups = {name.partition("_")[0] for name in there}
    legs = bool(main.limbs.legs) or any(
        one.leg for name in there for one in [read_name(name)] if joint_prefix(name)
    )
    found = []
    if groups <= {"t"}:
        found.append("no name says what a column is: which of those not used below is what?")
    if main.t is None and (main.counter or not rated):
        counts = f"{main.counter.theirs} counts rows" if main.counter else "no times found"
        found.append(f"{counts}: which [source] rate, or which column and gain of t?")
    times = np.zeros(0) if main.seconds is None else main.seconds
    step = np.median(np.diff(times)) if len(times) > 1 else 0.0
    if step > 1.0 / SLOWEST:
        found.append(
            f"rows at {1.0 / step:.3g} Hz are too slow for filters: is there a faster log?"
        )
    if len(half := {"gyro", "accel"} - groups) == 1:
        found.append(f"half an IMU: which columns are the {half.pop()}?")
    if legs and groups & {"gyro", "accel", "q"} and not groups & {"contact", "force"}:
        found.append(
            "legs without contacts: which columns are contacts or forces of the feet, or is"
            ' [contact] of "torque", "kinematics" or "gait"?'
        )
    return found


def _unused(files: Mapping[str, RecordedFile], used: Set[str]) -> dict[str, list[str]]:
    """Columns without a use, and what else the files contain, by the reason.

    Args:
        files: by the prefix of their columns in the map; those of which nothing is used are asked
            about instead.
        used: columns with a use, by their names in the map.
    """
    groups: dict[tuple[str, str, str], list[str]] = {}
    for label, one in files.items():
        if label and not any(f"{label}{name}" in used for name in one.columns):
            continue
        reasons = {
            name: _UNUSED.get(named.source or named.kind, "beside others of their kind")
            for name, named in one.names.items()
        }
        for name, reason in (reasons | dict(one.skipped)).items():
            if f"{label}{name}" not in used:
                stem = read_name(name).stem or name
                groups.setdefault((reason, label, stem), []).append(f"{label}{name}")
    found: dict[str, list[str]] = {}
    for (reason, _, _), names in groups.items():
        more = f" and {len(names) - 1} more" * (len(names) > 1)
        found.setdefault(reason, []).append(f"{names[0]}{more}")
    return found


def _threshold(columns: Columns, entries: Sequence[Entry]) -> tuple[float, float] | None:
    """Half of what a foot bears when all stand, which is the mean of its load; less to end."""
    forces = [columns[e.theirs] for e in entries if e.name.startswith("force_")]
    if not forces or any(e.name.startswith("contact_") for e in entries):
        return None
    unloaded, share = np.quantile(forces, 0.1), np.mean(forces)
    return float(unloaded + 0.5 * (share - unloaded)), float(unloaded + 0.4 * (share - unloaded))
