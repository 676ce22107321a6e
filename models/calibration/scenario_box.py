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

from surefoot.models.calibration.conformal import BoundsError
from surefoot.models.calibration.regions import CONFIDENCE, Calibrator
from surefoot.sim.common.kernels import kernel

VARIABLES = 3


class ScenarioBox(Calibrator):
    """The smallest box after discarding."""

    label = (
        "smallest box after discarding errors: joint level gamma, with a confidence over "
        "calibrations"
    )

    def __init__(self, gamma: float, confidence: float = CONFIDENCE):
        super().__init__(gamma)
        self.stated = confidence
        self.confidence: float | None = confidence

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
    return _discarded_box(np.ascontiguousarray(np.abs(errors)), k)


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
    _check_confidence(confidence)
    allowed = np.log1p(-confidence)
    if log_failure(n, 0, gamma) > allowed:
        raise BoundsError(
            f"{n} independent samples, gamma {gamma:g} at confidence {confidence:g} needs "
            f"{least_samples(gamma, confidence)}"
        )
    return bisect_left(range(1, n), True, key=lambda k: log_failure(n, k, gamma) > allowed)


@lru_cache
def least_samples(gamma: float, confidence: float = CONFIDENCE) -> int:
    """The least number of errors for which the bound holds with nothing discarded."""
    _check_confidence(confidence)
    allowed = np.log1p(-confidence)
    high = VARIABLES
    while log_failure(high, 0, gamma) > allowed:
        high *= 2
    return 2 + bisect_left(range(2, high), True, key=lambda n: log_failure(n, 0, gamma) <= allowed)


def _check_confidence(confidence: float) -> None:
    if not 0 < confidence < 1:
        raise BoundsError(f"confidence {confidence:g}: must lie between 0 and 1")


@kernel
def _discarded_box(sizes: np.ndarray, k: int) -> np.ndarray:
    """Box (D,) of sizes (N, D) after greedily removing k rows, by the reduction of its volume."""
    N, D = sizes.shape
    alive = np.ones(N, dtype=np.bool_)
    box = np.zeros(D)
    for removed in range(k + 1):
        # The rows that determine each axis, and the size of the axis without each of them.
        top, second = np.zeros(D, dtype=np.int64), np.zeros(D)
        for j in range(D):
            first, next_ = -1.0, -1.0
            for i in range(N):
                if alive[i]:
                    if sizes[i, j] > first:
                        first, next_, top[j] = sizes[i, j], first, i
                    elif sizes[i, j] > next_:
                        next_ = sizes[i, j]
            box[j], second[j] = first, next_
        if removed == k:
            break
        best, freed = top[0], -1.0
        for j in range(D):
            shrunk = 0.0
            for a in range(D):
                if top[a] == top[j]:
                    shrunk += np.log(box[a]) - np.log(second[a])
            if shrunk > freed:
                best, freed = top[j], shrunk
        alive[best] = False
    return box
