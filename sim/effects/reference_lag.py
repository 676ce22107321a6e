"""Lag of the reference relative to the gyro, from the rotations that both show."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from surefoot.sim.common.series import convolve
from surefoot.sim.log import Log

LAG_PIECE = 4.0
"""Length of the pieces of a log over which the lag of a stream is taken to be constant [s]: a few
strides.
"""
FEWEST_LAGS = 6
"""Least number of lags for a drift: three meaningless lags look like a drift in a third of all
draws, six in 2 %.
"""
_TURNING = ("gyro_x", "gyro_y", "gyro_z", "ref_q_w", "ref_q_x", "ref_q_y", "ref_q_z")


def reference_lag(log: Log, most: float) -> float:
    """Delay [s] of the reference's rotation relative to the gyro, up to +-`most`.

    Where their correlation is largest, to the row.
    """
    return log.once(
        f"reference lag within {most}", _TURNING, lambda: _turning_lag(_turning(log), most)
    )


class _Turning(NamedTuple):
    """Rotation of a body by its reference and by its gyro, in the K steps between rows.

    Attributes:
        duration: of each step (K,) [s].
        reference: angular rate by the reference (K, 3) [rad/s].
        gyro: angular rate by the gyro (K, 3) [rad/s].
    """

    duration: np.ndarray
    reference: np.ndarray
    gyro: np.ndarray

    def steps(self, which: slice) -> "_Turning":
        return _Turning(*(x[which] for x in self))


def _turning(log: Log) -> _Turning:
    def made() -> _Turning:
        turning, steps = Rotation.from_quat(log.ref_q, scalar_first=True), np.diff(log.t)
        turned = (turning[:-1].inv() * turning[1:]).as_rotvec() / steps[:, None]
        return _Turning(steps, turned, 0.5 * (log.gyro[1:] + log.gyro[:-1]))

    return log.once("turning by reference and gyro", _TURNING, made)


def _turning_lag(turning: _Turning, most: float) -> float:
    row, turned, gyro = float(np.mean(turning.duration)), turning.reference, turning.gyro
    both = [x - x.mean(axis=0) for x in (turned, gyro)]
    shared = np.sum(
        [convolve(a, b[::-1]) for a, b in zip(*(x.T for x in both), strict=True)], axis=0
    )
    lags = np.arange(1 - len(gyro), len(turned)) * row
    near = np.abs(lags) <= most
    return float(lags[near][np.argmax(shared[near])])


def reference_lag_drift(log: Log, most: float) -> float:
    """Drift [s/s] of the reference's delay relative to the gyro, up to +-`most`.

    Median slope of the lags of pieces of the log (Theil-Sen). 0 if its 95 % interval contains 0, as
    it does if the pieces rotate too little to show a lag.
    """
    return log.once(f"reference drift within {most}", _TURNING, lambda: _lag_drift(log, most))


def _lag_drift(log: Log, most: float) -> float:
    from scipy.stats import theilslopes  # which takes half a second to import

    duration = log.t[-1] - log.t[0]
    pieces = max(FEWEST_LAGS, round(duration / LAG_PIECE))
    ends = np.linspace(0, len(log.t), pieces + 1).round().astype(int)
    parts = [(i, j) for i, j in pairwise(ends) if j - i > 2]
    if len(parts) < FEWEST_LAGS:
        return 0.0
    turning = _turning(log)
    lags = [_turning_lag(turning.steps(slice(i, j - 1)), most * duration) for i, j in parts]
    line = theilslopes(lags, [log.t[i:j].mean() for i, j in parts])
    return float(line.slope) if line.low_slope * line.high_slope > 0.0 else 0.0
