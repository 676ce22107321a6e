"""The smallest box by scenario optimisation with discarding.

In u = log epsilon, the smallest box that contains N errors is a linear program of three variables,

    minimise u_x + u_y + u_z   subject to   u_j >= log |e_ij|,   i = 1 .. N.

Of its constraints k may be discarded, by any rule, if the solution violates them all; then, with
probability 1 - beta over the errors drawn, the box fails to contain a further one with probability
at most v, where

    C(k+d-1, k) sum_{i < k+d} C(N, i) v^i (1-v)^(N-i) <= beta,   d = 3

(Campi and Garatti, A sampling-and-discarding approach to chance-constrained optimization, Journal
of Optimization Theory and Applications 148, 2011, Theorem 2.1).
"""

from bisect import bisect_left
from functools import lru_cache

import numpy as np
from scipy.special import gammaln
from scipy.stats import binom

from surefoot.models.calibration.regions import CONFIDENCE, BoundsError, Calibrator

VARIABLES = 3


class ScenarioBox(Calibrator):
    """The smallest box after discarding."""

    label = (
        "smallest box after discarding errors: joint level gamma, with a confidence over "
        "calibrations"
    )

    def __init__(self, gamma: float, confidence: float = CONFIDENCE):
        super().__init__(gamma)
        self.confidence: float | None = confidence
        self.stated = confidence

    def samples_needed(self) -> int:
        return least_samples(self.gamma, self.stated)

    def conformalize(self, errors: np.ndarray) -> None:
        self.epsilon = scenario_box(errors, self.gamma, self.stated)


def scenario_box(errors: np.ndarray, gamma: float, confidence: float = CONFIDENCE) -> np.ndarray:
    """Half widths (3,) of the box after discarding as many of errors (N, 3) as the bound allows.

    Errors are discarded one by one. The box touches at most three of them, one per axis; the one
    discarded is that whose removal shrinks the box most. Raises BoundsError where N <
    least_samples(gamma, confidence).
    """
    k = discards(len(errors), gamma, confidence)
    return _discarded_box(np.abs(errors), k)


def log_failure(n: int, k: int, gamma: float) -> float:
    """Logarithm of the left side of the bound, at v = 1 - gamma: probability that the statement
    fails.
    """
    d = VARIABLES
    ways = gammaln(k + d) - gammaln(k + 1) - gammaln(d)
    return float(ways + binom.logcdf(k + d - 1, n, 1 - gamma))


@lru_cache
def discards(n: int, gamma: float, confidence: float) -> int:
    """How many of n errors may be discarded. Raises BoundsError if n is too small even for none."""
    allowed = _allowed(confidence)
    if log_failure(n, 0, gamma) > allowed:
        raise BoundsError(
            f"{n} independent samples, gamma {gamma:g} at confidence {confidence:g} needs "
            f"{least_samples(gamma, confidence)}"
        )
    return bisect_left(range(1, n), True, key=lambda k: log_failure(n, k, gamma) > allowed)


@lru_cache
def least_samples(gamma: float, confidence: float = CONFIDENCE) -> int:
    """The least number of errors for which the bound holds with nothing discarded."""
    allowed, high = _allowed(confidence), VARIABLES
    while log_failure(high, 0, gamma) > allowed:
        high *= 2
    return 2 + bisect_left(range(2, high), True, key=lambda n: log_failure(n, 0, gamma) <= allowed)


def _allowed(confidence: float) -> float:
    """Logarithm of the largest probability of failure."""
    if not 0 < confidence < 1:
        raise BoundsError(f"confidence {confidence:g}: must lie between 0 and 1")
    return float(np.log1p(-confidence))


def _discarded_box(sizes: np.ndarray, k: int) -> np.ndarray:
    """Box (D,) of sizes (N, D) after greedily removing k rows, by the reduction of its volume."""
    for _ in range(k):
        top = sizes.argmax(axis=0)  # the row that determines each axis
        second, largest = np.sort(np.partition(sizes, -2, axis=0)[-2:], axis=0)
        shrunk = np.log(largest) - np.log(second)
        freed = [shrunk[top == row].sum() for row in top]
        sizes = np.delete(sizes, top[np.argmax(freed)], axis=0)
    return sizes.max(axis=0)
