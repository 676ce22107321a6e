"""A CSV recording becomes a Log; any fault of its cells is one line with file, column and line."""

import csv
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.importing.assemble import RawRecording, check_rising, unit_quaternions
from surefoot.sim.importing.map import STEM, ImportMap, MapColumn
from surefoot.sim.importing.reference import Columns, poses_of
from surefoot.sim.log import Log


def import_csv(path: str | Path, map_path: str | Path) -> Log:
    """The log of a CSV recording: `path` is its main file, or the folder it lies in.

    `map_path` is a map's file or the name of a bundled map. Rows outside the reference are cut.
    Raises SurefootError (LogError) in one line with file, column and line.
    """
    return read_csv_recording(path, map_path).log()


def read_csv_recording(path: str | Path, map_path: str | Path) -> RawRecording:
    """What `import_csv` makes a log of, with all rows and poses. Raises as it does."""
    rules = ImportMap.read(map_path)
    path = Path(path)
    if path.is_dir():
        if rules.file is None:
            raise SurefootError(f"{path}: is a folder, and {rules.path} has no [source] file")
        path = path / rules.file
    main = _read_csv_table(path, rules.columns)
    reference = None
    if rules.reference is not None:
        if rules.reference.file is None:
            raise SurefootError(f"{rules.path}: [reference] file is missing")
        beside = path.parent / rules.reference.file.replace(STEM, path.stem)
        table = _read_csv_table(beside, rules.reference.columns)
        unit_quaternions(beside, table)
        reference = poses_of(table)
    return RawRecording(main, reference, rules, path)


def _read_csv_table(path: Path, columns: dict[str, MapColumn]) -> Columns:
    cells = read_csv(path, sorted({column.theirs for column in columns.values()}))
    table = {name: column.read(cells[column.theirs]) for name, column in columns.items()}
    if "t" in table:
        check_rising(table["t"], path, columns["t"].theirs, "line", 2)
    return table


def read_csv(path: str | Path, columns: Sequence[str]) -> dict[str, np.ndarray]:
    """The named columns of a CSV file with a header, each (N,) float64 and finite.

    Lines are counted from 1, the header included. Raises SurefootError for a file that is not
    there or not text, a missing or doubled column, a line of the wrong length, and a cell that is
    empty, not a number, or not finite.
    """
    path = Path(path)
    if not path.is_file():
        raise SurefootError(f"{path}: no such file")
    try:
        header = _header(path)
        for name in columns:
            if name not in header:
                raise SurefootError(f"{path}: column {name!r} is missing from the header")
            if header.count(name) > 1:
                raise SurefootError(f"{path}: column {name!r} is there more than once")
        with warnings.catch_warnings():
            # Too long a first line is a warning in pandas, and shifts the columns.
            warnings.simplefilter("error", pd.errors.ParserWarning)
            frame = pd.read_csv(
                path,
                index_col=False,
                encoding="utf-8-sig",
                skipinitialspace=True,
                skip_blank_lines=False,
                low_memory=False,
            )
    except UnicodeDecodeError as error:
        raise SurefootError(f"{path}: not a text file ({error.reason})") from error
    except (pd.errors.ParserError, pd.errors.ParserWarning, csv.Error, OSError) as error:
        raise SurefootError(f"{path}: {_one_line(error)}") from error
    frame.columns = header
    empty = frame.isna().all(axis=1).to_numpy()
    while len(empty) and empty[-1]:
        empty = empty[:-1]
    frame = frame.iloc[: len(empty)]
    if len(frame) == 0:
        raise SurefootError(f"{path}: no rows under the header")
    return {name: _numbers(path, frame[name]) for name in columns}


def _header(path: Path) -> list[str]:
    with path.open(newline="", encoding="utf-8-sig") as stream:
        header = next(csv.reader(stream, skipinitialspace=True), [])
    if not any(header):
        raise SurefootError(f"{path}: line 1: no header")
    return header


def _numbers(path: Path, cells: pd.Series) -> np.ndarray:
    if cells.dtype == bool or cells.dtype.kind not in "fiu":
        text = cells.where(cells.isna(), cells.astype(str))
        values = np.asarray(pd.to_numeric(text, errors="coerce"), dtype=float)
        bad = np.isnan(values) & ~cells.isna().to_numpy()
        if bad.any():
            row = int(np.argmax(bad))
            raise SurefootError(
                f"{path}: column {cells.name!r}, line {row + 2}: {str(cells.iloc[row])[:40]!r}"
                " is not a number"
            )
    else:
        values = np.asarray(cells, dtype=float)
    bad = ~np.isfinite(values)
    if bad.any():
        row = int(np.argmax(bad))
        what = "NaN or empty" if np.isnan(values[row]) else "infinite"
        raise SurefootError(f"{path}: column {cells.name!r}, line {row + 2}: {what}")
    return values


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split()).removeprefix("Error tokenizing data. C error: ")
