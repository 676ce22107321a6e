"""Level of the white noise in readings."""

import numpy as np


def white_noise(x: np.ndarray) -> np.ndarray:
    """Standard deviation (...,) of the white noise of readings x (N, ...), N >= 3.

    The second difference has six times the variance of the noise, and little of the motion.
    """
    return np.std(np.diff(x, n=2, axis=0), axis=0) / np.sqrt(6.0)
