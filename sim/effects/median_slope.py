"""Slope of a line through points of which some are outliers."""

import numpy as np
from scipy.special import ndtri


def median_slope(x: np.ndarray, y: np.ndarray) -> tuple[float, float, float]:
    """Theil-Sen slope dy/dx of N points, and the ends of its 95 % interval.

    The median of the slopes between all pairs. The interval is by Kendall's test, corrected for
    equal values of y (Sen 1968).

    Args:
        x: (N,), all different.
        y: (N,).
    """
    many = len(x)
    first, second = np.triu_indices(many, 1)
    slopes = np.sort((y[second] - y[first]) / (x[second] - x[first]))
    ties = np.unique(y, return_counts=True)[1]
    square = (_pairs_weight(many) - _pairs_weight(ties).sum()) / 18.0
    width = -ndtri(0.025) * np.sqrt(max(square, 0.0))
    low = max(round((len(slopes) - width) / 2.0) - 1, 0)
    high = min(round((len(slopes) + width) / 2.0), len(slopes) - 1)
    return float(np.median(slopes)), float(slopes[low]), float(slopes[high])


def _pairs_weight(n):
    return n * (n - 1) * (2 * n + 5)
