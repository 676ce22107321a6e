"""Import a recording of any files as a Log, by an import map (`sim.importing.map`)."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.files import is_file
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

_Rows = tuple[np.ndarray, np.ndarray]
"""Indices of rows, and the values there, both (M,)."""
_MAY_LACK = ("dq", "tau", "q_des", "dq_des", "tau_ff", "x")
"""Kinds of columns without which a log is complete."""
Files = str | Path | Sequence[str | Path]
STEM = "{name}"
"""Placeholder in the name of a further file for the main one's name, without its suffix."""


def import_log(files: Files, map_path: str | Path) -> Log:
    """Import a recording as a log.

    files: its main file or the folder that contains it, then further files that the map does not
    name, in the map's order. `map_path` is a map's file or the name of a bundled map. Rows outside
    the reference are cut. Raises SurefootError (LogError) in one line with file, column and row.
    """
    return read_recording(files, map_path).log()


def read_recording(files: Files, map_path: str | Path) -> RawRecording:
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

    streams, clock, notes = _streams(main, rules.sections.source, rules, None)
    for name, source in rules.sections.sources.items():
        path = file_of(source)
        if path is None:
            raise SurefootError(f"{rules.path}: [sources.{name}] has no file, and none is given")
        found, _, said = _streams(path, source, rules, name)
        streams |= found
        notes += said
    epoch, poses = epoch_of(clock), None
    if epoch:
        notes.append(f"t: counts from {seconds(epoch)} s of the recording's clock")
    if rules.sections.reference is not None:
        path = file_of(rules.sections.reference) or main
        poses, said = _reference(path, rules, shared=path == main)
        poses = replace(poses, t=poses.t - epoch)
        notes += said
    if (extra := next(further, None)) is not None:
        raise SurefootError(f"{extra}: {rules.path} has no use for this file")
    clock = clock - epoch
    streams = {column: (stamps - epoch, values) for column, (stamps, values) in streams.items()}
    shared = on_clock(clock, streams, str(main))
    rules = replace(rules, robot=_robot_file(rules, main))
    kept = {name: shared[name] for name in ("t", *rules.columns) if name in shared}
    notes += gap_lines(clock, streams)
    if poses is not None:
        notes += outside_lines(kept, poses.t + reference_offset(rules, main.stem))
    return RawRecording(kept, poses, rules, main, tuple(notes))


def _robot_file(rules: ImportMap, main: Path) -> str | None:
    """The robot's name or, for a file beside the map or the recording, its full path."""
    for folder in (rules.path.parent, main.parent):
        if rules.robot and Path(rules.robot).suffix and is_file(folder / rules.robot):
            return str((folder / rules.robot).resolve())
    return rules.robot


def _main_file(path: Path, rules: ImportMap) -> Path:
    inside = path / (rules.sections.source.file or "")
    if is_file(inside) or is_bag(path) or not path.is_dir():
        return inside if is_file(inside) else path
    if inside == path:
        raise SurefootError(f"{path}: is a folder, and {rules.path} has no [source] file")
    return inside


def _streams(
    path: Path, source: Source, rules: ImportMap, name: str | None
) -> tuple[dict[str, Stamped], np.ndarray, list[str]]:
    """Columns of a file by the log's names, in SI; times of its rows, if the log has them; and
    notes.
    """
    columns = {n: c for n, c in rules.columns.items() if c.source == name and n != "t"}
    clock = rules.columns.get("t") if name is None else rules.clocks.get(name)
    needed = [*columns.values(), *([clock] if clock and name is None else [])]
    table = read_file(path, source, {column.theirs for column in needed})
    bag = bool(table.stamps)
    if bag and source.rate is not None:
        raise SurefootError(f"{rules.path}: [source] rate does not go with a bag")
    if not bag and clock is None and source.rate is None:
        raise SurefootError(f"{rules.path}: [sources.{name}] t or rate is missing")
    # A further bag has clocks of its own.
    clock = None if bag and name else clock
    leading = table.topic(clock.theirs) if clock else ""
    times = dict(table.stamps)
    if clock or not bag:
        times[leading] = _times(table, clock, source)
        _check_attitude(table, columns, leading)
    alone = source.sparse or source.long is not None
    # Columns that share their stamps lose the same rows.
    groups: dict[tuple[str, str], dict[str, _Rows]] = (
        {} if alone or (bag and name) else {(leading, ""): {}}
    )
    blank: dict[str, SurefootError] = {}
    for log_name, column in columns.items():
        topic = table.topic(column.theirs)
        try:
            read = _rows(table, column, source, times[topic], alone)
        except NoReadings as error:
            blank[log_name] = error
            continue
        groups.setdefault((topic, log_name if alone else ""), {})[log_name] = read
    found: dict[str, Stamped] = {}
    t, first, notes = np.zeros(0), "", []
    for (topic, log_name), members in groups.items():
        column = columns[next(iter(members))] if alone or topic != leading else clock
        kept, _, said = _kept(table, members, times[topic], column)
        stamps = kept.pop("t")
        found |= {n: (stamps, values) for n, values in kept.items()}
        notes += said
        # If columns have different times, the rows are those of the most frequent one.
        if topic == leading and len(stamps) > len(t):
            t, first = stamps, log_name
    if alone and found:
        notes.append(f"rows: at the readings of {first}")
    return found, t, [*notes, *_blank_lines(path, blank, found)]


def _rows(
    table: RecordedTable, column: MapColumn, source: Source, times: np.ndarray, sparse: bool
) -> _Rows:
    """Rows and values of a column in SI.

    Raises SurefootError where there are more than times, or fewer, unless it is sparse.

    Args:
        table: of the file.
        column: of the map.
        source: of the map.
        times: of the rows [s].
        sparse: whether rows may be missing.
    """
    rows, values = column_readings(table, column.theirs, source, column.word)
    count = rows[-1] + 1 if len(rows) else 0
    if count > len(times) or (count < len(times) and not sparse):
        raise SurefootError(
            f"{table.path}: column {column.theirs!r} has {count} rows, the times {len(times)}"
        )
    return rows, column.read(values)


def _kept(
    table: RecordedTable, members: Mapping[str, _Rows], times: np.ndarray, clock: MapColumn | None
) -> tuple[Columns, np.ndarray, list[str]]:
    """Columns of readings in the same rows, with their times `t`; the numbers (M,) of these rows;
    and a note on rows that are left out.
    """
    rows = next((rows for rows, _ in members.values()), np.arange(len(times)))
    where = f"{table.path}: column {clock.theirs if clock else 't'!r}"
    values, numbers = [x for _, x in members.values()], rows + table.first
    kept, said = kept_rows(times[rows], values, where, table.row, numbers)
    columns = {"t": times[rows][kept]} | {n: x[kept] for n, (_, x) in members.items()}
    return columns, numbers[kept], [said] if said else []


def _check_attitude(table: RecordedTable, columns: Mapping[str, MapColumn], topic: str) -> None:
    """Raise SurefootError where an attitude would be interpolated to the rows of another topic."""
    for name, column in columns.items():
        if name.startswith("ref_q_") and table.topic(column.theirs) != topic:
            raise SurefootError(
                f"{table.path}: {name} is of another topic than t: give a [reference]"
            )


def _blank_lines(path: Path, blank: Mapping[str, SurefootError], found: Iterable[str]) -> list[str]:
    """A note on columns without a reading; raises the error of one that a log cannot lack."""
    there = {column_kind(name) for name in found}
    for name, error in blank.items():
        if column_kind(name) not in _MAY_LACK or column_kind(name) in there:
            raise error
    return [f"{path}: left out, NaN or empty throughout: {', '.join(blank)}"] if blank else []


def _times(table: RecordedTable, clock: MapColumn | None, source: Source) -> np.ndarray:
    if clock is None:
        rows = max(map(len, table.cells.values()), default=0)
        return np.arange(rows) / (source.rate or 1.0)
    return clock.read(column_readings(table, clock.theirs, Source(names=source.names))[1])


def _reference(path: Path, rules: ImportMap, shared: bool) -> tuple[Poses, list[str]]:
    """Poses in the reference's own rows, and notes on those left out.

    shared: whether it is in the main file.
    """
    columns, source = rules.reference_columns, rules.sections.reference
    assert source is not None
    if shared:
        keys = ("separator", "header", "skip", "comment", "decimal", "sparse")
        unsaid = [key for key in keys if getattr(source, key) == getattr(Source(), key)]
        source = replace(source, **{key: getattr(rules.sections.source, key) for key in unsaid})
    read = read_file(path, source, {column.theirs for column in columns.values()})
    if len(topics := {read.topic(column.theirs) for column in columns.values()}) > 1:
        raise SurefootError(
            f"{path}: [reference.columns] are of {' and '.join(sorted(topics))};"
            " t, ref_p and ref_q are of one topic"
        )
    clock = columns.get("t")
    times = _times(read, clock, source)
    members = {n: _rows(read, c, source, times, True) for n, c in columns.items() if n != "t"}
    if len(lengths := {len(rows) for rows, _ in members.values()}) > 1:
        raise SurefootError(f"{path}: [reference.columns] have {sorted(lengths)} rows")
    table, numbers, said = _kept(read, members, times, clock)
    poses, lost = poses_of(table, path, read.row, numbers)
    return poses, said + lost
