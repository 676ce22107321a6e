"""Import a recording of any files as a Log, by an import map (`sim.importing.map`)."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.files import is_file, is_there
from surefoot.sim.common.limits import admitted, check_unpacked
from surefoot.sim.importing.array_file import read_hdf5, read_mat, read_npz
from surefoot.sim.importing.assemble import RawRecording, unit_quaternions
from surefoot.sim.importing.bag import read_bag, topic_of
from surefoot.sim.importing.clock import Columns, Stamped, check_rising, gap_lines, on_clock
from surefoot.sim.importing.columns import EULER, MapColumn
from surefoot.sim.importing.json_file import read_json
from surefoot.sim.importing.map import ImportMap
from surefoot.sim.importing.reference import poses_of, quaternions_of
from surefoot.sim.importing.sections import Source
from surefoot.sim.importing.table import RecordedTable, column_readings
from surefoot.sim.importing.text_file import read_text
from surefoot.sim.log import Log

Files = str | Path | Sequence[str | Path]
STEM = "{name}"
"""Placeholder in the name of a further file for the main one's name, without its suffix."""
BAGS = (".bag", ".mcap", ".db3")


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
    first = given.get(rules.source.file or "", paths[0])
    main = _main_file(first, rules)
    sources = (*rules.sources.values(), rules.reference)
    named = {one.file.replace(STEM, main.stem) for one in sources if one and one.file}
    beside = {name: given.get(name, main.parent / name) for name in named}
    further = iter([path for path in paths if path is not first and path.name not in named])
    streams, clock, notes = _streams(main, rules.source, rules, None)
    for name, source in rules.sources.items():
        path = beside[source.file.replace(STEM, main.stem)] if source.file else next(further, None)
        if path is None:
            raise SurefootError(f"{rules.path}: [sources.{name}] has no file, and none is given")
        found, _, _ = _streams(path, source, rules, name)
        streams |= found
    poses = None
    if rules.reference is not None:
        own = rules.reference.file
        path = beside[own.replace(STEM, main.stem)] if own else next(further, main)
        poses = poses_of(_reference(path, rules, shared=path == main))
    if (extra := next(further, None)) is not None:
        raise SurefootError(f"{extra}: {rules.path} has no use for this file")
    shared = on_clock(clock, streams, str(main))
    rules = replace(rules, robot=_robot_file(rules, main))
    kept = {name: shared[name] for name in ("t", *rules.columns) if name in shared}
    return RawRecording(kept, poses, rules, main, (*notes, *gap_lines(clock, streams)))


def _robot_file(rules: ImportMap, main: Path) -> str | None:
    """The robot's name or, for a file beside the map or the recording, its full path."""
    for folder in (rules.path.parent, main.parent):
        if rules.robot and Path(rules.robot).suffix and is_file(folder / rules.robot):
            return str((folder / rules.robot).resolve())
    return rules.robot


def read_table(path: Path, source: Source) -> RecordedTable:
    """Read the table of a file of any kind except a bag. Raises SurefootError."""
    if is_there(path):
        admitted(path, "recording")
    reader = _READERS.get(path.suffix.lower())
    return reader(path) if reader else read_text(path, source)


def is_text(path: Path) -> bool:
    """Whether a file is read as text, by its name."""
    return not (is_bag(path) or path.suffix.lower() in _READERS)


def is_bag(path: Path) -> bool:
    """Whether a path is a ROS 1, ROS 2 or MCAP bag, by its name."""
    return path.suffix.lower() in BAGS or (path / "metadata.yaml").is_file()


def _main_file(path: Path, rules: ImportMap) -> Path:
    if is_bag(path) or not path.is_dir():
        return path
    if rules.source.file is None:
        raise SurefootError(f"{path}: is a folder, and {rules.path} has no [source] file")
    return path / rules.source.file


def _streams(
    path: Path, source: Source, rules: ImportMap, name: str | None
) -> tuple[dict[str, Stamped], np.ndarray, tuple[str, ...]]:
    """Columns of a file by the log's names, in SI; times of its rows; and notes."""
    columns = {n: c for n, c in rules.columns.items() if c.source == name and n != "t"}
    clock = rules.columns.get("t") if name is None else rules.clocks.get(name)
    if is_bag(path):
        return _of_bag(path, source, columns, clock if name is None else None, rules)
    table = read_table(path, source)
    if clock is None and source.rate is None:
        raise SurefootError(f"{rules.path}: [sources.{name}] t or rate is missing")
    found: dict[str, Stamped] = {}
    times = _times(table, clock, source)
    apart = source.sparse or source.long is not None
    if not apart and clock is not None:
        check_rising(times, path, clock.theirs, table.row, table.first + np.arange(len(times)))
    for log_name, column in columns.items():
        rows, values = column_readings(table, column.theirs, source, column.word)
        count = rows[-1] + 1 if len(rows) else 0
        if count > len(times) or (count < len(times) and not apart):
            raise SurefootError(
                f"{path}: column {column.theirs!r} has {count} rows, the times {len(times)}"
            )
        if apart:
            check_rising(times[rows], path, column.theirs, table.row, rows + table.first)
        found[log_name] = times[rows], column.read(values)
    if not apart or not found:
        return found, times, ()
    # If columns have different times, the rows are those of the most frequent one.
    first = max(found, key=lambda n: len(found[n][0]))
    return found, found[first][0], (f"rows: at the readings of {first}",)


def _times(table: RecordedTable, clock: MapColumn | None, source: Source) -> np.ndarray:
    if clock is None:
        rows = max(map(len, table.cells.values()))
        return np.arange(rows) / (source.rate or 1.0)
    return clock.read(column_readings(table, clock.theirs, Source(names=source.names))[1])


def _of_bag(
    path: Path,
    source: Source,
    columns: dict[str, MapColumn],
    clock: MapColumn | None,
    rules: ImportMap,
) -> tuple[dict[str, Stamped], np.ndarray, tuple[str, ...]]:
    """`_streams` for a bag.

    Args:
        path: of the bag.
        source: as described in the map.
        columns: to read from it.
        clock: its column of times, if its rows are the log's.
        rules: the map, for messages.
    """
    if source.rate is not None:
        raise SurefootError(f"{rules.path}: [source] rate does not go with a bag")
    wanted = {c.theirs for c in (*columns.values(), *([clock] if clock else []))}
    seen = read_bag(path, sorted(wanted))
    found: dict[str, Stamped] = {}
    t = clock.read(seen[clock.theirs][1]) if clock else np.zeros(0)
    if clock:
        check_rising(t, path, clock.theirs, "message", 1 + np.arange(len(t)))
    for name, column in columns.items():
        stamps, values = seen[column.theirs]
        if clock and topic_of(column.theirs) == topic_of(clock.theirs):
            stamps = t
        elif name.startswith("ref_q_"):
            raise SurefootError(f"{path}: {name} is of another topic than t: give a [reference]")
        else:
            check_rising(stamps, path, column.theirs, "message", 1 + np.arange(len(stamps)))
        found[name] = stamps, column.read(values)
    return found, t, ()


def _reference(path: Path, rules: ImportMap, shared: bool) -> Columns:
    """Columns t, ref_p and ref_q of the reference's own rows; shared: whether it is in the main
    file.
    """
    columns, source = rules.reference_columns, rules.reference
    assert source is not None
    if shared:
        plain = Source()
        laid_out = {
            key: getattr(rules.source, key)
            for key in ("separator", "header", "skip", "comment", "decimal", "sparse")
            if getattr(source, key) == getattr(plain, key)
        }
        source = replace(source, **laid_out)
    if is_bag(path):
        topics = {topic_of(column.theirs) for column in columns.values()}
        if len(topics) > 1:
            raise SurefootError(
                f"{path}: [reference.columns] are of {' and '.join(sorted(topics))};"
                " t, ref_p and ref_q are of one topic"
            )
        seen = read_bag(path, sorted({column.theirs for column in columns.values()}))
        read = RecordedTable(path, {name: values for name, (_, values) in seen.items()}, "message")
        source = Source(rate=source.rate)
    else:
        read = read_table(path, source)
    table, rows = {}, np.zeros(0, int)
    for name, column in columns.items():
        if name != "t":
            rows, values = column_readings(read, column.theirs, source, column.word)
            table[name] = column.read(values)
    times = _times(read, columns.get("t"), source)
    lengths = {len(values) for values in table.values()}
    if len(lengths) > 1:
        raise SurefootError(f"{path}: [reference.columns] have {sorted(lengths)} rows")
    if len(rows) and rows[-1] >= len(times):
        raise SurefootError(
            f"{path}: the reference has {rows[-1] + 1} rows, its times {len(times)}"
        )
    table["t"] = times[rows]
    if "t" in columns:
        check_rising(table["t"], path, columns["t"].theirs, read.row, read.first + rows)
    if EULER[0] in table:
        angles = np.column_stack([table.pop(name) for name in EULER])
        table |= quaternions_of(angles)
    else:
        unit_quaternions(path, table, read.row, read.first)
    return table


def _parquet(path: Path) -> RecordedTable:
    try:
        about = pq.read_metadata(path)
        size = 8.0 * about.num_rows * about.num_columns
        check_unpacked(path, size, f"{path}: bytes of columns")
        frame = pq.read_table(path).to_pandas(ignore_metadata=True)
    except SurefootError:
        raise
    except (OSError, ValueError) as error:
        raise SurefootError(
            f"{path}: not a Parquet file ({' '.join(str(error).split())[:80]})"
        ) from error
    return RecordedTable(path, {str(name): frame[name].to_numpy() for name in frame})


_READERS = {
    **dict.fromkeys((".json", ".jsonl", ".ndjson"), read_json),
    **dict.fromkeys((".npz", ".npy"), read_npz),
    **dict.fromkeys((".h5", ".hdf5"), read_hdf5),
    ".mat": read_mat,
    ".parquet": _parquet,
}
"""Reader by suffix; any other file is read as text."""
