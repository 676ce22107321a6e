"""The index of a folder of simulated logs."""

from pathlib import Path

import pandas as pd

from surefoot.scenarios.datasets.index import INDEX_FOLDER


def read_index(folder: Path) -> pd.DataFrame:
    """A row for each log."""
    return pd.read_parquet(folder / INDEX_FOLDER / "index.parquet")
