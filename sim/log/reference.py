"""Original samples of a log's reference, with their own times.

A log holds one pose per row, interpolated between the samples of a slower reference: positions
linearly, attitudes at constant rate. Such a path bends at a row that is a sample, or at the two
rows beside one, where the lines before and behind meet. A path with a sample in every row bends at
every row, and its lines do not meet.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from surefoot.sim.common.quaternion import matrix_from_quaternion, quaternion_from_matrix
from surefoot.sim.log.log import Log

_KINK = 1e-6
"""Change of velocity between rows that is a kink [m/s]; rounding changes it by 1e-12."""


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

    They are the measured rows (`ref_ok`) unless at least half of the rows at which the path bends
    show a sample.
    """
    t, p, q = log.t, log.ref_p, log.ref_q
    slope = np.diff(p, axis=0) / np.diff(t)[:, None]
    bent = np.zeros(len(t) + 1, dtype=bool)  # of each row, and of none behind the last
    bent[1:-2] = np.linalg.norm(np.diff(slope, axis=0), axis=1) > _KINK
    single = np.flatnonzero(bent & ~np.roll(bent, 1) & ~np.roll(bent, -1))
    first = np.flatnonzero(bent & np.roll(bent, -1))
    before, behind = slope[first - 1], slope[first + 1]
    span, turn = t[first + 1] - t[first], behind - before
    off = behind * span[:, None] - (p[first + 1] - p[first])
    turned = np.sum(turn**2, axis=1)
    ahead = np.sum(off * turn, axis=1) / np.where(turned > 0.0, turned, np.inf)
    apart = np.linalg.norm(off - turn * ahead[:, None], axis=1)
    meet = (apart < _KINK * span) & (ahead > 0.0) & (ahead < span)
    # Where a smooth path has a sample a row, the lines meet between any two.
    beside = np.flatnonzero(np.diff(first[meet]) == 1)
    meet[np.flatnonzero(meet)[np.union1d(beside, beside + 1)]] = False
    if len(single) + 2 * meet.sum() < max(3, 0.5 * bent.sum()):
        return Poses(t[log.ref_ok], p[log.ref_ok], q[log.ref_ok])
    rows = np.concatenate([single, first[meet]])
    order = np.argsort(rows)
    rows, ahead = rows[order], np.concatenate([np.zeros(len(single)), ahead[meet]])[order]
    earlier, R = (Rotation.from_quat(q[at], scalar_first=True) for at in (rows - 1, rows))
    rate = (earlier.inv() * R).as_rotvec() / (t[rows] - t[rows - 1])[:, None]
    then = R * Rotation.from_rotvec(rate * ahead[:, None])
    found = p[rows] + slope[rows - 1] * ahead[:, None]
    return Poses(t[rows] + ahead, found, quaternion_from_matrix(then.as_matrix()))
