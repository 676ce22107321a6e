"""What a box is made of: moments of a Gaussian on an interval, and of far corners, axis by axis."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import quad

from surefoot.estimator.box import _centre, _corner, box_moments
from surefoot.estimator.moments.line import line_moments


@pytest.mark.parametrize(
    ("a", "b"),
    [
        (-1.0, 2.0), (-0.02, 0.03), (0.5, 0.52), (0.4, 3.0), (3.0, 3.5), (3.0, 40.0), (20.0, 20.3),
        (20.0, 21.5), (-6.0, -2.0), (-20.5, -20.0), (-9.0, 0.5), (2.0, np.inf), (-np.inf, np.inf),
    ],
)  # fmt: skip
def test_moments_on_an_interval_are_those_of_quadrature(a, b):
    shift, *found, origin = line_moments(a, b)
    end = np.clip([a, b], -45.0, 45.0)

    def density(x, n):
        return np.exp(shift - 0.5 * x * x) * (x - origin) ** n

    # Where the density is, so that no narrow peak is missed.
    peak = np.clip(0.0, *end)
    width = min(40.0 / max(1.0, abs(peak)), 10.0)
    low, high = max(end[0], peak - width), min(end[1], peak + width)
    wanted = [quad(density, low, high, args=(n,), epsabs=1e-14, limit=200)[0] for n in range(3)]
    assert_allclose(found, wanted, rtol=1e-9, atol=1e-10)


def test_a_corner_of_independent_axes_is_exact():
    low, high = np.array([0.5, 1.0, -1.0]), np.array([2.0, 3.0, 1.5])
    mode, sums = np.clip(0.0, low, high), np.zeros(10)
    log_prob = _corner(np.eye(3), low, high, mode, float(mode @ mode), sums) + np.log(sums[0])
    mean, cov = np.empty(3), np.empty((3, 3))
    _centre(sums, mode, mean, cov)
    wanted = box_moments(np.zeros(3), np.eye(3), low, high)
    assert_allclose(log_prob, wanted[0], rtol=1e-9)
    assert_allclose(mean, wanted[1], rtol=1e-9)
    assert_allclose(cov, wanted[2], atol=1e-9)
