"""The columns of a reference, of its attitudes, positions and velocities."""

import numpy as np

from surefoot.sim.common.quaternion import quaternion_from_matrix
from surefoot.sim.log.schema import named_columns


def reference_columns(R: np.ndarray, p: np.ndarray, v: np.ndarray) -> dict[str, np.ndarray]:
    """Of R (N, 3, 3), p (N, 3) [m] and v (N, 3) [m/s]."""
    q = named_columns("ref_q", quaternion_from_matrix(R), "wxyz")
    return named_columns("ref_p", p) | q | named_columns("ref_v", v)
