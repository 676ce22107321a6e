"""First guess of the clock offset and rotation of a reference, from the angular rates of both.

The norm of the angular rate does not depend on the axes, so its correlation over all offsets gives
the clock offset to a sample. Walking is periodic, so the correlation has a peak at every stride.
For each, the rates are rotated by the best rotation (Kabsch, Acta Crystallographica A 32, 1976),
and the peaks with the smallest differences are kept.
"""

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.signal import fftconvolve
from scipy.spatial.transform import Rotation

from surefoot.models.alignment.least_squares import Placement
from surefoot.sim.common.series import interpolate_rows
from surefoot.sim.importing.streams import with_short_gaps
from surefoot.sim.log.reference import Poses

_STEP = 0.005
"""Step between the offsets tried [s]: a fraction of a sample of motion capture."""
_SMOOTH = 0.06
"""Averaging time of the rates [s]; a lost sample or a stamp off by a frame then hardly matters."""
LEAST_OVERLAP = 3.0
"""Least common time of IMU and reference [s]: some strides."""
_PEAKS = 200
"""Number of peaks whose rates are compared: the strides within a hundred seconds."""
_GUESSES = 8
"""Largest number of guesses: strides around the right one whose rates may be as good by chance."""
_AS_GOOD = 4.0
"""Ratio to the least share of rotation missed up to which an offset may be the right one."""


def guesses_from_rotation(
    t: np.ndarray, gyro: np.ndarray, poses: Poses, most: float
) -> list[Placement]:
    """The best guesses of clock offset, rotation and gyro bias, the best first, with an offset
    within +-`most` [s]; none if IMU and reference have too little time in common.

    t (N,) [s] and gyro (N, 3) [rad/s] are those of the IMU.
    """
    middle, rates = rates_of(poses)
    # A tracker that confuses bodies or flips an attitude for some frames gives impossible rates.
    fastest = 1.5 * np.linalg.norm(gyro, axis=1).max()
    size = np.maximum(np.linalg.norm(rates, axis=1), 1e-12)
    rates = rates * np.minimum(1.0, fastest / size)[:, None]
    # An offset up to half of the longest gap that both keep moves nothing across it.
    both = np.union1d(t, middle)
    short = with_short_gaps(both, 2.0 * (most + LEAST_OVERLAP))
    t, middle = (short[np.searchsorted(both, one)] for one in (t, middle))
    here, there = (np.arange(x[0], x[-1], _STEP) for x in (t, middle))
    a, b = smoothed(here, t, gyro), smoothed(there, middle, rates)
    shift = there[0] - here[0]
    scores = _correlations(np.linalg.norm(a, axis=1), np.linalg.norm(b, axis=1))
    lags = _STEP * (np.arange(len(scores)) - len(b) + 1) - shift
    scores = np.where(np.abs(lags) <= most + _STEP, scores, -np.inf)
    peak = np.flatnonzero((scores[1:-1] >= scores[:-2]) & (scores[1:-1] > scores[2:])) + 1
    peak = peak[np.isfinite(scores[peak])]
    best = peak[np.argsort(-scores[peak], kind="stable")[:_PEAKS]]

    def guessed(offsets: np.ndarray) -> list[tuple[float, Placement]]:
        """The guesses at these offsets, the one with the least missing first."""
        tried = [_guess_at_offset(here, a, there, b, float(x)) for x in offsets]
        return sorted((one for one in tried if one), key=lambda one: one[0])

    near = _STEP * np.arange(-6, 7)
    coarse = guessed(lags[best])[:_GUESSES]
    fine = sorted((guessed(one.offset + near)[0] for _, one in coarse), key=lambda one: one[0])
    return [placement for missed, placement in fine if missed < _AS_GOOD * fine[0][0]]


def rates_of(poses: Poses) -> tuple[np.ndarray, np.ndarray]:
    """Angular rates (K - 1, 3) [rad/s] of the tracked body, in its own frame, and their times
    (K - 1,), midway between the poses.
    """
    R = Rotation.from_quat(poses.q, scalar_first=True)
    rates = (R[:-1].inv() * R[1:]).as_rotvec() / np.diff(poses.t)[:, None]
    return 0.5 * (poses.t[1:] + poses.t[:-1]), rates


def smoothed(at: np.ndarray, t: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """Means (M, 3) of rates (K, 3), given at t (K,), over _SMOOTH seconds about the times `at`."""
    turned = cumulative_trapezoid(rates, t, axis=0, initial=0.0)
    low, high = np.clip(at - _SMOOTH / 2, t[0], t[-1]), np.clip(at + _SMOOTH / 2, t[0], t[-1])
    change = [np.interp(high, t, x) - np.interp(low, t, x) for x in turned.T]
    span = np.where(high > low, high - low, np.nan)  # none where nothing was measured
    return np.column_stack(change) / span[:, None]


def _correlations(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Correlation of a (A,) with b (B,) over their overlap at each shift (A + B - 1,); minus
    infinity where the overlap is shorter than LEAST_OVERLAP.
    """
    back, one_a, one_b = b[::-1], np.ones_like(a), np.ones_like(b)
    count = np.round(fftconvolve(one_a, one_b))
    sum_a, sum_b = fftconvolve(a, one_b), fftconvolve(one_a, back)
    both = fftconvolve(a, back) - sum_a * sum_b / count
    var_a = fftconvolve(a**2, one_b) - sum_a**2 / count
    var_b = fftconvolve(one_a, back**2) - sum_b**2 / count
    size = np.sqrt(np.maximum(var_a * var_b, 1e-18))
    return np.where(count * _STEP >= LEAST_OVERLAP, both / size, -np.inf)


def _guess_at_offset(
    here: np.ndarray, a: np.ndarray, there: np.ndarray, b: np.ndarray, offset: float
) -> tuple[float, Placement] | None:
    """The best rotation from rates b, at the times `there` plus `offset`, to rates a at `here`,
    after the share of the gyro's rotation that the reference does not have with it, at the upper
    end of its interval: few seconds agree by chance.

    Args:
        here: (A,) times of the IMU [s].
        a: (A, 3) its rates.
        there: (B,) times of the reference [s].
        b: (B, 3) its rates.
        offset: to add to these times [s].
    """
    inside = (here - offset >= there[0]) & (here - offset <= there[-1])
    if _STEP * inside.sum() < LEAST_OVERLAP:
        return None
    a = a[inside]
    b = interpolate_rows(here[inside] - offset, there, b)
    mean_a, mean_b = a.mean(axis=0), b.mean(axis=0)
    a, b = a - mean_a, b - mean_b
    U, _, Vt = np.linalg.svd(a.T @ b)
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    turned = np.sum(a**2)
    if turned == 0.0:
        return None
    missed, zero = float(np.sum((a - b @ R.T) ** 2) / turned), np.zeros(3)
    missed *= np.exp(2.0 / np.sqrt(_STEP * len(a)))
    return missed, Placement(float(offset), R, mean_a - R @ mean_b, zero, zero, zero[:2])
