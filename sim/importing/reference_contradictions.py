"""Samples of a reference that contradict the IMU: wrong stamps, or another body."""

import numpy as np

from surefoot.sim.importing.reference_noise import MOST_MISSED_ROTATION, matching_imu
from surefoot.sim.log.derived import derivative
from surefoot.sim.log.reference import Poses
from surefoot.sim.log.reference_vs_imu import ReferenceVsImu

_WINDOW = 0.1
"""Interval over which the reference's velocity is compared with the integrated accelerometer [s]: a
few samples of motion capture, short enough that bias and tilt change it by centimetres per second
only.
"""
_LEAST = 0.25
"""Least contradiction [m/s], 25 mm in the window: beyond the noise of a legged robot's reference.
"""
_OUTLYING = 8.0
"""Ratio to the usual change beyond which a change is not noise."""
_SURELY = 3.0
"""Standard deviations of what samples of the accelerometer may miss between them."""
_MOST = 0.05
"""Share of samples above which reference and IMU do not match at all: another clock, axes or
position, which `surefoot align` estimates.
"""
_SHORTEST = 1.0
"""Shortest section between two contradictions, or at an end, that is not marked with them [s]."""


def contradicted(t: np.ndarray, gyro: np.ndarray, accel: np.ndarray, poses: Poses) -> np.ndarray:
    """Mask (K,) of the samples around which the reference's velocity changes and the IMU's does
    not.

    All False where the reference as a whole does not match the IMU, or has too few samples.

    Args:
        t: (N,) of the IMU's rows [s].
        gyro: (N, 3) [rad/s], mean over the step before each row.
        accel: (N, 3) [m/s^2], likewise.
        poses: K, of the IMU frame.
    """
    found = np.zeros(len(poses.t), dtype=bool)
    known = np.flatnonzero((poses.t > t[1]) & (poses.t < t[-1]))
    beside = matching_imu(t, gyro, accel, poses.rows(known))
    if beside is None:
        return found
    dt = float(np.median(np.diff(t)))
    half = max(0.5 * _WINDOW, 2.0 * float(np.median(np.diff(beside.t))))
    v = derivative(beside.t, beside.path, 0.5 * _WINDOW, causal=False)
    before = np.searchsorted(beside.t, beside.t - half)
    after = np.searchsorted(beside.t, beside.t + half, side="right") - 1
    change = np.linalg.norm(v[after] - v[before], axis=1)
    # Samples of what shakes a body between the rows, in place of averages, change as much.
    bend = np.sum((accel[1:-1] - 0.5 * (accel[2:] + accel[:-2])) ** 2, axis=1) / 1.5
    summed = np.interp(beside.t[:, None] + [-half, half], t[1:-1], np.cumsum(bend * dt**2))
    sampled = _SURELY * np.sqrt(np.diff(summed, axis=1)[:, 0])
    bad = change > np.maximum(max(_LEAST, _OUTLYING * float(np.median(change))), sampled)
    if np.median(change) > _LEAST or not bad.any() or bad.mean() > _MOST:
        return found
    out = _closed(beside.t, bad)
    if out.mean() > 2.0 * _MOST or _missed_about_axes(beside, ~out) > MOST_MISSED_ROTATION:
        return found
    found[known] = out
    found[: known[0]] = found[known[0]]
    found[known[-1] + 1 :] = found[known[-1]]
    return found


def _missed_about_axes(beside: ReferenceVsImu, at: np.ndarray) -> float:
    """Share of the gyro's rotation that the reference does not have at samples of a mask (K,), the
    median of the three axes: a robot that turns on a wrong clock, or by other axes, still has most
    of its rotation about the vertical.
    """
    other = derivative(beside.t, beside.turn, _WINDOW, causal=False)
    other = np.einsum("kji,kj->ki", beside.R_GI, other)
    turning = np.maximum(np.var(beside.omega[at], axis=0), 1e-12)
    return float(np.median(np.var(other[at], axis=0) / turning))


def _closed(t: np.ndarray, bad: np.ndarray) -> np.ndarray:
    """The mask (K,), extended by good sections that are too short."""
    out = bad.copy()
    edges = np.flatnonzero(np.diff(bad.astype(int), prepend=1, append=1))
    for first, end in edges.reshape(-1, 2):
        if t[min(end, len(t) - 1)] - t[max(first - 1, 0)] < _SHORTEST:
            out[first:end] = True
    return out
