"""Rejection of outliers: errors larger than any in the calibration.

As pi -> 0, Theorem 1 moves gamma of the mass into a box however far away: the statement overrides
the prior. The covariance grows with the square of the distance, so outliers that are proportional
to it (40 of the filter's own deviations, twice within a second) amplify each other, and the biases,
without bound. Yet an error larger than all of n calibration samples (`max_error`) had a probability
of at most 1/(n+1) there, about which gamma says nothing. A measurement is rejected if no state
within 3.3 deviations of the estimate explains it by an error within max_error, unless this
continues: then the estimate is wrong. This goes beyond the paper.
"""

import numpy as np

from surefoot.sim.common.kernels import kernel

SIGMAS = 3.3
"""Deviations of the estimate that are allowed before a measurement is an outlier."""
MOST_REJECTED = 25
"""Largest number of measurements rejected in a row by a filter without a window."""
UNLIMITED = np.full(3, np.inf)
"""A max_error that rejects nothing."""

GATHERED, REJECTED = 0, 1
"""Indices into a filter's counts (2,): measurements in the window so far, and rejected in a row."""


def fresh_counts() -> np.ndarray:
    """Counts (2,) of a filter without measurements."""
    return np.zeros(2, dtype=np.int64)


@kernel
def is_outlier(S, residual, max_error, most: int, counts) -> bool:
    """Whether to reject a measurement; updates `counts`.

    Args:
        S: prior covariance (3, 3) of the measured velocity, [m^2/s^2].
        residual: measured minus predicted (3,) [m/s].
        max_error: largest error of a measurement (3,) [m/s].
        most: number rejected in a row, after which a measurement is accepted.
        counts: of the filter (2,), see GATHERED and REJECTED.
    """
    for i in range(3):
        if abs(residual[i]) > max_error[i] + SIGMAS * np.sqrt(S[i, i]):
            counts[REJECTED] += 1
            return counts[REJECTED] <= most
    counts[REJECTED] = 0
    return False
