"""Tables as text, CSV and similar formats: their layout (encoding, lines before the table, header,
separator, decimal commas) and their cells.
"""

import codecs
import csv
import re
import warnings
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.limits import check_limit, check_unpacked
from surefoot.sim.importing.readers.table import RecordedTable
from surefoot.sim.importing.sections import Source

_LOOKED_AT = 65536
"""Number of characters at the beginning of a text that are examined."""
_NO_TEXT = {
    "compressed: unpack it first": (b"\x1f\x8b", b"\xfd7zXZ", b"BZh9", b"\x28\xb5\x2f\xfd"),
    "a spreadsheet or archive: save a sheet as CSV, or unpack it": (b"PK\3\4", b"\xd0\xcf\x11\xe0"),
    "a pickle: save its arrays by np.savez": (b"\x80\2", b"\x80\3", b"\x80\4", b"\x80\5"),
    "a bag; if its recorder was killed, try rosbag reindex, and name it .bag": b"#ROSBAG",
    "binary: name it .mcap, .h5, .db3, .parquet": (b"\x89MCAP", b"\x89HDF", b"SQLite", b"PAR1\x15"),
}
"""What a file that is no text is, with what to do -> how it begins."""
SPACES = r"\s+"
COMMENTS = ("#", "%", "//")
"""Prefixes of a line that is a comment, or contains the column names."""
_MOST_OTHER = 10
"""Rows of another length with which a text is no single table; fewer above it are parameters."""
_COMMA = re.compile(r"\s*-?\d+,\d+([eE][-+]?\d+)?\s*")


def read_text(path: Path, source: Source) -> RecordedTable:
    """Read the table of a text file. Raises SurefootError in one line with file and line."""
    encoding = encoding_of(path)
    header, separator, units = _first_lines(path, source, encoding)
    with path.open("rb") as stream:
        pieces = iter(lambda: stream.read(1 << 20), b"")
        lines = sum(max(one.count(b"\n"), one.count(b"\r")) for one in pieces)
    # A cell, empty where a line is short, takes as long as 80 bytes that are unpacked.
    cost = 80.0 * lines * len(header)
    check_unpacked(path.stat().st_size, cost, f"{path}: cells of its lines", at_once=False)
    frame = pd.DataFrame()
    with warnings.catch_warnings(), suppress(pd.errors.EmptyDataError):
        # pandas only warns of a first line that is too long, and shifts the columns.
        warnings.simplefilter("error", pd.errors.ParserWarning)
        frame = pd.read_csv(
            path,
            sep=separator,
            header=None,
            skiprows=source.skip + source.header + units,
            comment=source.comment,
            na_values=["-", "--"],
            decimal=source.decimal,
            index_col=False,
            encoding=encoding,
            skipinitialspace=True,
            skip_blank_lines=False,
            low_memory=False,
        )
    filled = np.flatnonzero(frame.notna().any(axis=1))
    if not len(filled):
        raise SurefootError(f"{path}: no rows under the header")
    if len(frame.columns) != len(header):
        # Quotation marks keep spaces together in one of the two readings, but not in the other.
        raise SurefootError(
            f"{path}: line {source.skip + 1}: {len(header)} names, {len(frame.columns)} cells: "
            "rows of another length, or quotation marks in the header"
        )
    frame.columns = header
    twice = dict.fromkeys(frame.columns[frame.columns.duplicated()], "is there more than once")
    cells = {name: frame[name].to_numpy()[: filled[-1] + 1] for name in header if name not in twice}
    return RecordedTable(path, cells, "line", source.skip + 1 + source.header + units, twice)


def encoding_of(path: Path) -> str:
    """Encoding of a text: UTF-8, UTF-16 or, without zero bytes and not valid UTF-8, Windows-1252
    (the latter two are written by spreadsheets).

    Raises SurefootError, with the next step, for a file of another kind that begins as such.
    """
    with path.open("rb") as stream:
        begin = stream.read(_LOOKED_AT)
    for what, start in _NO_TEXT.items():
        if begin.startswith(start):
            raise SurefootError(f"{path}: is {what}")
    if begin.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    # Without a byte order mark, by the zero half of its first eight letters.
    for half, encoding in enumerate(("utf-16-be", "utf-16-le")):
        if begin[1:] and not any(begin[half:16:2]):
            return encoding
    try:
        with path.open(encoding="utf-8") as stream:
            while stream.read(_LOOKED_AT):
                pass
    except UnicodeDecodeError:
        return "utf-8-sig" if b"\0" in begin else "cp1252"
    return "utf-8-sig"


def _beginning(path: Path) -> list[str]:
    """Whole lines at the beginning of a text."""
    with path.open(encoding=encoding_of(path), errors="replace", newline="") as stream:
        return stream.read(_LOOKED_AT).splitlines()[:-1]


def layout_of(path: Path) -> dict[str, Any]:
    """Keys of a map's [source] for this text where the defaults do not fit.

    Raises SurefootError, with the line, for rows of several lengths, as of two tables.
    """
    lines = _beginning(path)
    if len(lines) < 2:
        return {}
    separator = _separator(lines[-1])
    rows = [text_cells(line, separator) for line in lines]
    width = len(rows[-1])
    first = next(k for k, row in enumerate(rows) if len(row) == width)
    # A comment as wide as the table contains its column names.
    plain = (k for k in range(first, len(rows)) if not lines[k].lstrip().startswith(COMMENTS))
    after = next(plain, None)
    if after is None:
        return {}
    named = [k for k in range(after) if len(rows[k]) == width and width > 1]
    found: dict[str, Any] = {}
    begin = named[-1] if named else max(after, first)
    rows_above = (k for k in range(begin) if rows[k] and are_numbers(rows[k][:1]))
    other = [k for k in (*rows_above, *range(begin, len(rows))) if len(rows[k]) not in (0, width)]
    if len(other) >= _MOST_OTHER:
        raise SurefootError(
            f"{path}: line {other[0] + 1}: {len(rows[other[0]])} cells, {width} in other rows; "
            "make a file of each table"
        )
    if begin:
        found["skip"] = begin
    numbers = [k for k, cell in enumerate(rows[-1]) if are_numbers([cell])]
    if numbers and all(are_numbers([rows[begin][k].strip() or "0"]) for k in numbers):
        found["header"] = False
    if separator != "," and any(_COMMA.fullmatch(cell) for cell in rows[-1]):
        found |= {"separator": separator, "decimal": ","}
    return found


def _first_lines(path: Path, source: Source, encoding: str) -> tuple[list[str], str, bool]:
    """Column names, separator, and whether the line after the names is words alone, such as units,
    and numbers follow.
    """
    with path.open(newline="", encoding=encoding) as stream:
        for _ in range(source.skip):
            stream.readline()
        line, *after = (stream.readline() for _ in range(3))
    separator = source.separator or _separator_of_header(line)
    names = [name.strip() for name in text_cells(line, separator)]
    if not any(names):
        raise SurefootError(f"{path}: line {source.skip + 1}: no header")
    check_limit("columns", len(names), f"{path}: cells of the header")
    header = names if source.header else [str(k) for k in range(len(names))]
    second, third = (text_cells(one, separator) for one in after)
    words = any(map(str.strip, second)) and not any(are_numbers([cell]) for cell in second)
    units = source.header and words and any(are_numbers([cell]) for cell in third)
    return header, separator, units


def _separator_of_header(line: str) -> str:
    """The most frequent separator; without any, spaces if there are some."""
    most = max(",;\t|", key=line.count)
    if line.count(most):
        return most
    return SPACES if " " in line.strip() else ","


def _separator(line: str) -> str:
    """Separator in a line of numbers; a comma next to another separator is a decimal comma."""
    for separator in (";", "\t", "|"):
        if separator in line:
            return separator
    decimal_commas = re.search(r"\S +\S", line) and are_numbers(line.split())
    return "," if "," in line and not decimal_commas else SPACES


def are_numbers(cells: list[str]) -> bool:
    """Whether every cell is a number, with a point or a comma."""
    return all(is_number(cell) or _COMMA.fullmatch(cell) for cell in cells)


def text_cells(line: str, separator: str) -> list[str]:
    """The cells of a line; between spaces, without the sign of a comment before them."""
    if separator == SPACES:
        words = line.split()
        return words[1:] if words[:1] and words[0] in COMMENTS else words
    return next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])


def is_number(text: str) -> bool:
    """Whether Python can parse a text as a number."""
    try:
        float(text)
    except ValueError:
        return False
    return True
