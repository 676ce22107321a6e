"""Velocity of the body and height of the ground from the kinematics of each standing foot.

The samples of a stance are correlated, and dominated by touchdown and lift-off. What leg odometry
accumulates is their mean, and the displacement of the foot over the ground while its contact is on.
"""

import numpy as np
from scipy.ndimage import maximum_filter1d

from surefoot.models.residuals.binning import BIN, Bins, ReferenceMotion, at_rows
from surefoot.sim.common.series import interpolate_rows
from surefoot.sim.log import Log
from surefoot.sim.robot.feet import Feet
from surefoot.sim.sensors.stances import stances

FEWEST_STANCE_BINS = 3
"""Minimum number of bins inside a stance for a mean."""
SHORTEST_CONTACT = 0.1
"""Shortest contact that counts as a step [s]."""
NEAR_FOOTHOLDS = 0.4
"""Distance at which footholds still tell the ground's slope [m], as a standard deviation."""
LEVEL = 0.006
"""Standard deviation of the heights of feet on level ground, at most [m]."""
HALFWAY = 0.5
"""Height of the contact point above the sole of a foot in soft ground, as a share of its depth."""


def leg_velocities(bins: Bins, feet: Feet) -> np.ndarray:
    """Velocity of the body by each standing foot minus the reference's, (M, 3 legs) [m/s] in I."""
    v = feet.imu_velocity(*bins.feet, bins.omega, bins.normal_I, bins.standing)
    v -= bins.v_I[:, None]
    if bins.depth is not None and bins.v_sole is not None:
        spin = bins.omega[:, None] + feet.rates_I(*bins.feet)
        rise = HALFWAY * bins.depth[:, :, None] * bins.normal_I[:, None]
        v += bins.v_sole - np.cross(spin, rise)
    return v.reshape(len(v), -1)


def travel_regressors(bins: Bins, feet: Feet) -> list[np.ndarray]:
    """Regressors (M, 3 L) [m/s] of leg velocities in which each point foot moves over the ground by
    a share of its way relative to the body, forwards and sideways.

    A foot of unknown size that rolls under a leg does so, and one that creeps with it. NaN where no
    foot stands.
    """
    v_I = feet.imu_velocity(*bins.feet, bins.omega, bins.normal_I, bins.standing)
    regressors = []
    for leg in range(v_I.shape[1]):
        for axis in range(2):
            share = np.where(bins.standing[..., None], np.zeros_like(v_I), np.nan)
            share[:, leg, axis] = v_I[:, leg, axis]
            regressors.append(share.reshape(len(v_I), -1))
    return regressors


def between_feet(v: np.ndarray) -> np.ndarray:
    """Contrasts between the velocities of the body by L feet (M, 3 L), independent of its own.

    NaN marks feet that do not stand. Helmert contrasts: each standing foot minus the mean of those
    before it, scaled to the noise of one foot, so that white noise stays white. The first is NaN.
    """
    by_leg = v.reshape(len(v), -1, 3)
    there = np.isfinite(by_leg)
    before = np.cumsum(there, axis=1) - there
    standing = np.where(there, by_leg, 0.0)
    mean = (np.cumsum(standing, axis=1) - standing) / np.maximum(before, 1)
    against = np.sqrt(before / (before + 1.0)) * (by_leg - mean)
    return np.where(before > 0, against, np.nan).reshape(v.shape)


def foot_heights(bins: Bins, feet: Feet) -> np.ndarray:
    """Height (M, legs) [m] of each standing foot's sole in the world."""
    z = feet.heights(bins.feet[0], bins.p_GI, bins.R_GI[:, 2], bins.standing)
    return z if bins.depth is None else z + bins.depth


def footholds(bins: Bins, feet: Feet) -> tuple[np.ndarray, np.ndarray]:
    """Mean place (K, 3) [m] of each foot in the world in each of its stances, and its leg (K,)."""
    place, up = bins.feet[0], bins.R_GI
    along = [
        feet.heights(place, np.roll(bins.p_GI, 2 - a, axis=1), up[:, a], bins.standing)
        for a in range(3)
    ]
    points = np.stack(along, axis=2)
    means = stance_means(bins.t, points, np.isfinite(points[..., 0]))
    leg, row = np.nonzero(np.isfinite(means[..., 0]).T)
    return means[row, leg], leg


def ground_normals(holds: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Normals (M, 3) in the world of the planes through the footholds (K, 3) around places (M, 3)
    [m].
    """
    normals = np.tile([0.0, 0.0, 1.0], (len(places), 1))
    for k, place in enumerate(places):
        _, *tilt = _plane_at(place, holds, np.ones(len(holds), dtype=bool))
        if np.isfinite(tilt).all():
            normals[k] = np.array([-tilt[0], -tilt[1], 1.0]) / np.sqrt(1.0 + np.dot(tilt, tilt))
    return normals


def unevenness(holds: np.ndarray, leg: np.ndarray) -> float:
    """Standard deviation [m] of the heights of most footholds about the plane through those around
    each, beyond a constant for each leg.

    From the median deviation: the edges of a staircase or a slope are no rough ground.

    Args:
        holds: (K, 3) [m] in the world.
        leg: (K,) of each.
    """
    others = ~np.eye(len(holds), dtype=bool)
    height = [_plane_at(one, holds, use)[0] for one, use in zip(holds, others, strict=True)]
    above = holds[:, 2] - np.array(height)
    there = np.isfinite(above)
    if not there.any():
        return 0.0
    for one in np.unique(leg[there]):
        above[leg == one] -= np.nanmedian(above[leg == one])
    return float(1.4826 * np.nanmedian(np.abs(above)))


def _plane_at(place: np.ndarray, holds: np.ndarray, use: np.ndarray) -> np.ndarray:
    """Height [m] at a place, and slopes along x and y, of the plane through the footholds around
    it; NaN where there are too few.

    Args:
        place: (3,) [m].
        holds: (K, 3) [m].
        use: mask (K,) of the footholds.
    """
    away = holds[:, :2] - place[:2]
    weight = np.exp(-0.5 * np.sum(away**2, axis=1) / NEAR_FOOTHOLDS**2)
    near = use & (weight > 0.01)
    if np.count_nonzero(near) < 4:
        return np.full(3, np.nan)
    root = np.sqrt(weight[near])
    A = np.column_stack([np.ones(len(root)), away[near]]) * root[:, None]
    above = np.linalg.lstsq(A, (holds[near, 2] - place[2]) * root, rcond=1e-3)[0]
    return above + np.array([place[2], 0.0, 0.0])


def level_ground(bins: Bins, feet: Feet) -> bool:
    """Whether the feet stand on one plane.

    True if heights vary by less than LEVEL about a plane through all feet plus a constant
    for each leg.
    """
    z = foot_heights(bins, feet)
    rows, legs = np.nonzero(np.isfinite(z))
    if len(rows) < 100:
        return False
    A = np.hstack([np.eye(z.shape[1])[legs], bins.p_GI[rows, :2]])
    left = z[rows, legs]
    for _ in range(3):
        fit = np.linalg.lstsq(A, z[rows, legs], rcond=1e-10)[0]
        left = np.abs(z[rows, legs] - A @ fit)
        keep = left <= 4 * np.median(left) + 1e-4
        rows, legs, A = rows[keep], legs[keep], A[keep]
    return bool(1.4826 * np.median(left) < LEVEL)


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
        far = interpolate_rows(until, edges, path[:, leg]) - interpolate_rows(
            begin, edges, path[:, leg]
        )
        out[bins[use], leg] = far[use]
    return out.reshape(len(out), -1)


def _sums(x: np.ndarray) -> np.ndarray:
    """Cumulative sums (N + 1, ...) of the rows of x (N, ...), at the edges between rows."""
    return np.concatenate([np.zeros_like(x[:1], dtype=float), np.cumsum(x, axis=0)])
