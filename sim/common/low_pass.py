"""The first-order low-pass of sensors."""

import numpy as np
from scipy.signal import lfilter


def low_pass(x: np.ndarray, time: float, rate: float) -> np.ndarray:
    """x (N, K), `rate` samples a second, behind a first-order low-pass of time constant `time` [s],
    at rest on its first sample."""
    if time <= 0.0:
        return x
    keep = np.exp(-1.0 / (time * rate))
    return lfilter([1.0 - keep], [1.0, -keep], x, axis=0, zi=keep * x[:1])[0]
