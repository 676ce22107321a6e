"""An oracle for the kernels of `sim.sensors.streams`: the same integral as a series."""

import numpy as np


def mean_rotation(turn: np.ndarray) -> np.ndarray:
    """Mean of exp(s turn) over s in (0, 1), (N, 3, 3): Gamma_1 of Hartley et al. 2020, a series.

    Steps turn by far less than a radian, so a few terms reach machine precision.
    """
    W = np.zeros((len(turn), 3, 3))
    W[:, 0, 1], W[:, 0, 2], W[:, 1, 2] = -turn[:, 2], turn[:, 1], -turn[:, 0]
    W -= np.swapaxes(W, 1, 2)
    term = np.broadcast_to(np.eye(3), W.shape)
    total = term.copy()
    for k in range(2, 14):
        term = term @ W / k
        total = total + term
    return total
