"""Tables as text: CSV and similar formats."""

import warnings
from contextlib import suppress
from pathlib import Path

import numpy as np
import pandas as pd

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.limits import check_unpacked
from surefoot.sim.importing.readers.layout import encoding_of, first_lines, no_table
from surefoot.sim.importing.readers.table import RecordedTable
from surefoot.sim.importing.sections import Source


def read_text(path: Path, source: Source) -> RecordedTable:
    """Read the table of a text file. Raises SurefootError in one line with file and line."""
    encoding = encoding_of(path)
    if source.long is None and (why := no_table(path, source.skip)):
        raise SurefootError(f"{path}: {why}")
    header, separator, units = first_lines(path, source, encoding)
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
