"""Tables in JSON: a list of records, one record per line, or lists by name."""

import json
from pathlib import Path

import numpy as np
import pandas as pd

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.limits import check_limit, check_unpacked
from surefoot.sim.importing.table import RecordedTable

_DEEPEST = 20
_SWOLLEN = 25.0
"""Memory per byte of text, for a text of empty lists and records [bytes]."""


def read_json(path: Path) -> RecordedTable:
    """Read the table of a .json, .jsonl or .ndjson file.

    A record's fields are `a.b`, an element of a list `a[0]`; a record without a field has an empty
    cell. Raises SurefootError.
    """
    check_limit("memory", _SWOLLEN * path.stat().st_size, f"{path}: bytes in memory")
    cells: dict[str, np.ndarray] = {}
    text = path.read_text(encoding="utf-8-sig")
    if path.suffix == ".json":
        found = json.loads(text)
    else:
        found = [json.loads(line) for line in text.splitlines() if line.strip()]
    _collect(found, "", cells, path)
    if not cells:
        raise SurefootError(f"{path}: no records and no lists in it")
    return RecordedTable(path, cells)


def _collect(
    node: object, name: str, cells: dict[str, np.ndarray], path: Path, deeper: int = _DEEPEST
) -> None:
    """Add the lists and records in a node to cells. Raises SurefootError for too many fields.

    Args:
        node: of the parsed file.
        name: its path, "" for the whole.
        cells: of each list or record by its path, added to.
        path: of the file.
        deeper: number of levels that are still read.
    """
    if isinstance(node, dict) and deeper:
        for key, value in node.items():
            _collect(value, f"{name}.{key}" if name else key, cells, path, deeper - 1)
    elif isinstance(node, list) and node:
        if all(isinstance(one, dict) for one in node):
            records = [_flat(one, name, deeper) for one in node]
            keys = dict.fromkeys(key for one in records for key in one)
            check_limit("columns", len(keys), f"{path}: fields of its records")
            cells_of_all = 8.0 * len(keys) * len(records)
            check_unpacked(path.stat().st_size, cells_of_all, f"{path}: bytes of its records")
            cells |= {key: _array([one.get(key) for one in records]) for key in keys}
        else:
            cells[name or "array"] = _array(node)


def _flat(record: dict, name: str, deeper: int) -> dict[str, object]:
    """The fields of a record by their paths, with `name` in front."""
    found: dict[str, object] = {}
    for key, value in record.items():
        path = f"{name}.{key}" if name else key
        nested = isinstance(value, dict) and deeper
        found |= _flat(value, path, deeper - 1) if nested else {path: value}
    return found


def _array(values: list) -> np.ndarray:
    """(N,) or (N, K) of numbers where possible; else (N,) of objects."""
    if all(isinstance(one, int | float) for one in values):
        return np.array(values, dtype=float)
    return pd.Series(values, dtype=object).to_numpy()  # NumPy would make lists a matrix
