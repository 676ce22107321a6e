"""What a filter's updates found, summed over windows of time: enough to judge them afterwards.

Of innovations r of claimed covariance W = S + R, the mean of r^T W^-1 r is their dimension if W is
right. If they are white besides, the variance of their sum is the sum of their variances, axis by
axis: what it is more says for how long they hang together. Neither needs more than sums.
"""

from dataclasses import dataclass

import numpy as np

from surefoot.sim.common.kernels import kernel

SUM_WINDOW = 1.0
"""s, about two strides."""
COUNT, LEFT_OUT, SQUARED, SUM, VARIANCE, RESTARTED = 0, 1, 2, 3, 6, 9
"""Columns (10) of a sensor's sums: updates used, those left out (of a foot that slipped, as long as
it is held out), r^T W^-1 r, of I's axes r (3) and the diagonal of W (3), and how often the filter
took back what it claimed because no foot passed its test."""


@dataclass(frozen=True)
class InnovationSums:
    """Sums of the updates of some sensors.

    start (W,) [s], when each window of SUM_WINDOW begins, multiples of it; sums (W, S, 10), the
    columns COUNT to RESTARTED of each sensor. Sensors are the feet of a leg filter, in the log's
    order, and then the velocities.
    """

    start: np.ndarray
    sums: np.ndarray


def no_sums(sensors: int) -> np.ndarray:
    """The sums (S, 10) of sensors that have seen nothing."""
    return np.zeros((sensors, 10))


def windows_of(t: np.ndarray) -> np.ndarray:
    """Which window each stamp (N,) [s] is in, as a whole number of SUM_WINDOW."""
    return np.floor(t / SUM_WINDOW).astype(np.int64)


def empty_sums(window: np.ndarray, sensors: int) -> InnovationSums:
    """Sums to fill, for the windows of successive rows (N,)."""
    start = window[np.r_[True, np.diff(window) != 0]] if len(window) else window
    return InnovationSums(start * SUM_WINDOW, np.zeros((len(start), sensors, 10)))


@kernel
def add_rejected(sums):
    """One update more that was rejected."""
    sums[LEFT_OUT] += 1.0


@kernel
def add_innovation(sums, distance: float, residual, S, measurement_cov):
    """One update more that was used.

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
