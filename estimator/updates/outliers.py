"""Which measurements to leave out: errors beyond all that the calibration saw.

As pi -> 0 Theorem 1 moves gamma of the mass into a box however far away: the statement is believed
and the prior is not. The covariance grows with the square of the distance, so that outliers that
come in proportion to it (40 of the filter's own deviations, twice within a second) drive each
other, and the biases with them, without bound. Yet an error beyond all that n calibration samples
saw (`reach`) was worth at most 1/(n+1) there, and gamma says nothing of it. Where no state within
3.3 deviations of the estimate explains a measurement by an error within reach, it is left out,
unless this goes on: then the estimate is wrong. This goes beyond the paper.
"""

import numpy as np

from surefoot.sim.common.kernels import kernel

DOUBT = 3.3
"""Deviations of the estimate that are granted before a measurement counts as an outlier."""
PATIENCE = 25
"""Measurements left out in a row, after which they are believed, where no window says how many."""
ANY = np.full(3, np.inf)
"""The reach that leaves nothing out."""


@kernel
def is_outlier(S, residual, reach, patience: int, counts) -> bool:
    """Whether to leave a measurement out: residual (3,) of prior covariance S (3, 3), reach (3,).

    counts[1] are those left out in a row, kept here; more than `patience` are no outliers.
    """
    for i in range(3):
        if abs(residual[i]) > reach[i] + DOUBT * np.sqrt(S[i, i]):
            counts[1] += 1
            return counts[1] <= patience
    counts[1] = 0
    return False
