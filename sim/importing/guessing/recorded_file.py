"""A file of a recording as read, before a map assigns its columns."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.importing.clock import Columns, kept_rows, mostly_rises, rises
from surefoot.sim.importing.columns import UNITS
from surefoot.sim.importing.guessing.draft import Entry
from surefoot.sim.importing.guessing.names import (
    Named,
    by_their_legs,
    by_their_lists,
    name_in_file,
    read_name,
    words_of,
)
from surefoot.sim.importing.readers.array_file import MOST_NAMES, PARAMETERS
from surefoot.sim.importing.readers.bag import RECEIVED, UNREADABLE
from surefoot.sim.importing.readers.file import detected_layout, read_file
from surefoot.sim.importing.readers.table import RecordedTable, column_readings, columns_of
from surefoot.sim.importing.readers.text import is_number
from surefoot.sim.importing.sections import Source
from surefoot.sim.robot.limbs import Limbs
from surefoot.sim.robot.machine import Machine

_RATES = (4.0, 4000.0)
"""Range of plausible rates of a log [Hz], in which those by one unit of its times are."""
_LARGEST_COUNT = 1e9
"""First count of a row below which it is no time since an epoch [ms]."""
_STEPS = ("dt", "ts", "step", "timestep", "period")
_RATE_WORDS = ("rate", "fs", "hz", "freq", "frequency", "fps")
"""Last words of names of a step of time [s], and of a rate [Hz]."""
_SMALL = 4096
"""Size [bytes] below which a text may be a list of joints."""
_FEW = 10
"""Readings up to which a mostly empty column is ignored."""


@dataclass(frozen=True)
class RecordedFile:
    """A file of a recording, or the part of one with its own clock, before a map.

    Attributes:
        path: of the file.
        label: a name for it.
        columns: by name, each (N,) on one clock, those of a bag interpolated to it.
        names: interpretation of each column's name.
        t: the column of times, or None.
        seconds: its times (N,) [s].
        lists: words in order, as of its joints, of each list in the file or text beside it.
        layout: keys of [source] for a text.
        machine: robot for which a map is drafted, or None.
        stated: rate of the rows [Hz] that the file states, and its name there, or None.
        skipped: what else the file contains, and why it is no column.
        yaw: yaw rate (N,) [rad/s] by its gyro, once that is known; or None.
    """

    path: Path
    label: str
    columns: dict[str, np.ndarray]
    names: dict[str, Named]
    t: Entry | None
    seconds: np.ndarray | None
    lists: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    layout: Mapping[str, Any] = field(default_factory=dict)
    machine: Machine | None = None
    stated: tuple[float, str] | None = None
    skipped: Mapping[str, str] = field(default_factory=dict)
    yaw: np.ndarray | None = None

    @property
    def limbs(self) -> Limbs:
        """Names of the robot's legs and joints; none without a robot."""
        return Limbs((), (), ()) if self.machine is None else self.machine.limbs

    @property
    def counter(self) -> Entry | None:
        """A column that counts its rows, as its times; None without."""
        counts = (name for name, values in self.columns.items() if name and counts_rows(values))
        doubt = "counts rows: gain = 1 / rate [Hz]?"
        return next((Entry("t", name, gain=0.01, doubt=doubt) for name in counts), None)


def refuse_texts(path: Path) -> NoReturn:
    """Raise SurefootError for a file without columns of numbers, with the first text in it."""
    table = read_file(path, Source(**detected_layout(path)))
    for name in table.cells:
        column_readings(table, name, Source(sparse=True))
    raise SurefootError(f"{path}: no columns of numbers in it")


def recorded_files(path: Path, machine: Machine | None) -> list[RecordedFile]:
    """Read the numeric columns of a file: for a bag on one clock, else separately for each clock.

    Empty where it has none. machine: its joint names are recognised in those of columns; or None.
    """
    layout = detected_layout(path)
    table = read_file(path, Source(**layout))
    every = columns_of(table)
    columns = every if table.stamps else _between_readings(every, machine)
    if any(np.isnan(every[name]).any() for name in columns):
        layout["sparse"] = True
    lists, stated = _lists(path, table.cells), _stated_rate(columns)
    found = _of_bag(table, every, machine) if table.stamps else _by_clock(path, columns, machine)
    there = {re.sub(r"(\[[0-9]+\])*$", "", name) for name in columns} | {*columns, *lists}
    skipped = {name: UNREADABLE for name in table.cells if name not in there}
    skipped |= {name: PARAMETERS for name, cells in table.cells.items() if len(cells) == 1}
    skipped |= table.skipped
    found = [replace(x, lists=lists, layout=layout, machine=machine, stated=stated) for x in found]
    return [replace(x, skipped=skipped) for x in found[:1]] + found[1:]


def _stated_rate(columns: Columns) -> tuple[float, str] | None:
    """The rate of the rows by a constant that is named as one, or as a step of time, and its name;
    of several the slowest, as of a simulation whose steps are not all recorded.
    """
    found = []
    for name, values in columns.items():
        last, value = (words_of(name) or [""])[-1], float(values[0])
        if np.ptp(values) == 0.0 and value > 0.0 and last in (*_STEPS, *_RATE_WORDS):
            found.append((value if last in _RATE_WORDS else 1.0 / value, name))
    return min((one for one in found if _RATES[0] < one[0] < _RATES[1]), default=None)


def _between_readings(every: Columns, machine: Machine | None) -> Columns:
    """The columns without an empty cell. If others have empty cells between readings, also these,
    and all are at the readings of the gyro, or else of the most frequent of them.

    Args:
        every: columns of a file, NaN in empty cells.
        machine: whose joint names columns may use, or None.
    """
    readings = {name: np.isfinite(x) for name, x in every.items()}
    full = {name: every[name] for name, filled in readings.items() if filled.all()}
    sparse = {n: k for n, k in readings.items() if n not in full and np.count_nonzero(k) > _FEW}
    if not sparse or len({*map(len, every.values())}) > 1:
        return full
    names = _names([*sparse, *full], machine)
    at = sparse[_leading(sparse, names)]
    t = column_of_times({name: values[at] for name, values in full.items()}, names)
    if t is None:
        return full
    stamps = full[t.theirs]
    between = {n: np.interp(stamps[at], stamps[k], every[n][k]) for n, k in sparse.items()}
    between |= {name: values[at] for name, values in full.items()}
    return {name: between[name] for name in every if name in between}


def _leading(readings: Mapping[str, np.ndarray], names: Mapping[str, Named]) -> str:
    """The column whose readings, of masks (N,), are the rows: one of the IMU, or else the most
    frequent.
    """
    gyro = (n for n in readings if names[n].kind == "gyro" and not names[n].source)
    return next(gyro, None) or max(readings, key=lambda name: np.count_nonzero(readings[name]))


def _of_bag(table: RecordedTable, every: Columns, machine: Machine | None) -> list[RecordedFile]:
    """The columns of a bag, at the readings of the leading one; none if there are none."""
    if not every:
        return []
    readings = {name: np.isfinite(x) for name, x in every.items()}
    stamps = {name: table.stamps[table.topic(name)][k] for name, k in readings.items()}
    names = _names(every, machine)
    first = _leading(readings, names)
    at = stamps[first]
    columns = {name: np.interp(at, stamps[name], every[name][k]) for name, k in readings.items()}
    t = times_of_topic(table.topic(first), columns, names)
    return [RecordedFile(table.path, _plain(table.path.stem), columns, names, t, at)]


def _by_clock(path: Path, columns: Columns, machine: Machine | None) -> list[RecordedFile]:
    """The columns of a file, those of each clock by themselves."""
    found, long = [], {n: v for n, v in columns.items() if len(v) > 1}
    for part in _with_equal_times(long):
        names = _names(part, machine)
        part, t = _at_rising_times(part, column_of_times(part, names))
        seconds = t.scale * part[t.theirs] if t else None
        found.append(RecordedFile(path, _label(path, part, long), part, names, t, seconds))
    return found


def _lists(path: Path, cells: Mapping[str, np.ndarray]) -> dict[str, tuple[str, ...]]:
    """Texts in a file's cells, and words of small text files in its folder, which may list its
    joints in order.
    """
    found = {
        name: tuple(map(str, texts))
        for name, texts in cells.items()
        if len(texts) <= MOST_NAMES and all(isinstance(one, str) for one in texts)
    }
    for one in sorted(path.parent.glob("*.txt")):
        if one != path and one.stat().st_size < _SMALL:
            words = one.read_text(encoding="utf-8", errors="replace").split()
            if not any(map(is_number, words)):
                found[one.name] = tuple(words)
    return found


def times_of_topic(topic: str, columns: Columns, names: Mapping[str, Named]) -> Entry:
    """The stamps in a topic's messages or, without these, the times of reception."""
    of_topic = (n for n in columns if n.startswith(f"{topic}:"))
    stamps = {n: columns[n] for n in of_topic if names[n].kind == "t"}
    return column_of_times(stamps, names) or Entry("t", f"{topic}:{RECEIVED}", "s")


def column_of_times(columns: Columns, names: Mapping[str, Named]) -> Entry | None:
    """The column of times: one with such a name, or else one that increases in even steps."""
    long = {n: v for n, v in columns.items() if len(v) > 2}
    named = [n for n, v in long.items() if names[n].kind == "t" and mostly_rises(v)]
    rising = {n: np.diff(v) for n, v in long.items() if not names[n].kind and rises(v)}
    even = [n for n, steps in rising.items() if np.std(steps) < 0.5 * np.mean(steps)]
    for name in (*named, *even):
        if (unit := names[name].unit) in UNITS["t"]:
            return Entry("t", name, unit)
        if counts_rows(columns[name]):
            continue
        steps = np.diff(columns[name])
        step = float(np.median(steps[steps > 0.0]))
        for unit, size in UNITS["t"].items():
            if _RATES[0] <= 1.0 / (step * size) < _RATES[1]:
                doubt = "" if name in named else f"is this the time, in {unit}?"
                return Entry("t", name, unit, doubt=doubt)
    return None


def counts_rows(values: np.ndarray) -> bool:
    """Whether values (N,) are numbers of rows, each 1 after the one before where none is lost."""
    steps = np.diff(values)
    whole = abs(values[0]) < _LARGEST_COUNT and not np.any(values % 1.0)
    return bool(whole and steps.min(initial=1.0) >= 1.0 and np.median(steps) == 1.0)


def _at_rising_times(part: Columns, t: Entry | None) -> tuple[Columns, Entry | None]:
    """The rows that an import keeps; all, and no times, where stamps contradict each other."""
    if t is None or rises(part[t.theirs]):
        return part, t
    every = np.arange(len(part[t.theirs]))
    try:
        kept, _ = kept_rows(part[t.theirs], [*part.values()], t.theirs, "row", every)
    except SurefootError:
        return part, None
    return {name: values[kept] for name, values in part.items()}, t


def _names(columns: Iterable[str], machine: Machine | None) -> dict[str, Named]:
    return by_their_lists(by_their_legs({name: name_in_file(name, machine) for name in columns}))


def _with_equal_times(columns: Columns) -> list[Columns]:
    """Group the columns by number of rows and, within these, by equal times."""
    parts: dict[tuple[int, str], dict[str, np.ndarray]] = {}
    for rows in dict.fromkeys(map(len, columns.values())):
        alike = {n: v for n, v in columns.items() if len(v) == rows}
        clocks = [n for n in alike if read_name(n).kind == "t" and mostly_rises(alike[n])]
        apart = any(not np.array_equal(alike[n], alike[clocks[0]]) for n in clocks)
        groups = {n.rpartition("/")[0] for n in clocks} if apart else set()
        for name, values in alike.items():
            group = name.rpartition("/")[0]
            parts.setdefault((rows, group if group in groups else ""), {})[name] = values
    return list(parts.values())


def _label(path: Path, part: Columns, whole: Columns) -> str:
    """Name for a part of a file: the file's, or that of the part's groups."""
    if len(part) == len(whole):
        return _plain(path.stem)
    groups = dict.fromkeys(name.rpartition("/")[0] or name.partition("[")[0] for name in part)
    return _plain("_".join(groups))


def _plain(text: str) -> str:
    return re.sub(r"[^A-Za-z0-9_-]+", "_", text)
