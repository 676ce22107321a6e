"""Import a recording of any files as a Log, by an import map (`sim.importing.map`)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from surefoot.sim.common.errors import SurefootError, errors_in
from surefoot.sim.common.files import is_file
from surefoot.sim.common.quaternion import quaternion_from_matrix
from surefoot.sim.importing.assemble import RawRecording
from surefoot.sim.importing.clock import (
    Columns,
    Stamped,
    column_kind,
    epoch_of,
    gap_lines,
    kept_rows,
    on_clock,
    outside_lines,
    seconds,
)
from surefoot.sim.importing.columns import MapColumn
from surefoot.sim.importing.map import ImportMap
from surefoot.sim.importing.readers.bag import is_bag
from surefoot.sim.importing.readers.file import read_file
from surefoot.sim.importing.readers.table import NoReadings, RecordedTable, column_readings
from surefoot.sim.importing.reference import poses_of, reference_offset
from surefoot.sim.importing.sections import Source
from surefoot.sim.log import Log
from surefoot.sim.log.reference import Poses
from surefoot.sim.robot import Robot
from surefoot.sim.robot.catalog import SUFFIXES, machine_file, model_metadata

_MAY_LACK = ("dq", "tau", "q_des", "dq_des", "tau_ff", "x")
"""Kinds of columns without which a log is complete."""
Files = str | Path | Sequence[str | Path]
STEM = "{name}"
"""Placeholder in the name of a further file for the main one's name, without its suffix."""


def import_log(files: Files, map_path: str | Path, robot: str | None = None) -> Log:
    """Import a recording as a log.

    files: its main file or the folder that contains it, then further files that the map does not
    name, in the map's order. `map_path` is a map's file or the name of a bundled map. `robot`, a
    name or file, takes the place of the map's. Rows outside the reference are cut. Raises
    SurefootError (LogError) in one line with file, column and row.
    """
    return read_recording(files, map_path, robot).log()


def read_recording(files: Files, map_path: str | Path, robot: str | None = None) -> RawRecording:
    """Read a recording with all rows and poses, before `import_log` assembles it. Raises
    likewise.
    """
    rules = ImportMap.read(map_path)
    paths = [Path(files)] if isinstance(files, str | Path) else [Path(one) for one in files]
    # Files that the map names may be given too, in any order.
    given = {path.name: path for path in paths}
    first = given.get(rules.sections.source.file or "", paths[0])
    main = _main_file(first, rules)
    sources = (*rules.sections.sources.values(), rules.sections.reference)
    named = {one.file.replace(STEM, main.stem) for one in sources if one and one.file}
    further = iter([path for path in paths if path is not first and path.name not in named])

    def file_of(source: Source) -> Path | None:
        """The file that the map names or, where it names none, the next one given."""
        if source.file is None:
            return next(further, None)
        name = source.file.replace(STEM, main.stem)
        return given.get(name, main.parent / name)

    notes, poses = list[str](), None
    streams, clock = _streams(main, rules.sections.source, rules, None, notes)
    for name, source in rules.sections.sources.items():
        path = file_of(source)
        if path is None:
            raise SurefootError(f"{rules.path}: [sources.{name}] has no file, and none is given")
        streams |= _streams(path, source, rules, name, notes)[0]
    epoch = epoch_of(clock)
    if epoch:
        notes.append(f"t: counts from {seconds(epoch)} s of the recording's clock")
    if rules.sections.reference is not None:
        poses = _reference(file_of(rules.sections.reference), main, rules, notes)
        poses = replace(poses, t=poses.t - epoch)
    if (extra := next(further, None)) is not None:
        raise SurefootError(f"{extra}: {rules.path} has no use for this file")
    clock = clock - epoch
    streams = {column: (stamps - epoch, values) for column, (stamps, values) in streams.items()}
    shared = on_clock(clock, streams, str(main))
    rules = _with_robots_file(rules, main, robot)
    kept = {name: shared[name] for name in ("t", *rules.columns) if name in shared}
    notes += gap_lines(clock, streams)
    if poses is not None:
        notes += outside_lines(kept, poses.t + reference_offset(rules, main.stem))
    return RawRecording(kept, poses, rules, main, tuple(notes))


def _main_file(path: Path, rules: ImportMap) -> Path:
    inside = path / (rules.sections.source.file or "")
    if is_file(inside) or is_bag(path) or not path.is_dir():
        return inside if is_file(inside) else path
    if inside == path:
        raise SurefootError(f"{path}: is a folder, and {rules.path} has no [source] file")
    return inside


def _with_robots_file(rules: ImportMap, main: Path, given: str | None) -> ImportMap:
    """The map with the name of its robot, or of the `given` one, and with the metadata of its file
    where that is a file.

    Raises SurefootError where the robot cannot be found.
    """
    if given is not None:
        rules = replace(rules, robot=given)
    if rules.robot is None:
        return rules
    folders = (Path.cwd(),) if given is not None else (rules.path.parent, main.parent, Path.cwd())
    for file in (folder / rules.robot for folder in folders):
        if file.suffix in SUFFIXES and is_file(file):
            model = rules.model | model_metadata(file.stem, file.resolve())
            return _with_imu_of(file, replace(rules, robot=file.stem, model=model))
    with errors_in("--robot" if given is not None else f"{rules.path}: [robot] name"):
        return _with_imu_of(machine_file(rules.robot), rules)


def _with_imu_of(file: Path, rules: ImportMap) -> ImportMap:
    """The map with what it lacks of the IMU's place from the robot's file, where its reference is
    of the base.
    """
    reference = rules.sections.reference
    if reference is None or reference.frame != "base" or {"p_BI", "q_BI"} <= rules.model.keys():
        return rules
    try:
        robot = Robot.load(file, rules.model.get("feet"))
    except SurefootError:  # said by the commands that need its legs
        return rules
    if robot.imu is None:
        return rules
    place = {"p_BI": robot.p_BI.tolist(), "q_BI": quaternion_from_matrix(robot.R_BI).tolist()}
    return replace(rules, model=place | rules.model)


@dataclass(frozen=True)
class _Rows:
    """Columns of a file that have readings in the same rows.

    Attributes:
        topic: of a bag; "" of any other file.
        columns: of the log, in SI, and their times `t` [s], each (M,).
        numbers: of the rows in the file, (M,).
    """

    topic: str
    columns: Columns
    numbers: np.ndarray


def _streams(
    path: Path, source: Source, rules: ImportMap, name: str | None, notes: list[str]
) -> tuple[dict[str, Stamped], np.ndarray]:
    """Columns of a file by the log's names, in SI; and times of its rows, if the log has them.
    Adds to the notes.
    """
    columns = {n: c for n, c in rules.columns.items() if c.source == name and n != "t"}
    clock = rules.columns.get("t") if name is None else rules.clocks.get(name)
    if name and is_bag(path):  # which has clocks of its own
        clock = None
    elif clock is None and source.rate is None:
        raise SurefootError(f"{rules.path}: [sources.{name}] t or rate is missing")
    table, read = _read(path, source, columns, clock, notes)
    if table.stamps and source.rate is not None:
        raise SurefootError(f"{rules.path}: [source] rate does not go with a bag")
    leading = table.topic(clock.theirs) if clock else ""
    found: dict[str, Stamped] = {}
    for one in read:
        stamps = one.columns["t"]
        found |= {n: (stamps, values) for n, values in one.columns.items() if n != "t"}
        attitude = next((n for n in one.columns if n.startswith("ref_q_")), "")
        if attitude and clock and one.topic != leading:
            raise SurefootError(
                f"{path}: {attitude} is of another topic than t: give a [reference]"
            )
    # If columns have different rows, the log's are those of the most frequent one.
    first = max((x for x in read if x.topic == leading), key=lambda x: len(x.numbers), default=None)
    return found, np.zeros(0) if first is None else first.columns["t"]


def _reference(path: Path | None, main: Path, rules: ImportMap, notes: list[str]) -> Poses:
    """Poses in the reference's own rows, of its own or the main file. Adds to the notes."""
    columns, source = dict(rules.reference_columns), rules.sections.reference
    assert source is not None
    if path is None or path == main:
        path, said, unsaid = main, vars(source), vars(Source())
        main_layout = vars(rules.sections.source)
        source = replace(source, **{k: main_layout[k] for k in unsaid if said[k] == unsaid[k]})
    clock = columns.pop("t", None)
    table, read = _read(path, source, columns, clock, notes)
    if len(read) > 1:
        topics = " and ".join(sorted({one.topic for one in read}))
        raise SurefootError(
            f"{path}: [reference.columns] are of {topics or 'other rows'};"
            " t, ref_p and ref_q share their topic and rows"
        )
    return poses_of(read[0].columns, path, table.row, read[0].numbers, notes)


def _read(
    path: Path,
    source: Source,
    columns: Mapping[str, MapColumn],
    clock: MapColumn | None,
    notes: list[str],
) -> tuple[RecordedTable, list[_Rows]]:
    """Read columns of a file, together those that share their rows, and the times of the clock
    alone where no column does.

    Raises SurefootError naming file, column and row.

    Args:
        path: of the file.
        source: of the map.
        columns: by the log's names.
        clock: of the rows; None for the messages' own in a bag, and for the source's rate.
        notes: to which what is left out is added.
    """
    table = read_file(path, source, {one.theirs for one in (*columns.values(), clock) if one})
    times, leading = dict(table.stamps), table.topic(clock.theirs) if clock else ""
    if clock:
        plain = Source(names=source.names)
        times[leading] = clock.read(column_readings(table, clock.theirs, plain)[1])
    elif not table.stamps:
        times[""] = np.arange(max(map(len, table.cells.values()), default=0)) / (source.rate or 1.0)
    groups: dict[tuple[str, bytes], tuple[np.ndarray, Columns]] = {}
    blank: dict[str, SurefootError] = {}
    for name, column in columns.items():
        topic = table.topic(column.theirs)
        try:
            rows, values = column_readings(table, column.theirs, source, column.word)
        except NoReadings as error:
            blank[name] = error
            continue
        count = rows[-1] + 1 if len(rows) else 0
        if count > len(times[topic]) or (count < len(times[topic]) and not source.scattered):
            raise SurefootError(
                f"{path}: column {column.theirs!r} has {count} rows, the times {len(times[topic])}"
            )
        key = topic, rows.tobytes() if source.scattered else b""
        groups.setdefault(key, (rows, {}))[1][name] = column.read(values)
    if leading in times and leading not in {topic for topic, _ in groups}:
        groups[leading, b""] = np.arange(len(times[leading])), {}
    found = []
    for (topic, _), (rows, members) in groups.items():
        named = columns[next(iter(members))] if members else clock
        named = clock if topic == leading and not source.scattered else named
        where = f"{path}: column {named.theirs if named else 't'!r}"
        t, numbers = times[topic][rows], rows + table.first
        kept, note = kept_rows(t, [*members.values()], where, table.row, numbers)
        notes += [note] * bool(note)
        in_rows = {"t": t[kept]} | {name: values[kept] for name, values in members.items()}
        found.append(_Rows(topic, in_rows, numbers[kept]))
    there = {column_kind(name) for one in found for name in one.columns}
    for name, error in blank.items():
        if column_kind(name) not in _MAY_LACK or column_kind(name) in there:
            raise error
    if blank:
        notes.append(f"{path}: left out, NaN or empty throughout: {', '.join(blank)}")
    return table, found
