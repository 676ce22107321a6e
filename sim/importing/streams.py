"""Columns of a log that are held.

A column is held if it repeats its value exactly although it moves by far more than its resolution:
a slower sensor was read more often than it measures.
"""

from collections import defaultdict

import numpy as np

from surefoot.sim.importing.clock import column_kind
from surefoot.sim.log import Log

_MOVES = 20.0
"""Motion within _MOVING seconds, in resolutions, at which a repeated value is significant."""
_STEPS = 3.0
"""Mean size of the changes within _MOVING seconds, in resolutions, from which rounding explains
fewer repeated values than _HELD_SHARE: it repeats those between which there is no whole resolution.
"""
_MOVING = 0.05
"""Half a swing [s]."""
_HELD_SHARE = 0.15
"""Share of repeated values from which a column is held; fewer are quantisation of a slow motion, or
single missed rows.
"""
_MOVING_ROWS = 50
"""Least number of rows in motion."""


def held_streams(log: Log) -> dict[str, dict[str, float]]:
    """Rates [Hz] at which the values of columns change that were sampled more slowly than the rows
    of a log, by kind (gyro, q, ...) and name.
    """
    found: dict[str, dict[str, float]] = defaultdict(dict)
    for name in map(str, log.frame):
        if name == "t" or name.startswith(("ref_", "contact_", "slip_", "mu_")):
            continue
        share = _repeated(log.t, log.frame[name].to_numpy())
        if share > _HELD_SHARE:
            found[column_kind(name)][name] = log.rate * (1.0 - share)
    return found


def with_short_gaps(t: np.ndarray, longest: float) -> np.ndarray:
    """Times (N,) [s] with gaps of at most `longest`: no rows are compared across longer ones."""
    more = np.maximum(np.diff(t) - longest, 0.0)
    return t - np.concatenate([[0.0], np.cumsum(more)]) if more.any() else t


def _repeated(t: np.ndarray, x: np.ndarray) -> float:
    """Share of the moving rows of x (N,) that repeat the one before."""
    change = np.abs(np.diff(x))
    if not change.any():
        return 0.0
    resolution = change[change > 0].min()
    # The distance travelled within the window is much cheaper than its range, and as informative.
    travelled, changes = _moving_sum(t, change), _moving_sum(t, change > 0.0)
    moving = travelled > np.maximum(_MOVES, _STEPS * changes) * resolution
    if moving.sum() < _MOVING_ROWS:
        return 0.0
    return float(np.mean(change[moving] == 0.0))


def _moving_sum(t: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Sum of x (N - 1,) within _MOVING seconds around each of t[1:], for t (N,) [s]."""
    total = np.concatenate([[0.0], np.cumsum(x)])
    ends = [np.interp(t[1:] + side * _MOVING, t, total) for side in (-0.5, 0.5)]
    return ends[1] - ends[0]
