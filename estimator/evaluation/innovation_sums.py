"""Sums of a filter's innovations over windows of time, enough to test its consistency afterwards.

For innovations r with claimed covariance W = S + R, the mean of r^T W^-1 r is their dimension if W
is right. If they are white as well, the variance of their sum is the sum of their variances, axis
by axis; an excess measures their correlation time. Both need sums only.
"""

from dataclasses import dataclass

import numpy as np

from surefoot.sim.common.kernels import kernel

SUM_WINDOW = 1.0
"""Length of a window [s], about two strides."""
COUNT, LEFT_OUT, SQUARED, SUM, VARIANCE, RESTARTED = 0, 1, 2, 3, 6, 9
"""Columns (10) of a sensor's sums: number of updates used and left out (for a foot that slipped, as
long as it is held out), r^T W^-1 r, components of r in I (3), diagonal of W (3), and how often the
filter reset its confidence because no foot passed its test.
"""


@dataclass(frozen=True)
class InnovationSums:
    """Sums over the updates of some sensors.

    Attributes:
        start: start of each window of SUM_WINDOW (W,) [s], a multiple of it.
        sums: columns COUNT to RESTARTED of each sensor (W, S, 10). Sensors are the feet of a leg
            filter, in the log's order, then the velocities.
    """

    start: np.ndarray
    sums: np.ndarray


def windows_of(t: np.ndarray) -> np.ndarray:
    """Index of each stamp's window (N,), in multiples of SUM_WINDOW; t (N,) [s]."""
    return np.floor(t / SUM_WINDOW).astype(np.int64)


def empty_sums(t: np.ndarray, sensors: int) -> tuple[InnovationSums, np.ndarray]:
    """Empty sums for successive rows at t (N,) [s], and the index of each row's window (N,)."""
    start, window = np.unique(windows_of(t), return_inverse=True)
    return InnovationSums(start * SUM_WINDOW, np.zeros((len(start), sensors, 10))), window


@kernel
def add_innovation(sums, distance: float, residual, S, measurement_cov):
    """Count an update that was used.

    Args:
        sums: of the sensor (10,), in place.
        distance: r^T W^-1 r.
        residual: r (3,).
        S: (3, 3), H Sigma H^T.
        measurement_cov: R (3, 3).
    """
    sums[COUNT] += 1.0
    sums[SQUARED] += distance
    for i in range(3):
        sums[SUM + i] += residual[i]
        sums[VARIANCE + i] += S[i, i] + measurement_cov[i, i]
