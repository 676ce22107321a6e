"""Box moments against forty digits: a correlated pair by quadrature beside an axis of its own.

Along the pair's first axis the integral is numerical, with its second axis and the third in closed
form; nothing is shared with the product but the question.
"""

from itertools import pairwise

import mpmath as mp
import numpy as np
import pytest
from mpmath.calculus.quadrature import GaussLegendre
from theorem import truncated

from surefoot.estimator.box import box_moments

mp.mp.dps = 40


def exact(rho, low, high):
    """Log probability, mean (3,) and covariance (3, 3) of unit variances, axes 0 and 1 by rho."""
    rho, low, high = mp.mpf(rho), [mp.mpf(x) for x in low], [mp.mpf(x) for x in high]
    s = mp.sqrt(1 - rho**2)

    def at(x):
        p, y, yy = truncated(rho * x, s, low[1], high[1])
        w = mp.npdf(x)
        return w * p, w * y, w * yy

    # The mass lies near the box's point nearest to the mean: cut the axis finely there.
    a, b = max(low[0], mp.mpf(-45)), high[0]
    steep = 1 + abs(a) / s**2 + abs(low[1]) / s**2 if mp.isfinite(low[1]) else 1 + abs(a)
    b = min(b, max(a, mp.mpf(0)) + 45)
    cuts = sorted({a, b, *[a + mp.mpf(2) ** k / steep for k in range(-2, 14)]})
    cuts = [c for c in cuts if a <= c <= b]
    total = [mp.mpf(0)] * 6
    for left, right in pairwise(cuts):
        half, middle = (right - left) / 2, (right + left) / 2
        for node, weight in NODES:
            x = middle + half * node
            p, y, yy = at(x)
            for i, value in enumerate((p, x * p, x * x * p, y, yy, x * y)):
                total[i] += half * weight * value
    p, x, xx, y, yy, xy = total
    q, z, zz = truncated(mp.mpf(0), mp.mpf(1), low[2], high[2])
    mean = [x / p, y / p, z / q]
    cov = mp.zeros(3)
    cov[0, 0], cov[1, 1], cov[2, 2] = (
        xx / p - mean[0] ** 2,
        yy / p - mean[1] ** 2,
        zz / q - mean[2] ** 2,
    )
    cov[0, 1] = cov[1, 0] = xy / p - mean[0] * mean[1]
    return (
        float(mp.log(p * q)),
        np.array([float(m) for m in mean]),
        np.array([[float(cov[i, j]) for j in range(3)] for i in range(3)]),
    )


NODES = GaussLegendre(mp.mp).calc_nodes(5, mp.mp.prec)
"""Forty-eight nodes on [-1, 1] with their weights."""
BOXES = {
    "ordinary": (0.4, (-1.0, -0.5, -2.0), (0.7, 1.5, 0.3), 1e-8),
    "correlated 0.9": (0.9, (-0.5, -1.0, -1.0), (1.0, 0.5, 1.0), 1e-8),
    "correlated 0.999": (0.999, (-0.3, -0.4, -1.0), (0.5, 0.4, 1.0), 1e-8),
    "tiny": (0.5, (0.3, -0.2, 0.1), (0.3 + 1e-6, -0.2 + 1e-6, 0.1 + 1e-6), 1e-8),
    "huge": (0.5, (-9.0, -9.0, -9.0), (9.0, 9.0, 9.0), 1e-8),
    "half open": (-0.6, (0.5, -np.inf, -np.inf), (np.inf, 0.2, np.inf), 1e-8),
    "a pair of many nodes": (0.97, (-4.5, -3.0, -np.inf), (4.5, 3.0, np.inf), 1e-8),
    "8 sigma away": (0.3, (8.0, -1.0, 0.0), (9.0, 1.0, 2.0), 1e-8),
    "8 sigma away on two": (-0.3, (8.0, 8.0, -1.0), (10.0, 10.0, 1.0), 1e-8),
    "log probability -800": (0.5, (40.0, 0.0, -1.0), (41.0, 3.0, 1.0), 1e-6),
    "log probability -10 000": (0.2, (100.0, 100.0, 40.0), (101.0, 103.0, 50.0), 1e-6),
}


@pytest.mark.parametrize("name", BOXES)
def test_box_moments_are_those_of_forty_digits(name):
    rho, low, high, allowed = BOXES[name]
    C = np.eye(3)
    C[0, 1] = C[1, 0] = rho
    want = exact(rho, low, high)
    got = box_moments(np.zeros(3), C, np.array(low), np.array(high))
    deviations = np.sqrt(np.diag(want[2]))
    assert abs(np.expm1(got[0] - want[0])) < allowed
    assert np.abs((got[1] - want[1]) / deviations).max() < allowed
    assert np.abs((got[2] - want[2]) / np.outer(deviations, deviations)).max() < allowed
    if name == "log probability -10 000":
        assert -10_500 < want[0] < -9_000
