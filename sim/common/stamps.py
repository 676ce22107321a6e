"""Rows of a log at even times."""

import numpy as np


def rows_every(t: np.ndarray, period: float) -> np.ndarray:
    """Increasing rows of t (N,) [s] that are next at or after every `period` [s] from t[0] on."""
    rows = np.searchsorted(t, np.arange(t[0], t[-1], period))
    # Rounding may put the last time behind the last row.
    return np.unique(np.minimum(rows, len(t) - 1))
