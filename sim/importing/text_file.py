"""Tables as text: CSV and similar formats."""

import warnings
from collections import Counter
from pathlib import Path

import numpy as np
import pandas as pd

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.importing.layout import encoding_of, first_lines, no_table
from surefoot.sim.importing.sections import Source
from surefoot.sim.importing.table import RecordedTable, parsed_as


def read_text(path: Path, source: Source) -> RecordedTable:
    """Read the table of a text file. Raises SurefootError in one line with file and line."""
    with parsed_as("a table of text", path):
        encoding = encoding_of(path)
        if source.long is None and (why := no_table(path, source.skip)):
            raise SurefootError(f"{path}: {why}")
        header, separator, units = first_lines(path, source, encoding)
        with warnings.catch_warnings():
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
    if len(frame.columns) != len(header):
        # Quotation marks keep spaces together in one of the two readings, but not in the other.
        raise SurefootError(f"{path}: line {source.skip + 1}: quotation marks in the header")
    frame.columns = header
    empty = frame.isna().all(axis=1).to_numpy()
    rows = len(empty) - int(np.argmin(empty[::-1])) if not empty.all() else 0
    if rows == 0:
        raise SurefootError(f"{path}: no rows under the header")
    twice = [name for name, count in Counter(header).items() if count > 1]
    cells = {name: frame[name].to_numpy()[:rows] for name in header if name not in twice}
    skipped = dict.fromkeys(twice, "is there more than once")
    return RecordedTable(path, cells, "line", source.skip + 1 + source.header + units, skipped)
