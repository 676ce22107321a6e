"""Convolution of long series."""

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft


def convolve(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Convolution (A + B - 1,) of a (A,) with b (B,), by FFT.

    As `scipy.signal.fftconvolve`, whose package takes half a second to import.
    """
    size = len(a) + len(b) - 1
    fast = next_fast_len(size, real=True)
    product = np.asarray(rfft(a, fast)) * np.asarray(rfft(b, fast))
    return np.asarray(irfft(product, fast))[:size]
