"""The index of a folder of simulated logs, and their contents."""

import hashlib
from pathlib import Path

import pandas as pd

from surefoot.scenarios.datasets.index import INDEX_FOLDER


def read_index(folder: Path) -> pd.DataFrame:
    """A row for each log."""
    return pd.read_parquet(folder / INDEX_FOLDER / "index.parquet")


def digests(folder: str | Path) -> dict[str, str]:
    """Name of each log -> digest of its bytes."""
    logs = Path(folder).glob("*.parquet")
    return {log.name: hashlib.sha256(log.read_bytes()).hexdigest() for log in logs}
