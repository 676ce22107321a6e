"""First-order Gauss-Markov noise."""

import numpy as np
from scipy.signal import lfilter


def gauss_markov(
    rng: np.random.Generator, n: int, sigma: float, time: float, rate: float
) -> np.ndarray:
    """A stationary first-order Gauss-Markov process (n, 3).

    Args:
        rng: random generator.
        n: rows.
        sigma: stationary standard deviation, in the unit of the result.
        time: correlation time [s].
        rate: rows a second [Hz].
    """
    keep = np.exp(-1.0 / (time * rate))
    drive = rng.normal(0.0, sigma * np.sqrt(1.0 - keep**2), (n, 3))
    drive[0] = rng.normal(0.0, sigma, 3)
    return np.asarray(lfilter([1.0], [1.0, -keep], drive, axis=0))
