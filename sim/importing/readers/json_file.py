"""Tables in JSON: a list of records, one record per line, or lists by name."""

import json
from pathlib import Path

import numpy as np
import pandas as pd

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.limits import check_limit, check_unpacked
from surefoot.sim.importing.readers.table import RecordedTable

_SWOLLEN = 25.0
"""Memory per byte of text, for a text of empty lists and records [bytes]."""
_COSTS = {",": 200, "[": 600, "{": 2400}
"""Bytes in a file that may take as long to read as a number, a list or a record, by its sign."""


def read_json(path: Path) -> RecordedTable:
    """Read the table of a .json, .jsonl or .ndjson file.

    A record's fields are `a.b`, an element of a list `a[0]`; a record without a field has an empty
    cell. Raises SurefootError.
    """
    size = path.stat().st_size
    check_limit("memory", _SWOLLEN * size, f"{path}: bytes in memory")
    text = path.read_text(encoding="utf-8-sig")
    taken = sum(cost * text.count(sign) for sign, cost in _COSTS.items())
    check_unpacked(size, taken, f"{path}: bytes of its lists and records", at_once=False)
    if path.suffix == ".json":
        found = json.loads(text)
    else:
        found = [json.loads(line) for line in text.splitlines() if line.strip()]
    cells: dict[str, np.ndarray] = {}
    for name, node in (_flat(found, "") if isinstance(found, dict) else {"": found}).items():
        if isinstance(node, list) and node and all(isinstance(one, dict) for one in node):
            records = [_flat(one, name) for one in node]
            keys = dict.fromkeys(key for one in records for key in one)
            check_limit("columns", len(keys), f"{path}: fields of its records")
            cells_of_all = 80.0 * len(keys) * len(records)
            check_unpacked(size, cells_of_all, f"{path}: bytes of its records", at_once=False)
            cells |= {key: _array([one.get(key) for one in records]) for key in keys}
        elif isinstance(node, list) and node:
            cells[name or "array"] = _array(node)
    if not cells:
        raise SurefootError(f"{path}: no records and no lists in it")
    return RecordedTable(path, cells)


def _flat(record: dict, name: str) -> dict[str, object]:
    """The fields of a record by their paths, with `name` in front."""
    found: dict[str, object] = {}
    for key, value in record.items():
        path = f"{name}.{key}" if name else key
        found |= _flat(value, path) if isinstance(value, dict) else {path: value}
    return found


def _array(values: list) -> np.ndarray:
    """(N,) or (N, K) of numbers where possible; else (N,) of objects."""
    if all(isinstance(one, int | float) for one in values):
        return np.array(values, dtype=float)
    return pd.Series(values, dtype=object).to_numpy()  # NumPy would make lists a matrix
