"""Original samples of a log's reference, with their own times.

A log holds one pose per row, interpolated between the samples of a slower reference: positions
linearly, attitudes at constant rate. Such a path has kinks at the samples, from which these are
recovered.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from surefoot.sim.common.quaternion import matrix_from_quaternion, quaternion_from_matrix
from surefoot.sim.log.log import Log

_KINK = 1e-6
"""Change of velocity between rows that is a kink [m/s]; rounding changes it by 1e-12."""
_KINK_ROWS = 10
"""Consecutive rows with a kink from which every row is a sample; a slower reference has a kink at
two rows per sample, and is straight between. At rest, neither has kinks.
"""


@dataclass(frozen=True)
class Poses:
    """Samples of a reference: t (K,) [s], increasing; p (K, 3) [m]; q (K, 4) as w, x, y, z."""

    t: np.ndarray
    p: np.ndarray
    q: np.ndarray

    @property
    def R(self) -> np.ndarray:
        """Attitudes (K, 3, 3)."""
        return matrix_from_quaternion(self.q)

    def rows(self, which: slice | np.ndarray) -> "Poses":
        """Select rows by a slice, a mask (K,) or indices."""
        return Poses(self.t[which], self.p[which], self.q[which])


def reference_poses(log: Log) -> Poses:
    """Recover the samples of a log's reference. Raises LogError where it has none.

    If the path has fewer than three kinks, or most are in runs of more than _KINK_ROWS rows, the
    samples are the measured rows (`ref_ok`).
    """
    t, p, q = log.t, log.ref_p, log.ref_q
    slope = np.diff(p, axis=0) / np.diff(t)[:, None]
    bent = 1 + np.flatnonzero(np.linalg.norm(np.diff(slope, axis=0), axis=1) > _KINK)
    groups = np.split(bent, np.flatnonzero(np.diff(bent) > 1) + 1)
    in_runs = sum(len(one) for one in groups if len(one) > _KINK_ROWS)
    if len(bent) < 3 or in_runs > 0.5 * len(bent):
        ok = log.ref_ok
        return Poses(t[ok], p[ok], q[ok])
    first = np.array([one[0] for one in groups])
    last = np.array([one[-1] for one in groups])
    # The lines before the first and after the last kink intersect at the sample; several samples
    # within one run of kinks are too close to be separated, and count as one.
    before, behind = slope[first - 1], slope[last]
    apart, turn = p[last] - p[first], behind - before
    span = t[last] - t[first]
    turned = np.sum(turn**2, axis=1)
    bent_by = np.where(turned > 0.0, turned, np.inf)  # a leap aside bends back to where it was
    along = np.sum((behind * span[:, None] - apart) * turn, axis=1) / bent_by
    at = t[first] + np.clip(along, 0.0, span)
    ahead = (at - t[first])[:, None]
    earlier, R = (Rotation.from_quat(q[rows], scalar_first=True) for rows in (first - 1, first))
    rate = (earlier.inv() * R).as_rotvec() / (t[first] - t[first - 1])[:, None]
    then = R * Rotation.from_rotvec(rate * ahead)
    return Poses(at, p[first] + before * ahead, quaternion_from_matrix(then.as_matrix()))
