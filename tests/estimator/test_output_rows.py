"""Rows of a log whose estimates are stored."""

import numpy as np
import pytest

from surefoot.estimator.run import bounded_velocities, every_row, output_stride
from surefoot.sim.common.errors import SurefootError


@pytest.mark.parametrize(("rate", "stride"), [(100, 1), (400, 4), (500, 5), (50, 1)])
def test_estimates_are_stored_at_100_hz_or_the_rate_of_the_log(rate, stride):
    t = np.arange(50) / rate
    assert output_stride(t) == stride
    np.testing.assert_array_equal(every_row(t), np.arange(0, 50, stride))


def test_a_piece_of_one_row_is_stored():
    np.testing.assert_array_equal(every_row(np.array([0.5])), [0])


@pytest.mark.parametrize("bounds", [np.array([0.1, 0.0, 0.1]), np.array([[0.1, 0.1, -0.1]])])
def test_bounds_of_velocities_are_above_zero(bounds):
    with pytest.raises(SurefootError, match="epsilon: every bound must be > 0"):
        bounded_velocities([1], np.zeros((1, 3)), bounds, 2)
