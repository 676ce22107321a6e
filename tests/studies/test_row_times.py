"""A log's own clock, against rows whose times are known."""

import numpy as np
import pytest

from studies.hardware.row_times import row_times, two_heaps


def joints(seconds: float = 40.0, logger: float = 0.005, rate_scale: float = 1.0, seed: int = 0):
    """Six joints swinging, published every 2 ms, logged every `logger` s: the newest state wins."""
    rng = np.random.default_rng(seed)
    asked = np.arange(0.0, seconds, logger) + 0.0007
    t = 0.002 * np.floor(asked / 0.002)
    w, a, b = rng.uniform(8, 20, 6), rng.uniform(0.2, 0.5, 6), rng.uniform(0, 6, 6)
    q = a * np.sin(w * t[:, None] + b)
    dq = a * w * np.cos(w * t[:, None] + b)
    return t, 3e-5 * np.round(q / 3e-5), rate_scale * dq + rng.normal(0, 0.02, q.shape)


def test_rows_of_two_lengths_are_told_and_their_mean_found():
    t, q, dq = joints()
    found = row_times(q, dq, np.random.default_rng(1))
    np.testing.assert_allclose(found.period, np.diff(t).mean(), rtol=0.01)
    assert found.short == pytest.approx(0.004, rel=0.03)
    assert found.long == pytest.approx(0.006, rel=0.03)
    assert found.ratio_interval[0] - 0.02 < 1.5 < found.ratio_interval[1] + 0.02
    assert found.share == pytest.approx(np.mean(np.diff(t) < 0.005), abs=0.02)


def test_rates_that_read_too_much_shorten_the_rows_but_not_their_ratio():
    """So the ratio and the shares tell the time of a row where rates are not to be trusted."""
    t, q, dq = joints(rate_scale=1.14)
    found = row_times(q, dq, np.random.default_rng(1))
    np.testing.assert_allclose(found.period, np.diff(t).mean() / 1.14, rtol=0.01)
    assert found.ratio == pytest.approx(1.5, abs=0.02)
    assert 0.002 * (3.0 - found.share) == pytest.approx(np.diff(t).mean(), rel=0.01)


def test_two_heaps():
    assert two_heaps(np.array([1.0, 1.1, 0.9, 5.0, 5.2, 4.8])) == (1.0, 5.0)
