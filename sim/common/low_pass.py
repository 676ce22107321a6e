"""The first-order low-pass of sensors."""

import numpy as np
from scipy.signal import lfilter


def low_pass(x: np.ndarray, time: float, rate: float) -> np.ndarray:
    """x (N, K), `rate` samples a second, behind a first-order low-pass of time constant `time` [s],
    at rest on its first sample."""
    return low_pass_from(None, x, time, rate)[0] if time > 0.0 else x


def low_pass_from(
    state: np.ndarray | None, x: np.ndarray, time: float, rate: float
) -> tuple[np.ndarray, np.ndarray]:
    """`low_pass` of a piece of the readings, and its state at the end.

    Args:
        state: at the end of the piece before; None at the first one.
        x: (N, K) readings.
        time: the low-pass's time constant [s], above zero.
        rate: samples a second [Hz].
    """
    keep = np.exp(-1.0 / (time * rate))
    return lfilter(
        [1.0 - keep], [1.0, -keep], x, axis=0, zi=keep * x[:1] if state is None else state
    )
