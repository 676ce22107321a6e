"""Rank and quantile of split conformal prediction."""

import math
from fractions import Fraction

import numpy as np

from surefoot.sim.common.errors import SurefootError


class BoundsError(SurefootError):
    """Bounds that cannot be read or computed, or that belong to another observer."""


def level_per_axis(gamma: float) -> float:
    """gamma^(1/3), the level of each axis. Raises BoundsError unless 0 < gamma < 1."""
    if not 0 < gamma < 1:
        raise BoundsError(f"gamma {gamma:g}: must lie between 0 and 1")
    return gamma ** (1 / 3)


def rank(n: int, level: float) -> int:
    """k = ceil((n + 1) level): which of n sorted scores is the bound; none if more than n.

    In exact arithmetic on the level's shortest decimal form, so that 0.9 of 10 is 9 and not 10.
    """
    return math.ceil((n + 1) * Fraction(repr(float(level))))


def least_rank(level: float) -> int:
    """The least n whose rank(n, level) is no more than n."""
    exact = Fraction(repr(float(level)))
    return math.ceil(exact / (1 - exact))


def conformal_quantile(scores: np.ndarray, level: float) -> np.ndarray:
    """The k-th smallest of scores (N, D) by column, (D,), k = rank(N, level).

    Raises BoundsError where k > N.
    """
    k = rank(len(scores), level)
    if k > len(scores):
        raise BoundsError(
            f"{len(scores)} independent samples, a bound at level {level:.4f} needs "
            f"{least_rank(level)}"
        )
    return np.sort(scores, axis=0)[k - 1]
