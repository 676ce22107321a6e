"""A file as a table of raw cells, and the conversion of its columns to numbers."""

import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.importing.sections import Source

_PLACE = re.compile(r"(.+)\[([^\[\]]+)\]$")
_SHOWN = 12


@dataclass(frozen=True)
class RecordedTable:
    """Columns of a file, each (N,) of numbers or objects, or (N, K) of numbers.

    Attributes:
        path: of the file.
        cells: by name.
        row: name of a row in messages.
        first: number of the first row.
    """

    path: object
    cells: Mapping[str, np.ndarray]
    row: str = "row"
    first: int = 1


def column_readings(table: RecordedTable, column: str, source: Source, word: str | None = None):
    """Rows (M,) with a reading of a column, and its values (M,) in their unit, float64.

    Raises SurefootError naming file, column and row.

    Args:
        table: of the file.
        column: its name; "name[3]" is an element of a list or a column of an array; in a long
            table, the quantity of its rows.
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
    if source.sparse:
        kept = np.array([not _empty(one) for one in cells], dtype=bool)
        if not kept.any():
            raise SurefootError(f"{table.path}: column {column!r} has no readings")
        rows, cells = rows[kept], cells[kept]
    return rows, _numbers(table, column, cells, rows, word)


def columns_of(table: RecordedTable) -> dict[str, np.ndarray]:
    """All numeric columns by their names in a map, with elements of lists as separate columns."""
    found: dict[str, np.ndarray] = {}
    for name, cells in table.cells.items():
        first = _list(cells[0]) if cells.ndim == 1 and len(cells) else None
        if isinstance(first, list | tuple | np.ndarray):
            each = [f"{name}[{k}]" for k in range(len(first))]
        elif cells.ndim == 2:
            each = [f"{name}[{k}]" for k in range(_oriented(table, cells).shape[1])]
        else:
            each = [name]
        for column in each:
            with suppress(SurefootError):
                found[column] = column_readings(table, column, Source())[1]
    return found


def _cells(table: RecordedTable, column: str, source: Source) -> np.ndarray:
    cells = table.cells.get(column)
    if cells is None and (place := _PLACE.match(column)) and place[1] in table.cells:
        index = place[2]
        if not index.isdigit():
            if index not in source.names:
                raise SurefootError(
                    f"{table.path}: column {column!r}: no {index!r} among the names of the source"
                )
            index = source.names.index(index)
        return _at(table, column, table.cells[place[1]], int(index))
    if cells is None:
        where = " from the header" * (table.row == "line")
        there = ", ".join(" ".join(name.split()) for name in list(table.cells)[:_SHOWN]) + (
            ", ..." * (len(table.cells) > _SHOWN)
        )
        raise SurefootError(
            f"{table.path}: column {column!r} is missing{where} (there are {there})"
        )
    if cells.ndim == 2:
        cells = _oriented(table, cells)
        if cells.shape[1] != 1:
            raise SurefootError(
                f"{table.path}: column {column!r} has {cells.shape[1]} places: write"
                f" {column}[0], {column}[1], ..."
            )
        return cells[:, 0]
    return cells


def _at(table: RecordedTable, column: str, cells: np.ndarray, place: int) -> np.ndarray:
    if place == 0 and cells.ndim == 1 and cells.dtype.kind in "fiub":
        return cells
    if cells.ndim == 2:
        cells = _oriented(table, cells)
        if place >= cells.shape[1]:
            raise SurefootError(
                f"{table.path}: column {column!r}: there are {cells.shape[1]} places, from 0"
            )
        return cells[:, place]
    found = np.empty(len(cells), dtype=object)
    for row, cell in enumerate(cells):
        values = _list(cell)
        if not isinstance(values, list | tuple | np.ndarray) or place >= len(values):
            if _empty(cell):
                found[row] = None
                continue
            raise SurefootError(
                f"{table.path}: column {column!r}, {table.row} {row + table.first}:"
                f" {str(cell)[:40]!r} has no place {place}"
            )
        found[row] = values[place]
    return found


def _list(cell: object) -> object:
    """The value of a cell; a text such as "[0.1, 2]" or "(0.1 2)" is a list."""
    if isinstance(cell, str) and cell[:1] in ("[", "(") and cell[-1:] in ("]", ")"):
        return cell[1:-1].replace(",", " ").split()
    return cell


def _oriented(table: RecordedTable, cells: np.ndarray) -> np.ndarray:
    """Transpose an array to have rows first, by the length of the file's longest column."""
    rows = {max(one.shape) for one in table.cells.values() if 1 in one.shape or one.ndim == 1}
    a, b = cells.shape
    return cells.T if (a not in rows and b in rows) or (not rows and b > a) else cells


def _empty(cell: object) -> bool:
    if cell is None or (isinstance(cell, str) and not cell.strip()):
        return True
    return isinstance(cell, float | np.floating) and bool(np.isnan(cell))


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
    if cells.dtype.kind == "c" or any(isinstance(one, complex) for one in cells[:1]):
        raise SurefootError(f"{table.path}: column {column!r} has complex numbers, not real ones")
    plain = cells.dtype.kind in "fiub"
    values = cells.astype(float) if plain else np.array([_number(one) for one in cells], float)
    bad = np.flatnonzero(~np.isfinite(values))
    if bad.size:
        cell = cells[bad[0]]
        other = "NaN or empty" if _empty(cell) else f"{str(cell)[:40]!r} is not a number"
        what = "infinite" if np.isinf(values[bad[0]]) else other
        row = table.first + int(rows[bad[0]])
        raise SurefootError(f"{table.path}: column {column!r}, {table.row} {row}: {what}")
    return values


def _number(cell: object) -> float:
    if isinstance(cell, str) and "_" in cell:
        return np.nan  # Python would read 9_8 as 98
    try:
        return float(cell)  # pyright: ignore[reportArgumentType]
    except (TypeError, ValueError, OverflowError):
        return np.nan
