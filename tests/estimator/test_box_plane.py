"""Three axes next to a plane, no two of them next to a line: where the nested rule cuts finest."""

import numpy as np
import pytest
from box_reference import composite, worst_error
from scipy.special import ndtr

from surefoot.estimator.box import box_moments


def line_reference(C, low, high, panels: int):
    """(log_prob, mean, cov): brute force over axes 0 and 1, axis 2 in closed form in between."""
    gain = np.linalg.solve(C[:2, :2], C[2, :2])
    s = np.sqrt(C[2, 2] - gain @ C[2, :2])
    x0, w0 = composite(low[0], high[0], panels)
    x1, w1 = composite(low[1], high[1], panels)
    W = np.linalg.inv(C[:2, :2])
    sums = np.zeros(10)
    for a, wa in zip(x0, w0, strict=True):
        m = gain[0] * a + gain[1] * x1
        u, v = (low[2] - m) / s, (high[2] - m) / s
        density = np.exp(-0.5 * (W[0, 0] * a * a + 2 * W[0, 1] * a * x1 + W[1, 1] * x1**2))
        p = np.where(u > 0, ndtr(-u) - ndtr(-v), ndtr(v) - ndtr(u))
        pu, pv = (
            np.exp(-0.5 * u * u) / np.sqrt(2 * np.pi),
            np.exp(-0.5 * v * v) / np.sqrt(2 * np.pi),
        )
        first = m * p + s * (pu - pv)
        second = m * m * p + 2 * m * s * (pu - pv) + s * s * (p + u * pu - v * pv)
        w = wa * w1 * density
        total = w @ p
        sums += [total, a * total, w @ (x1 * p), w @ first, a * a * total, a * (w @ (x1 * p)),
                 a * (w @ first), w @ (x1**2 * p), w @ (x1 * first), w @ second]  # fmt: skip
    mean = sums[1:4] / sums[0]
    cov = np.empty((3, 3))
    cov[np.triu_indices(3)] = sums[4:] / sums[0]
    cov = np.triu(cov) + np.triu(cov, 1).T - np.outer(mean, mean)
    log_prob = np.log(sums[0]) - np.log(2 * np.pi) - 0.5 * np.log(np.linalg.det(C[:2, :2]))
    return log_prob, mean, cov


def near_plane(thickness: float, rng) -> np.ndarray:
    """A correlation matrix (3, 3) of a Gaussian about a plane, no pair beyond 0.9."""
    while True:
        Q = np.linalg.qr(rng.standard_normal((3, 3)))[0]
        cov = Q @ np.diag([1.0, rng.uniform(0.3, 1.0), thickness]) ** 2 @ Q.T
        C = cov / np.sqrt(np.outer(np.diag(cov), np.diag(cov)))
        if np.abs(np.triu(C, 1)).max() < 0.9:
            return C


@pytest.mark.parametrize(
    ("thickness", "panels"), [(0.1, 40), pytest.param(0.01, 250, marks=pytest.mark.slow)]
)
def test_a_gaussian_about_a_plane(thickness, panels):
    rng = np.random.default_rng(11)
    for _ in range(12):
        C = near_plane(thickness, rng)
        # The mean inside the box, at its edges, and outside it within reach of the plane.
        on_plane = np.linalg.cholesky(C) @ rng.standard_normal(3)
        half = rng.uniform(0.5, 3.0, 3)
        low, high = on_plane - half, on_plane + half
        found = box_moments(np.zeros(3), C, low, high)
        assert worst_error(found, line_reference(C, low, high, panels), C) < 1e-8
