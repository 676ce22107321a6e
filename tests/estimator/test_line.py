"""What a box is made of: moments of a Gaussian on an interval, and of far corners, axis by axis."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import quad
from scipy.optimize import minimize_scalar
from scipy.special import erf

from surefoot.estimator.box import _centre, _corner, box_moments
from surefoot.estimator.moments.faces import Rectangle
from surefoot.estimator.moments.line import (
    About,
    Conditional2,
    _fall,
    _window,
    line_moments,
    plane_moments,
)
from surefoot.estimator.moments.quadrature import MOST, NODES, WEIGHTS, rule


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


def test_the_table_holds_the_gauss_rules_of_2_to_64_points():
    """Each integrates x^k on [0, 1] to 1 / (k + 1) up to its degree, and nothing follows them."""
    at = 0
    for n in range(2, MOST + 1, 2):
        nodes, weights = NODES[at : at + n], WEIGHTS[at : at + n]
        for k in (0, 1, n, 2 * n - 1):
            assert_allclose(weights @ nodes**k, 1.0 / (k + 1), rtol=1e-12)
        at += n
    assert len(NODES) == len(WEIGHTS) == at


@pytest.mark.parametrize("half", [1.0, 11.0, 13.0, 30.0, 100.0])
def test_a_piece_of_any_length_holds_the_normal_density(half):
    pieces, count, at = rule(2.0 * half, 1.0, 0.5 * half**2)
    step, total = 2.0 * half / pieces, 0.0
    for piece in range(pieces):
        x = -half + step * (piece + NODES[at : at + count])
        total += step * WEIGHTS[at : at + count] @ np.exp(-0.5 * x * x)
    assert_allclose(total, np.sqrt(2.0 * np.pi) * erf(half / np.sqrt(2.0)), rtol=1e-10)


@pytest.mark.parametrize(("slope", "low", "high"), [(0.5, -0.4, 1.1), (-2.0, 0.7, 2.5)])
def test_a_plane_bounded_along_its_second_axis_only(slope, low, high):
    """All moments 1, x, y, xx, xy, yy by a fine grid over the plane."""
    m1, m2, s1, s2 = 0.2, -0.1, 0.9, 0.6
    c1, c2 = 0.3, low
    out = np.empty(6)
    about = About(c1, c2, m1, 0.0, 28.0)
    plane = Rectangle(-np.inf, np.inf, low, high)
    plane_moments(Conditional2(m1, m2, s1, slope, s2), plane, about, out)
    nodes, weights = np.polynomial.legendre.leggauss(100)
    x, y = (m1 + 9.0 * s1 * nodes)[:, None], 0.5 * (low + high) + 0.5 * (high - low) * nodes
    off = (y - m2 - slope * (x - m1)) / s2
    density = np.exp(-0.5 * (((x - m1) / s1) ** 2 + off**2))
    density *= 9.0 * s1 * weights[:, None] * (0.5 * (high - low) * weights)
    x, y = x - c1, y - c2
    wanted = [(density * f).sum() for f in (1.0, x, y, x * x, x * y, y * y)]
    assert_allclose(out, wanted, rtol=1e-8)


def test_a_window_ends_where_the_density_has_fallen_by_its_depth():
    rng = np.random.default_rng(2)
    for _ in range(200):
        m1, m2, slope = rng.normal(size=3) * [3.0, 1.0, 2.0]
        s1, s2, width = rng.uniform(0.1, 2.0, size=3)
        l2 = rng.normal()
        plane = m1, m2, s1, slope, s2, l2, l2 + width
        best = minimize_scalar(
            lambda x, plane=plane: _fall(x, *plane), (m1 - s1, m1 + s1), options={"xtol": 1e-12}
        )
        left, right = _window(*plane, best.x, 28.0)
        assert left < best.x < right
        assert_allclose([_fall(x, *plane) - best.fun for x in (left, right)], 28.0, rtol=1e-6)
