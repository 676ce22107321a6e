"""Beta-mixing coefficient of errors: the spacing at which they are nearly independent.

Histogram estimator of McDonald, Shalizi and Schervish (Estimating beta-mixing coefficients via
histograms, Electronic Journal of Statistics 9, 2015), for single samples, a apart:

    beta^1(a) = 1/2 sum |p_2(sample, sample a later) - p_1(sample) p_1(sample)|

On a finite record it is above zero even for independent samples, so the curve is compared with its
own floor: the same estimate at lags so long that no dependence is left. On Gaussian
autoregressions, whose coefficient is known, the resulting K is between the true one and a third
more, since the slowest of three axes decides.

Errors of a strictly periodic gait do not mix: they repeat with the stride, and the curve has a peak
at each of its multiples, however distant. K falls between the peaks. A spacing of a multiple of the
stride would sample a single phase of it.
"""

from dataclasses import dataclass

import numpy as np

THRESHOLD = 0.05
"""Threshold of the paper: K is chosen where beta falls to about this."""
LONGEST_LAG = 200
"""Longest lag considered, in samples of 10 ms."""
FLOOR_LAGS = 64
"""Lags at which the dependence of errors that are far apart is averaged."""


@dataclass(frozen=True)
class Mixing:
    """The curve from which K was chosen, for plotting.

    Attributes:
        lags: (L,), in samples.
        beta: histogram estimate of each axis (L, D).
        floor: estimate without dependence (D,).
        K: chosen spacing.
        mixed: whether every axis was below `threshold` at K; if not, K is the lag at which the
            worst axis is lowest.
        threshold: for the choice.
    """

    lags: np.ndarray
    beta: np.ndarray
    floor: np.ndarray
    K: int
    mixed: bool
    threshold: float = THRESHOLD

    @property
    def excess(self) -> np.ndarray:
        """Dependence (L, D) above the floor, sqrt(beta^2 - floor^2), from which K is determined.

        The |difference| in a histogram cell is that of a true difference plus noise of the floor's
        size, which add approximately in squares.
        """
        return np.sqrt(np.maximum(self.beta**2 - self.floor**2, 0.0))


def mixing(errors: np.ndarray, walk: np.ndarray | None = None) -> Mixing:
    """Mixing curve of errors (n, D), each axis by itself, and the resulting spacing K.

    K is the first lag at which the dependence of every axis is at most THRESHOLD. Lags extend to
    LONGEST_LAG or a tenth of the record.

    Args:
        errors: of one walk after another.
        walk: (n,), number of the walk of each error; only errors of one walk are compared.
    """
    n, D = errors.shape
    lags = np.arange(1, max(2, min(LONGEST_LAG, n // 10) + 1))
    states = [discretise(errors[:, axis]) for axis in range(D)]
    beta = np.array([[beta_coefficient(s, lag, walk) for s in states] for lag in lags.tolist()])
    floor = np.array([independence_floor(s) for s in states])
    curve = Mixing(lags, beta, floor, 1, True)
    worst = curve.excess.max(axis=1)
    mixed = bool((worst <= THRESHOLD).any())
    best = np.argmax(worst <= THRESHOLD) if mixed else np.argmin(worst)
    return Mixing(lags, beta, floor, int(lags[best]), mixed)


def discretise(x: np.ndarray) -> np.ndarray:
    """Bin numbers (n,) of x (n,), in n^(1/4) bins of equal counts.

    beta is invariant under monotone maps of x, so bins of equal counts lose nothing and leave no
    cell empty for heavy tails. Ties share a bin.
    """
    bins = max(2, round(len(x) ** 0.25))
    edges = np.unique(np.quantile(x, np.arange(1, bins) / bins))
    return np.searchsorted(edges, x, side="right")


def beta_coefficient(states: np.ndarray, lag: int, walk: np.ndarray | None = None) -> float:
    """beta^1(lag) of a sequence of bin numbers (n,); exact bins make it McDonald's.

    walk: (n,), of which pairs must have the same number.
    """
    first, second = states[:-lag], states[lag:]
    if walk is not None:
        same = walk[:-lag] == walk[lag:]
        first, second = first[same], second[same]
    return _distance(first, second, int(states.max()) + 1)


def independence_floor(states: np.ndarray) -> float:
    """Mean beta^1 at FLOOR_LAGS lags, from a quarter to three quarters of the wrapped record."""
    n = len(states)
    far = np.linspace(n // 4, 3 * n // 4, FLOOR_LAGS).astype(int)
    base = int(states.max()) + 1
    return float(np.mean([_distance(states, np.roll(states, -s), base) for s in far]))


def _distance(first: np.ndarray, second: np.ndarray, base: int) -> float:
    """Total variation distance between the joint histogram of two sequences and the product of its
    marginals.
    """
    joint = np.bincount(first * base + second, minlength=base * base).reshape(base, base)
    joint = joint / len(first)
    return float(0.5 * np.abs(joint - np.outer(joint.sum(axis=1), joint.sum(axis=0))).sum())
