"""Residuals over whole stances: mean velocity, and displacement of the foot.

The samples of a stance are correlated, and dominated by touchdown and lift-off. What leg odometry
accumulates is their mean, and the displacement of the foot over the ground while its contact is on.
"""

import numpy as np
from scipy.ndimage import maximum_filter1d

from surefoot.models.residuals.binning import BIN, ReferenceMotion, at_rows
from surefoot.sim.log import Log
from surefoot.sim.robot.feet import Feet
from surefoot.sim.sensors.stances import stances

FEWEST_STANCE_BINS = 3
"""Minimum number of bins inside a stance for a mean."""
SHORTEST_CONTACT = 0.1
"""Shortest contact that counts as a step [s]."""


def stance_means(t: np.ndarray, values: np.ndarray, there: np.ndarray) -> np.ndarray:
    """Means over stances of values (M, L, K), in the middle bin of each; NaN in all other bins.

    t: (M,) [s], of the bins; there: (M, L) bins inside a stance, which are contiguous.
    """
    means = np.full(values.shape, np.nan)
    for leg in range(values.shape[1]):
        rows = np.flatnonzero(there[:, leg])
        if not len(rows):
            continue
        first = np.flatnonzero(np.diff(t[rows], prepend=-np.inf) > 1.5 * BIN)
        count = np.diff(np.append(first, len(rows)))
        mean = np.add.reduceat(values[rows, leg], first, axis=0) / count[:, None]
        whole = count >= FEWEST_STANCE_BINS
        means[rows[(first + count // 2)[whole]], leg] = mean[whole]
    return means


def stance_displacement(
    log: Log, feet: Feet, motion: ReferenceMotion, liftoff_late: float = 0.0
) -> np.ndarray:
    """Displacement (M, 2 L) [m] of each foot over the ground during each of its contacts.

    From the leg's kinematics and the reference, along the forward and lateral axes of the heading,
    and negated, so that it is the distance by which leg odometry moves the body too far. Values are
    in the middle bin of each contact. Contacts are shortened to the time in which the foot does not
    move, and by the delay of lift-offs that the model declares [s].
    """
    omega = at_rows(log.gyro if log.has("imu") else motion.gyro)
    # One more row on either side, for contacts that the model delays by a part of a row.
    around = maximum_filter1d(log.contact, 3, axis=0) & motion.ok[:, None]
    v_I = feet.imu_velocity(*feet.readings(log), omega, motion.normal_I, around)
    ahead = motion.R_GI[:, :2, 0]
    ahead = ahead / np.linalg.norm(ahead, axis=1, keepdims=True)
    # The heading's axes, level in G, expressed in I.
    axes_I = np.stack([ahead, ahead[:, ::-1] * [-1.0, 1.0]], axis=1) @ motion.R_GI[:, :2]
    forward, lateral = np.moveaxis((v_I - motion.v_I[:, None]) @ np.swapaxes(axes_I, 1, 2), 2, 0)
    half = 0.5 * np.gradient(log.t)
    edges = np.append(log.t - half, log.t[-1] + half[-1])
    moved = np.nan_to_num(np.stack([forward, lateral], axis=2)) * (2 * half)[:, None, None]
    path, lost = _sums(moved), _sums(~motion.ok)
    out = np.full((len(motion.first), *around.shape[1:], 2), np.nan)
    for leg in range(around.shape[1]):
        first, end = stances(log.contact[:, leg])
        begin = edges[first] + motion.early
        until = edges[end] - liftoff_late - motion.late
        use = (until - begin > SHORTEST_CONTACT) & (lost[end] == lost[first])
        use &= (first > 0) & (end < len(log.t))
        bins = np.searchsorted(motion.first, (first + end) // 2, side="right") - 1
        for axis in range(2):
            far = np.interp(until, edges, path[:, leg, axis])
            far -= np.interp(begin, edges, path[:, leg, axis])
            out[bins[use], leg, axis] = far[use]
    return out.reshape(len(out), -1)


def _sums(x: np.ndarray) -> np.ndarray:
    """Cumulative sums (N + 1, ...) of the rows of x (N, ...), at the edges between rows."""
    return np.concatenate([np.zeros_like(x[:1], dtype=float), np.cumsum(x, axis=0)])
