"""Convolution and first-order recursion against those of scipy; level of noise."""

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
from scipy.signal import fftconvolve, lfilter

from surefoot.sim.common.series import convolve, recursion, white_noise


def test_a_convolution_is_that_of_scipy():
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=300), rng.normal(size=211)
    assert_allclose(convolve(a, b), fftconvolve(a, b), rtol=0.0, atol=1e-12)


def test_a_recursion_in_two_pieces_is_that_of_scipy():
    x = np.random.default_rng(0).normal(size=(50, 3))
    expected = lfilter([0.3], [1.0, -0.7], x, axis=0)
    first, state = recursion(x[:20], 0.3, 0.7, np.zeros(3))
    second, _ = recursion(x[20:], 0.3, 0.7, state)
    assert_array_equal(np.concatenate([first, second]), expected)


def test_white_noise_is_told_from_slow_motion():
    rng = np.random.default_rng(7)
    t = np.arange(20_000) / 500.0
    noise = rng.normal(0.0, [0.01, 0.2], (len(t), 2))
    found = white_noise(np.sin(2.0 * t)[:, None] + noise)
    assert_allclose(found, [0.01, 0.2], rtol=0.03)
