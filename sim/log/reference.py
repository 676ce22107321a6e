"""A reference as it was sampled: its own times and poses, not those of a log's rows.

A log holds a pose a row, interpolated between the samples of a slower reference: positions along
straight lines, attitudes at even rates. Such a path bends at the samples, so that they are found
again.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from surefoot.sim.common.quaternion import matrix_from_quaternion, quaternion_from_matrix
from surefoot.sim.log.log import Log

_BEND = 1e-6
"""m/s by which a velocity changes from row to row where two straight lines meet: rounding changes
it by 1e-12."""
_RUN = 10
"""Consecutive rows at which a path bends only if it has a sample a row: that of a slower reference
bends at two rows a sample, and is straight between. At rest neither bends."""


@dataclass(frozen=True)
class Poses:
    """Samples of a reference: t (K,) [s], rising; p (K, 3) [m]; q (K, 4) as w, x, y, z."""

    t: np.ndarray
    p: np.ndarray
    q: np.ndarray

    @property
    def R(self) -> np.ndarray:
        """Attitudes (K, 3, 3)."""
        return matrix_from_quaternion(self.q)

    def rows(self, which: slice | np.ndarray) -> "Poses":
        """Those of a slice, of a mask (K,) or of indices."""
        return Poses(self.t[which], self.p[which], self.q[which])


def reference_poses(log: Log) -> Poses:
    """The samples of a log's reference. Raises LogError where it has none.

    Where the path bends at hardly any row, or mostly in runs of more than _RUN rows, the samples
    are the rows that were measured (`ref_ok`).
    """
    t, p, q = log.t, log.ref_p, log.ref_q
    slope = np.diff(p, axis=0) / np.diff(t)[:, None]
    bent = 1 + np.flatnonzero(np.linalg.norm(np.diff(slope, axis=0), axis=1) > _BEND)
    groups = np.split(bent, np.flatnonzero(np.diff(bent) > 1) + 1)
    in_runs = sum(len(one) for one in groups if len(one) > _RUN)
    if len(bent) < 3 or in_runs > 0.5 * len(bent):
        ok = log.ref_ok
        return Poses(t[ok], p[ok], q[ok])
    first = np.array([one[0] for one in groups])
    last = np.array([one[-1] for one in groups])
    # The line before the first bend and the line behind the last meet at the sample; where several
    # samples share a bend they are too close to be told apart, and stand for one.
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
