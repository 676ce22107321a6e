"""A file as a table of raw cells, and the conversion of its columns to numbers."""

import math
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import takewhile
from pathlib import Path

import numpy as np
import pandas as pd

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.importing.sections import Source


class NoReadings(SurefootError):
    """A column without a single reading."""


_DATE = re.compile(r"(\d{4}-\d\d-\d\d[T ])?\d\d:\d\d:\d\d(\.\d+)?(Z|[+-]\d\d:?\d\d)?")
_NANOSECONDS = re.compile(r"(.*?)(nsecs?|nanosecs?)")
_PLACE = re.compile(r"(.+)\[([^\[\]]+)\]$")
_SHOWN = 12
_MOST_PLACES = 1024
"""Largest list in a row whose elements may be columns; longer ones are images or scans."""


@dataclass(frozen=True)
class RecordedTable:
    """Columns of a file, each (N,) of numbers or objects, or (N, K) or (N, K, L) of numbers.

    Attributes:
        path: of the file.
        cells: by name.
        row: name of a row in messages.
        first: number of the first row.
        skipped: what else the file contains, and why it is no column.
        stamps: of the messages of each topic of a bag, (N,) [s]; empty for any other file.
    """

    path: Path
    cells: Mapping[str, np.ndarray]
    row: str = "row"
    first: int = 1
    skipped: Mapping[str, str] = field(default_factory=dict)
    stamps: Mapping[str, np.ndarray] = field(default_factory=dict)

    def topic(self, column: str) -> str:
        """The topic of a bag's column; "" in any other file."""
        return topic_of(column) if self.stamps else ""


def topic_of(column: str) -> str:
    """The topic in `topic:path`. Raises SurefootError where the column is not of that form."""
    topic, _, path = column.partition(":")
    if not topic or not path:
        raise SurefootError(f"column {column!r}: a bag's columns are written topic:field.path")
    return topic


def with_stamps(table: RecordedTable) -> RecordedTable:
    """The table with dates and times of day in seconds, and with a stamp that is split, such as
    `stamp.sec` and `stamp.nanosec`, as one column `stamp` [s].
    """
    cells = dict(table.cells)
    for name, one in table.cells.items():
        date = _DATE.fullmatch(one[0].strip()) if len(one) and isinstance(one[0], str) else None
        if date:
            texts = pd.Series(one) if date[1] else "1970-01-01 " + pd.Series(one)
            stamps = pd.to_datetime(texts, errors="coerce", format="ISO8601", utc=True)
            cells[name] = (stamps - pd.Timestamp(0, tz="UTC")).dt.total_seconds().to_numpy()
        elif split := _NANOSECONDS.fullmatch(name):
            whole = next((n for n in (f"{split[1]}sec", f"{split[1]}secs") if n in cells), None)
            if whole and one.dtype.kind in "fiu" and cells[whole].dtype.kind in "fiu":
                stem = split[1].rstrip("._/") or "stamp"
                cells[stem] = cells.pop(whole) + 1e-9 * cells.pop(name)
    return replace(table, cells=cells)


def column_readings(table: RecordedTable, column: str, source: Source, word: str | None = None):
    """Rows (M,) with a reading of a column, and its values (M,) in their unit, float64.

    Raises SurefootError naming file, column and row; NoReadings where all are NaN or empty.

    Args:
        table: of the file.
        column: its name; "name[3]" is an element of a list or a column of an array, "name[3][0]"
            one of a list in it; in a long table, the quantity of its rows.
        source: layout of the file.
        word: text that means 1; any other is 0.
    """
    if source.long is None:
        cells = _cells(table, column, source)
        rows = np.arange(len(cells))
    else:
        what = _cells(table, source.long.name, source)
        rows = np.flatnonzero([str(one) == column for one in what])
        if not len(rows):
            there = ", ".join(sorted({str(one) for one in what})[:_SHOWN])
            raise SurefootError(f"{table.path}: no readings of {column!r} (there are {there})")
        cells = _cells(table, source.long.value, source)[rows]
    if source.sparse or _empty(cells[:1]).any():
        kept = ~_empty(cells)
        if not kept.any():
            raise NoReadings(f"{table.path}: column {column!r} is NaN or empty throughout")
        if source.sparse:
            rows, cells = rows[kept], cells[kept]
    return rows, _numbers(table, column, cells, rows, word)


def columns_of(table: RecordedTable) -> dict[str, np.ndarray]:
    """All columns of numbers (N,) by their names in a map, of lists each element; NaN in empty
    cells.
    """
    found: dict[str, np.ndarray] = {}
    for name, cells in table.cells.items():
        filled = cells if cells.ndim > 1 else cells[~_empty(cells)]
        for place in _places(filled[0] if len(filled) else None):
            with suppress(SurefootError):
                rows, values = column_readings(table, f"{name}{place}", Source(sparse=True))
                found[f"{name}{place}"] = np.full(len(cells), np.nan)
                found[f"{name}{place}"][rows] = values
    return found


def _places(cell: object, deeper: int = 2) -> list[str]:
    """Places of the elements of a cell: "[0][1]" in a list of lists, "" of what is no list; none
    where there are too many.
    """
    inner = _list(cell)
    if inner is None:
        return [""]
    if deeper == 0 or len(inner) > _MOST_PLACES:
        return []
    found = [f"[{k}]{rest}" for k, one in enumerate(inner) for rest in _places(one, deeper - 1)]
    return found if len(found) <= _MOST_PLACES else []


def _cells(table: RecordedTable, column: str, source: Source) -> np.ndarray:
    """Cells (N,) of a column. Raises SurefootError where there are none of that name."""
    where, name, indices = f"{table.path}: column {column!r}", column, []
    while (cells := table.cells.get(name)) is None and (place := _PLACE.match(name)):
        name, indices = place[1], [place[2], *indices]
    if name in table.skipped:
        raise SurefootError(f"{where}: {table.skipped[name]}")
    if cells is None:
        there = [" ".join(name.split()) for name in table.cells]
        shown = ", ".join(there[:_SHOWN]) + ", ..." * (len(there) > _SHOWN)
        header = " from the header" * (table.row == "line")
        raise SurefootError(f"{where} is missing{header} (there are {shown})")
    for index in indices:
        if not index.isdigit() and index not in source.names:
            raise SurefootError(f"{where}: no {index!r} among the names of the source")
        place = int(index) if index.isdigit() else source.names.index(index)
        cells = _at(table, where, cells, place)
    if cells.ndim > 1 and cells[0].size != 1:
        raise SurefootError(
            f"{where} has {cells.shape[1]} places: write {column}[0], {column}[1], ..."
        )
    return cells.reshape(len(cells)) if cells.ndim > 1 else cells


def _at(table: RecordedTable, where: str, cells: np.ndarray, place: int) -> np.ndarray:
    """The elements of the cells' lists at a place; `where` they are, for messages."""
    if place == 0 and cells.ndim == 1 and cells.dtype.kind in "fiub":
        return cells
    if cells.ndim > 1:
        if place >= cells.shape[1]:
            raise SurefootError(f"{where}: there are {cells.shape[1]} places, from 0")
        return cells[:, place]
    found = np.empty(len(cells), dtype=object)
    for row in np.flatnonzero(~_empty(cells)):
        values = _list(cells[row])
        if values is None or place >= len(values):
            raise SurefootError(
                f"{where}, {table.row} {row + table.first}: {str(cells[row])[:40]!r} has no place"
                f" {place}"
            )
        found[row] = values[place]
    return found


def _list(cell: object) -> Sequence | np.ndarray | None:
    """The list in a cell, or in its text such as "[0.1, 2]" or "(0.1 2)"; None in any other."""
    if isinstance(cell, str) and cell[:1] in ("[", "(") and cell[-1:] in ("]", ")"):
        return cell[1:-1].replace(",", " ").split()
    return cell if isinstance(cell, list | tuple | np.ndarray) else None


def _empty(cells: np.ndarray) -> np.ndarray:
    """Mask (N,) of the cells without a reading."""
    if cells.dtype.kind in "fiub":
        return np.isnan(cells)
    blank = [isinstance(one, str) and not one.strip() for one in cells]
    return pd.isna(cells) | np.array(blank, dtype=bool)


def _numbers(
    table: RecordedTable, column: str, cells: np.ndarray, rows: np.ndarray, word: str | None
) -> np.ndarray:
    """Values (M,) of cells; raises SurefootError at the first that is no finite number.

    Args:
        table: of the file, for the message.
        column: its name, for the message.
        cells: (M,) of objects.
        rows: (M,) their rows.
        word: text that means 1; any other is 0.
    """
    if word is not None:
        return np.array([str(cell).strip() == word for cell in cells], dtype=float)
    if cells.dtype.kind == "c":
        raise SurefootError(f"{table.path}: column {column!r} has complex numbers, not real ones")
    if cells.dtype.kind in "fiub":
        values = cells.astype(float)
    else:
        values = np.fromiter(takewhile(math.isfinite, map(_number, cells)), float)
    k = int(np.append(np.flatnonzero(~np.isfinite(values)), len(values))[0])
    if k == len(cells):
        return values
    empty = "NaN or empty (in an import, sparse = true in the map leaves such cells out)"
    other = empty if _empty(cells[[k]])[0] else f"{str(cells[k])[:40]!r} is not a number"
    what = "infinite" if math.isinf(_number(cells[k])) else other
    row = table.first + int(rows[k])
    raise SurefootError(f"{table.path}: column {column!r}, {table.row} {row}: {what}")


def _number(cell: object) -> float:
    if isinstance(cell, str) and "_" in cell:
        return np.nan  # Python would read 9_8 as 98
    try:
        return float(cell)  # pyright: ignore[reportArgumentType]
    except (TypeError, ValueError, OverflowError):
        return np.nan
