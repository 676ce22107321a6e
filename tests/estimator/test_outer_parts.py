"""Parts of a box's outermost axis, against the curvature of the integrand by brute force."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import minimize
from scipy.special import log_ndtr, logsumexp

from surefoot.estimator.moments.line import DEPTH
from surefoot.estimator.moments.parts import _corner, outer_parts

INF = np.inf
NODES, WEIGHTS = np.polynomial.legendre.leggauss(300)


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
        nodes = 0.5 * (start + end) + half * NODES
        found.append(logsumexp(at(nodes, one) + np.log(half * WEIGHTS)))
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
                assert _corner(one) == two
                assert _corner(two) == one
