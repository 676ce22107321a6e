"""Which measurements to reject: errors beyond all that the calibration saw.

As pi -> 0 Theorem 1 moves gamma of the mass into a box however far away: the statement outweighs
the prior. The covariance grows with the square of the distance, so that outliers that come in
proportion to it (40 of the filter's own deviations, twice within a second) drive each other, and
the biases with them, without bound. Yet an error beyond all that n calibration samples saw
(`max_error`) had a probability of at most 1/(n+1) there, and gamma says nothing of it. Where no
state within 3.3 deviations of the estimate explains a measurement by an error within max_error, it
is rejected, unless this goes on: then the estimate is wrong. This goes beyond the paper.
"""

import numpy as np

from surefoot.sim.common.kernels import kernel

SIGMAS = 3.3
"""Deviations of the estimate that are granted before a measurement counts as an outlier."""
MOST_REJECTED = 25
"""Measurements rejected in a row, after which they are used, where no window says how many."""
UNLIMITED = np.full(3, np.inf)
"""The max_error that rejects nothing."""

GATHERED, REJECTED = 0, 1
"""Places in a filter's counts (2,): measurements in the window so far, and rejected in a row."""


def fresh_counts() -> np.ndarray:
    """The counts (2,) of a filter that has seen no measurement."""
    return np.zeros(2, dtype=np.int64)


@kernel
def is_outlier(S, residual, max_error, most: int, counts) -> bool:
    """Whether to reject a measurement, whose count it keeps in `counts`.

    Args:
        S: prior covariance (3, 3) of the measured velocity, [m^2/s^2].
        residual: measured minus predicted (3,) [m/s].
        max_error: largest error of a measurement (3,) [m/s].
        most: rejected in a row; one more is no outlier.
        counts: of the filter (2,), see GATHERED and REJECTED.
    """
    for i in range(3):
        if abs(residual[i]) > max_error[i] + SIGMAS * np.sqrt(S[i, i]):
            counts[REJECTED] += 1
            return counts[REJECTED] <= most
    counts[REJECTED] = 0
    return False
