"""Times between the rows of a log, from joints with both angle and rate.

The change of the joints' angles over a row, divided by their rate, is its duration. A log without
time stamps, or with wrong ones, thus has a clock that is as accurate as the scale of the rates.
"""

from dataclasses import dataclass

import numpy as np

from surefoot.extend import block_bootstrap_counts

FAST = 7.0
"""Norm of all joints' rates from which a single row's time is estimated [rad/s]."""
TOGETHER = 16
"""Number of rows for a joint's mean time: rows of unequal length would bias single ones."""
ROWS_OF_BLOCK = 512
"""Number of rows in a block of the bootstrap."""


@dataclass(frozen=True)
class RowTimes:
    """Times between rows, from the rates that the joints report.

    Attributes:
        period: mean time of a row by each joint (J,) [s].
        periods: its 95 % interval (J, 2) [s].
        each: time of each single row (N - 1,) [s], NaN where too little moves.
        short: centre of the lower of the two clusters of these times [s].
        long: centre of the upper one [s].
        ratio: long / short.
        ratio_interval: its 95 % interval.
        share: of short rows.
        share_interval: its 95 % interval.
    """

    period: np.ndarray
    periods: np.ndarray
    each: np.ndarray
    short: float
    long: float
    ratio: float
    ratio_interval: tuple[float, float]
    share: float
    share_interval: tuple[float, float]


def row_times(q: np.ndarray, dq: np.ndarray, rng: np.random.Generator) -> RowTimes:
    """Estimate the times between the rows of q (N, J) [rad] with rates dq (N, J) [rad/s]."""
    turned, rate = np.diff(q, axis=0), 0.5 * (dq[1:] + dq[:-1])
    block = np.arange(len(turned)) // ROWS_OF_BLOCK
    counts = block_bootstrap_counts(block[-1] + 1, rng)
    many = np.arange(len(turned)) // TOGETHER
    far, whole = _sums(many, turned), _sums(many, rate)
    top = _sums(block[::TOGETHER], far * whole)
    bottom = _sums(block[::TOGETHER], whole * whole)
    period = top.sum(axis=0) / bottom.sum(axis=0)
    drawn = (counts @ top) / (counts @ bottom)
    # A scale error of a joint's rate would blur the clusters.
    rate = rate * period / period.mean()
    fast = np.linalg.norm(rate, axis=1) > FAST
    speed = np.maximum(np.sum(rate * rate, axis=1), 1e-12)
    each = np.where(fast, np.sum(turned * rate, axis=1) / speed, np.nan)
    low, high = two_heaps(each[fast])
    resampled = (np.repeat(each, np.repeat(n, ROWS_OF_BLOCK)[: len(each)]) for n in counts[:200])
    found = np.array([_ratio_and_share(times) for times in resampled])
    ratio, share = _ratio_and_share(each)
    (r0, s0), (r1, s1) = np.percentile(found, [2.5, 97.5], axis=0)
    return RowTimes(
        period=period,
        periods=np.percentile(drawn, [2.5, 97.5], axis=0).T,
        each=each,
        short=low,
        long=high,
        ratio=ratio,
        ratio_interval=(float(r0), float(r1)),
        share=share,
        share_interval=(float(s0), float(s1)),
    )


def two_heaps(x: np.ndarray) -> tuple[float, float]:
    """Medians of the lower and the upper of two clusters of numbers (N,)."""
    low, high = np.quantile(x, [0.25, 0.75])
    for _ in range(20):
        below = x < 0.5 * (low + high)
        low, high = np.median(x[below]), np.median(x[~below])
    return float(low), float(high)


def _ratio_and_share(each: np.ndarray) -> tuple[float, float]:
    known = each[np.isfinite(each)]
    low, high = two_heaps(known)
    return high / low, float(np.mean(known < 0.5 * (low + high)))


def _sums(block: np.ndarray, x: np.ndarray) -> np.ndarray:
    return np.add.reduceat(x, np.searchsorted(block, np.arange(block[-1] + 1)), axis=0)
