"""The beta-mixing coefficient of errors: how far apart two count as independent.

Histogram estimator of McDonald, Shalizi and Schervish (Estimating beta-mixing coefficients via
histograms, Electronic Journal of Statistics 9, 2015), for blocks of d samples, a apart:

    beta^d(a) = 1/2 sum |p_2d(block, block a later) - p_d(block) p_d(block)|

On a finite record it stays above zero even for independent samples, so the curve is read against
its own floor: the same estimate at lags so long that no dependence is left. On Gaussian
autoregressions, whose coefficient is known, K so read comes out at the true one to a third above
it, for the slowest of three axes decides.

Errors of a gait with a fixed period do not mix at all: they repeat with the stride, and the curve
has a peak at each of its multiples, however far away. K falls between the peaks. A spacing that is
a multiple of the stride would show the calibration one moment of the stride alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

THRESHOLD = 0.05
"""The paper's: K is chosen where beta comes down to about this."""
LONGEST_LAG = 200
"""Longest lag looked at, in samples of 10 ms."""


@dataclass(frozen=True)
class Mixing:
    """The curve from which K was chosen, for plotting.

    lags (L,) in samples; beta (L, D): the histogram estimate of each axis; floor (D,): what it
    shows where there is no dependence; K; mixed: whether every axis had come down to `threshold`
    by K (if not, K is the lag where the worst axis is lowest).
    """

    lags: np.ndarray
    beta: np.ndarray
    floor: np.ndarray
    K: int
    mixed: bool
    threshold: float = THRESHOLD

    @property
    def excess(self) -> np.ndarray:
        """Dependence (L, D) above the floor, sqrt(beta^2 - floor^2): K is read from this.

        A histogram cell's |difference| is that of a true difference plus noise of the floor's
        size, and these add about as squares do.
        """
        return np.sqrt(np.maximum(self.beta**2 - self.floor**2, 0.0))


def mixing(errors: np.ndarray, farthest: int = LONGEST_LAG, threshold: float = THRESHOLD) -> Mixing:
    """The mixing curve of errors (n, D), each axis by itself, and the spacing K it asks for.

    K is the first lag at which no axis depends on itself by more than `threshold`. Lags go up to
    `farthest` or a tenth of the record.
    """
    n, D = errors.shape
    lags = np.arange(1, max(2, min(farthest, n // 10) + 1))
    states = [discretise(errors[:, axis]) for axis in range(D)]
    beta = np.array([[beta_coefficient(s, lag) for s in states] for lag in lags.tolist()])
    floor = np.array([independence_floor(s) for s in states])
    curve = Mixing(lags, beta, floor, 1, True, threshold)
    worst = curve.excess.max(axis=1)
    mixed = bool((worst <= threshold).any())
    best = np.argmax(worst <= threshold) if mixed else np.argmin(worst)
    return Mixing(lags, beta, floor, int(lags[best]), mixed, threshold)


def discretise(x: np.ndarray, blocks: int = 1) -> np.ndarray:
    """Bin numbers (n,) of x (n,), in n^(1/(2 blocks + 2)) bins of equal counts.

    beta does not change under a monotone map of x, so bins of equal counts lose nothing and leave
    no cell empty for a heavy tail. Ties share a bin.
    """
    bins = max(2, round(len(x) ** (1 / (2 * blocks + 2))))
    edges = np.unique(np.quantile(x, np.arange(1, bins) / bins))
    return np.searchsorted(edges, x, side="right")


def beta_coefficient(states: np.ndarray, lag: int, blocks: int = 1) -> float:
    """beta^d(lag) of a sequence of bin numbers (n,), d = `blocks`; exact bins make it McDonald's.

    The second block starts `lag` samples after the first one ends.
    """
    base = int(states.max()) + 1
    length = len(states) - blocks + 1
    code = np.zeros(length, dtype=np.int64)
    for i in range(blocks):
        code = code * base + states[i : i + length]
    step = lag + blocks - 1
    return _distance(code[:-step], code[step:], base**blocks)


def independence_floor(states: np.ndarray, shifts: int = 64) -> float:
    """Mean beta^1 at `shifts` lags of a quarter to three quarters of the record, wrapped around."""
    n = len(states)
    far = np.linspace(n // 4, 3 * n // 4, shifts).astype(int)
    base = int(states.max()) + 1
    return float(np.mean([_distance(states, np.roll(states, -s), base) for s in far]))


def _distance(first: np.ndarray, second: np.ndarray, base: int) -> float:
    """Total variation between the joint histogram of two sequences and its marginals' product."""
    joint = np.bincount(first * base + second, minlength=base * base).reshape(base, base)
    joint = joint / len(first)
    return float(0.5 * np.abs(joint - np.outer(joint.sum(axis=1), joint.sum(axis=0))).sum())
