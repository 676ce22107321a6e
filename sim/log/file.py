"""The file of a Log: Parquet with one float64 column for each name, and metadata as JSON.

A walk of any length is read and written in pieces, in the memory of one.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.limits import admitted, check_first_bytes, check_limit, check_unpacked
from surefoot.sim.log.schema import (
    DIGEST_KEY,
    KEY,
    Meta,
    check_frame,
    check_types,
    metadata_digest,
    read_metadata,
)

ROW_GROUP = 1 << 15
"""Rows in a row group of a file: a minute at 500 Hz."""
SHORT_GROUP = 1000
"""Rows in a row group whose columns take less time to unpack than to find [some 50 us each]."""
FEWEST_ROWS = 3
"""Least number of rows of a log, for a second derivative."""


class LogError(SurefootError):
    """A log that cannot be read, or that lacks requested data."""


class LogWriter:
    """Writes a log in pieces, using the memory of one; the file is the same as of a log written at
    once.
    """

    def __init__(self, path: Path, meta: Meta):
        """Raises LogError for invalid metadata. `whole_file` provides the path."""
        try:
            text = json.dumps(asdict(meta), default=_plain, allow_nan=False, sort_keys=True)
            read_metadata({KEY: text.encode()})
        except (SurefootError, TypeError, ValueError) as error:
            raise LogError(str(error)) from error
        self._path, self._rate = path, meta.rate
        self._about = {KEY: text.encode(), DIGEST_KEY: metadata_digest(text.encode())}
        self._file: pq.ParquetWriter | None = None
        self._held: pa.Table | None = None  # rows that do not fill a row group yet
        self.rows, self._last = 0, -np.inf

    def __enter__(self) -> LogWriter:
        return self

    def write(self, frame: pd.DataFrame) -> None:
        """Write the next rows. Raises LogError, with column and row, where they are not valid."""
        try:
            check_frame(frame, self._rate, self.rows, self._last)
        except (SurefootError, TypeError, ValueError) as error:
            raise LogError(str(error)) from error
        self.rows, self._last = self.rows + len(frame), float(frame["t"].iloc[-1])
        table = pa.table({str(name): pa.array(frame[name].to_numpy()) for name in frame})
        if self._held is not None:
            table = pa.concat_tables([self._held, table]).combine_chunks()
        full = len(table) // ROW_GROUP * ROW_GROUP
        self._write(table[:full])
        self._held = table[full:]

    def _write(self, table: pa.Table) -> None:
        if self._file is None:
            schema = table.schema.with_metadata(self._about)
            self._file = pq.ParquetWriter(
                self._path, schema, compression="zstd", write_page_checksum=True
            )
        if len(table):
            table = table.replace_schema_metadata(self._about)
            self._file.write_table(table, row_group_size=ROW_GROUP)

    def __exit__(self, kind: object, *_: object) -> None:
        if kind is None and self._held is not None:
            self._write(self._held)
        if self._file is not None:
            self._file.close()


class LogReader:
    """Reads a log in pieces: a walk of any length in the memory of one piece.

    `meta`, `columns` and the number of `rows` are available at once.
    """

    def __init__(self, path: str | Path):
        """Raises LogError, one line, where the file, its columns' types or its metadata are bad."""
        try:
            self.path = admitted(path, "recording")
            check_first_bytes(self.path)  # Arrow looks at the last four bytes alone
        except SurefootError as error:
            raise LogError(str(error)) from None
        with self._opened() as file:
            self.rows = file.metadata.num_rows
            self.columns: tuple[str, ...] = tuple(file.schema_arrow.names)
            check_limit("rows", self.rows, "rows")
            check_limit("columns", len(self.columns), "columns")
            size = 8.0 * self.rows * len(self.columns)
            check_unpacked(self.path.stat().st_size, size, "bytes of columns", at_once=False)
            check_types(zip(self.columns, file.schema_arrow.types, strict=True))
            self.meta = read_metadata(file.schema_arrow.metadata)
            if 0 < self.rows < FEWEST_ROWS:
                raise SurefootError(f"has {self.rows} rows, a log {FEWEST_ROWS} at least")
            sizes = [file.metadata.row_group(k).num_rows for k in range(file.num_row_groups)]
            pieces = len(self.columns) * sum(rows < SHORT_GROUP for rows in sizes)
            check_limit("items", pieces, f"columns of row groups with less than {SHORT_GROUP} rows")
            most = 8.0 * len(self.columns) * max(sizes, default=0)
            check_limit("piece", most, "bytes of a row group in memory")

    def frames(self, seconds: float = np.inf) -> Iterator[pd.DataFrame]:
        """The rows in pieces of about `seconds`, by default all in one; the last may be shorter.

        Raises LogError, one line with file, column and row, at the first fault.
        """
        size = max(1, round(min(seconds * self.meta.rate, self.rows)))
        row, before = 0, -np.inf
        with self._opened() as file:
            check_limit("memory", 8.0 * size * len(self.columns), "bytes in memory")
            for table in _tables(file, size):
                frame = pd.DataFrame({name: table[name].to_numpy() for name in self.columns})
                check_frame(frame, self.meta.rate, row, before)
                yield frame
                row, before = row + len(frame), frame["t"].iloc[-1]

    @contextmanager
    def _opened(self) -> Iterator[pq.ParquetFile]:
        try:
            with pq.ParquetFile(self.path, page_checksum_verification=True) as file:
                yield file
        except SurefootError as error:
            raise LogError(f"{self.path}: {error}") from error
        except (pa.ArrowException, OSError, ValueError, OverflowError, MemoryError) as error:
            reason = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise LogError(
                f"{self.path}: not a whole Parquet file, truncated? ({reason})"
            ) from error


def _tables(file: pq.ParquetFile, size: int) -> Iterator[pa.Table]:
    """All rows of a file in tables of `size`, except the last, which may be shorter or empty."""
    held, count = [pa.Table.from_batches([], file.schema_arrow)], 0
    # One row group at a time, since `iter_batches` keeps what it has read.
    for group in range(file.num_row_groups):
        held.append(file.read_row_group(group, use_threads=False))
        count += len(held[-1])
        if count < size:
            continue
        rows = pa.concat_tables(held)
        while len(rows) >= size:
            yield rows[:size]
            rows = rows[size:]
        held, count = [rows], len(rows)
    if count or not file.metadata.num_rows:
        yield pa.concat_tables(held)


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"metadata holds a {type(value).__name__}, which JSON does not")
