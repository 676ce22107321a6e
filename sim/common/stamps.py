"""Evenly spaced rows of a log."""

import numpy as np


def rows_every(t: np.ndarray, period: float) -> np.ndarray:
    """Increasing rows of t (N,) [s]: for each multiple of `period` [s] after t[0], the first row at
    or after it.
    """
    rows = np.searchsorted(t, np.arange(t[0], t[-1], period))
    # Rounding may put the last time after the last row.
    return np.unique(np.minimum(rows, len(t) - 1))
