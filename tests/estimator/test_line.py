"""What a box is made of: moments on an interval, of far corners, and its outer parts."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import quad
from scipy.optimize import minimize, minimize_scalar
from scipy.special import erf, log_ndtr, logsumexp

from surefoot.estimator.box import _centre, _corner, box_moments
from surefoot.estimator.moments.line import (
    DEPTH,
    _fall,
    _window,
    line_moments,
    plane_moments,
)
from surefoot.estimator.moments.parts import _corner as _other_zone
from surefoot.estimator.moments.parts import outer_parts
from surefoot.estimator.moments.quadrature import NODES, WEIGHTS, rule


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
    about = c1, c2, m1, 0.0, 28.0
    plane = -np.inf, np.inf, low, high
    plane_moments((m1, m2, s1, slope, s2), plane, about, out)
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


INF = np.inf


FINE_NODES, FINE_WEIGHTS = np.polynomial.legendre.leggauss(300)


def parts(C, low, high):
    """Ends (P + 1,) and length scales (P,) of the parts of axis 0 between its bounds."""
    precision = np.linalg.inv(C)
    nearest = minimize(
        lambda z: z @ precision @ z,
        np.clip(0.0, low, high),
        jac=lambda z: 2.0 * precision @ z,
        bounds=list(zip(low, high, strict=True)),
    )
    cuts, scales = np.zeros(16), np.zeros(16)
    count = outer_parts(C, low, high, low[0], high[0], float(nearest.fun), cuts, scales)
    return cuts[: count + 1], scales[:count]


def log_between(low, high):
    """Logarithm of the standard normal probability of an interval, far from 0 as well."""
    swap = low + high > 0.0
    low, high = np.where(swap, -high, low), np.where(swap, -low, high)
    return log_ndtr(high) + np.log1p(-np.exp(np.minimum(log_ndtr(low) - log_ndtr(high), -1e-300)))


def log_integrand(C, low, high, x):
    """Log of the density (N,) at x of axis 0 with axes 1 and 2 in their intervals: axis 2 in closed
    form, axis 1 by 300 nodes where the integrand is not negligible."""
    gain = np.linalg.solve(C[:2, :2], C[:2, 2])
    deviation = np.sqrt(1.0 - C[:2, 2] @ gain)

    def at(y, x):
        middle = gain[0] * x + gain[1] * y
        inside = log_between((low[2] - middle) / deviation, (high[2] - middle) / deviation)
        return -0.5 * (y - C[0, 1] * x) ** 2 / (1.0 - C[0, 1] ** 2) + inside

    y = np.linspace(max(low[1], -50.0), min(high[1], 50.0), 1001)
    found = []
    for one in x:
        values = at(y, one)
        seen = np.flatnonzero(values > values.max() - 80.0)
        start, end = y[max(seen[0] - 1, 0)], y[min(seen[-1] + 1, len(y) - 1)]
        half = 0.5 * (end - start)
        nodes = 0.5 * (start + end) + half * FINE_NODES
        found.append(logsumexp(at(nodes, one) + np.log(half * FINE_WEIGHTS)))
    return -0.5 * x**2 + np.array(found)


def correlations(a, b, c):
    return np.array([[1.0, a, b], [a, 1.0, c], [b, c, 1.0]])


@pytest.mark.parametrize(
    ("C", "low", "high"),
    [
        # Near the mean, an axis that all but follows axis 0.
        (correlations(0.95, 0.1, 0.2), (-2.0, -1.0, -1.5), (2.0, 0.5, 1.0)),
        (correlations(-0.9, 0.6, -0.5), (-1.0, -0.3, 0.1), (1.5, 0.4, 1.2)),
        # Far out, at corners of upper bounds, of lower ones, and of both.
        (correlations(-0.92, 0.684, -0.889), (-3.1, -INF, -INF), (-1.9, -2.8, -1.3)),
        (correlations(0.92, -0.684, -0.889), (-3.1, 2.8, 1.3), (-1.9, INF, INF)),
        (correlations(-0.474, 0.092, -0.91), (-3.28, -INF, -INF), (-3.09, 0.57, -0.6)),
        (correlations(0.57, -0.65, -0.98), (4.9, -INF, -INF), (5.3, -2.6, 1.5)),
        (correlations(-0.83, 0.88, -0.98), (3.5, -INF, -INF), (5.0, 3.0, -4.8)),
    ],
)
def test_no_part_is_coarser_than_the_integrand(C, low, high):
    """The density bends by 1 / scale^2 at most in each part, but for what its ends leave out."""
    low, high = np.array(low), np.array(high)
    x = np.linspace(low[0], high[0], 121)
    step = x[1] - x[0]
    values = log_integrand(C, low, high, x)
    bend = -(values[2:] - 2.0 * values[1:-1] + values[:-2]) / step**2
    seen = values[1:-1] > values.max() - 40.0
    cuts, scales = parts(C, low, high)
    for start, end, scale in zip(cuts, cuts[1:], scales, strict=False):
        inside = seen & (x[1:-1] > start + step) & (x[1:-1] < end - step)
        assert (bend[inside] * scale**2 <= 1.05).all()


def test_a_part_begins_where_an_interval_is_first_left():
    """Axis 1 alone has bounds: its conditional mean is as many deviations inside of them there as
    the depth of the quadrature says."""
    C, low, high = correlations(0.95, 0.0, 0.0), (-9.0, -4.0, -INF), (9.0, 5.0, INF)
    cuts, _ = parts(C, np.array(low), np.array(high))
    within = np.sqrt(2.0 * DEPTH * (1.0 - 0.95**2))
    assert_allclose(np.sort(0.95 * cuts[1:-1]), np.sort([high[1] - within, low[1] + within]))


def test_the_two_zones_of_a_corner_name_each_other():
    """Axis j past its bound w with the other at its bound c, and that one past c with j at w."""
    for j in range(2):
        for bound in range(2):
            for other in range(2):
                one = 6 * j + 2 * (1 + other) + bound
                two = 6 * (1 - j) + 2 * (1 + bound) + other
                assert _other_zone(one) == two
                assert _other_zone(two) == one
