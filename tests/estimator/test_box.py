"""Box moments against an independent brute force, and properties that hold for every box."""

import numpy as np
import pytest
from box_reference import composite, reference, trimmed, worst_error
from numpy.testing import assert_allclose
from scipy.special import ndtr

from surefoot.estimator.box import below_prior, box_moments, clip_to_prior
from surefoot.estimator.moments.faces import nearest_in_box
from surefoot.estimator.moments.grid import grid_moments

# name: smallest eigen-deviation, distance of the box in sigma, half widths in sigma, panels
KINDS = {
    "ordinary": (0.6, 0.0, (0.5, 2.0), 4),
    "tiny": (0.6, 0.0, (1e-3, 0.05), 2),
    "huge": (0.6, 0.0, (3.0, 6.0), 8),
    "8 sigma": (0.6, 8.0, (0.5, 2.0), 12),
    "correlated": (0.08, 0.0, (0.5, 2.0), 20),
    "strongly correlated": (0.03, 0.0, (0.3, 1.0), 20),
    "correlated tail": (0.2, 5.0, (0.5, 1.5), 20),
    "40 sigma": (0.6, 40.0, (0.3, 0.8), 20),
}


def box(rng, smallest, distance, widths):
    Q = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    cov = Q @ np.diag([1.0, rng.uniform(0.3, 1), smallest]) ** 2 @ Q.T
    s = np.sqrt(np.diag(cov))
    mean = 0.5 * rng.normal(size=3)
    direction = rng.normal(size=3)
    centre = (
        mean + (0.5 * rng.normal(size=3) + distance * direction / np.linalg.norm(direction)) * s
    )
    half = rng.uniform(*widths, size=3) * s
    return mean, cov, centre - half, centre + half


@pytest.mark.parametrize("kind", KINDS)
def test_against_brute_force(kind):
    smallest, distance, widths, panels = KINDS[kind]
    rng = np.random.default_rng(20)
    for _ in range(3):
        case = box(rng, smallest, distance, widths)
        wanted = reference(*case, (panels,) * 3)
        assert worst_error(box_moments(*case), wanted, case[1]) < 1e-9


@pytest.mark.parametrize("distance", [3.0, 20.0, 60.0, 130.0])
def test_far_tails_of_nearly_singular_covariances(distance):
    """Correlation determinants below 1e-3, log probabilities down to about -10 000."""
    rng = np.random.default_rng(int(distance))
    Q = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    cov = Q @ np.diag([1.0, rng.uniform(0.3, 1), 0.01]) ** 2 @ Q.T
    s = np.sqrt(np.diag(cov))
    assert np.linalg.det(cov / np.outer(s, s)) < 1e-3
    away = rng.normal(size=3)
    away *= distance / np.linalg.norm(np.linalg.solve(np.linalg.cholesky(cov), away))
    half = rng.uniform(0.2, 1.0, size=3) * s
    # The corner that faces the mean lies at that distance.
    lower, upper = away + (np.sign(away) - 1) * half, away + (np.sign(away) + 1) * half
    found = box_moments(np.zeros(3), cov, lower, upper)
    assert found[0] > -12_000
    wanted = reference(np.zeros(3), cov, *trimmed(np.zeros(3), cov, lower, upper), (16, 16, 16))
    assert worst_error(found, wanted, cov) < (1e-8 if found[0] > -1000 else 1e-6)


def test_the_whole_space_is_the_prior():
    rng = np.random.default_rng(0)
    for smallest in (0.5, 0.03):
        mean, cov, _, _ = box(rng, smallest, 0.0, (1, 2))
        log_prob, m, C = box_moments(mean, cov, np.full(3, -np.inf), np.full(3, np.inf))
        assert_allclose(log_prob, 0, atol=1e-11)
        assert_allclose(m, mean, atol=1e-11)
        assert_allclose(C, cov, atol=1e-10)


@pytest.mark.parametrize("bounded", [1, 2])
def test_axes_without_bounds_follow_the_others_by_regression(bounded):
    """x_b given x_a is Gaussian whatever x_a is held to: mean K m, covariance V + K S K^T. Of the
    grid alone, for what exceeds the prior is clipped afterwards."""
    rng = np.random.default_rng(9)
    for _ in range(5):
        _, cov, lower, upper = box(rng, 0.3, 0.0, (0.2, 1.0))
        spread = np.sqrt(np.diag(cov))
        C, low, high = cov / np.outer(spread, spread), lower / spread, upper / spread
        a, b = slice(bounded), slice(bounded, 3)
        low[b], high[b] = -np.inf, np.inf
        mode, m, S = np.empty(3), np.empty(3), np.empty((3, 3))
        distance = nearest_in_box(C, low, high, mode)
        assert np.isfinite(grid_moments(C, low, high, mode, distance, m, S))
        K = np.linalg.solve(C[a, a], C[a, b]).T
        assert_allclose(m[b], K @ m[a], atol=1e-10)
        assert_allclose(S[b, a], K @ S[a, a], atol=1e-10)
        assert_allclose(S[b, b], C[b, b] - K @ (C[a, a] - S[a, a]) @ K.T, atol=1e-10)


@pytest.mark.parametrize(
    ("correlations", "lower", "upper"),
    [
        ((0.475, 0.63, 0.982), (-np.inf, -np.inf), (-33.65, -30.15)),
        ((0.4750945, 0.6315681, 0.9822859), (-733.8, -154.8), (-33.655, -30.15)),
        (
            (0.17672466525490405, 0.4309440114243972, 0.9643333220674236),
            (-537.3037948839936, -520.1148064638058),
            (-537.0375726578212, -500.2199461058683),
        ),
    ],
)
def test_what_integration_adds_above_the_prior_is_taken_off(correlations, lower, upper):
    """An axis without bounds keeps, along one combination with the others, exactly the prior's
    variance; there the rules are out by more than 1e-9 in these boxes far away."""
    C = np.eye(3)
    C[np.triu_indices(3, 1)] = correlations
    C = np.maximum(C, C.T)
    low, high = np.array([-np.inf, *lower]), np.array([np.inf, *upper])
    _, _, cov = box_moments(np.zeros(3), C, low, high)
    assert np.linalg.eigvalsh(C - cov)[0] > -1e-11


def test_nearest_point_is_the_minimum_of_the_distance():
    """27 faces against random search: nothing inside the box is nearer, and it lies inside."""
    rng = np.random.default_rng(2)
    for _ in range(200):
        A = rng.normal(size=(3, 3))
        C = A @ A.T + 0.01 * np.eye(3)
        spread = rng.uniform(0.3, 3.0, size=3)
        C *= np.outer(spread, spread) / np.sqrt(np.outer(np.diag(C), np.diag(C)))
        centre = 3 * rng.normal(size=3) * spread
        half = rng.uniform(0.1, 2.0, size=3) * spread
        lower, upper, point = centre - half, centre + half, np.empty(3)
        distance = nearest_in_box(C, lower, upper, point)
        information = np.linalg.inv(C)
        assert np.all((point >= lower - 1e-12) & (point <= upper + 1e-12))
        assert_allclose(point @ information @ point, distance, rtol=1e-8, atol=1e-10)
        others = np.clip(point + 0.1 * rng.normal(size=(200, 3)) * half, lower, upper)
        assert np.einsum("ni,ij,nj->n", others, information, others).min() >= distance - 1e-9


def test_bad_input_is_a_clear_value_error():
    good = {"mean": np.zeros(3), "cov": np.eye(3), "lower": -np.ones(3), "upper": np.ones(3)}
    for change, words in (
        ({"mean": np.zeros(2)}, r"mean: shape \(2,\) where \(3\) is expected"),
        ({"mean": np.array([0, np.nan, 0])}, "mean: has values that are not finite"),
        ({"lower": np.array([np.nan, 0, 0])}, "lower must be three numbers below"),
        ({"lower": np.ones(3)}, "lower must be three numbers below"),
        ({"lower": np.full(3, np.inf)}, "lower must be three numbers below"),
        ({"cov": np.diag([1.0, 1.0, 0.0])}, "cov: is not positive definite"),
    ):
        with pytest.raises(ValueError, match=words):
            box_moments(**{**good, **change})


NEARLY_SINGULAR = (
    (
        [
            [1.0, -0.9999999999997671, -0.9999999999999427],
            [-0.9999999999997671, 1.0, 0.9999999999997805],
            [-0.9999999999999427, 0.9999999999997805, 1.0000000000000002],
        ],
        [-24.329742115723604, 1.8283740953495966, 5.982064495768756],
        [15.143224580275431, 1.8296947061720943, 5.992839527021542],
    ),
    (
        [
            [1.0000000000000002, 0.9999999999401089, 0.9999999996280247],
            [0.9999999999401089, 1.0, 0.9999999993593951],
            [0.9999999996280247, 0.9999999993593951, 1.0],
        ],
        [-152.90336136604148, 55.31962247433409, -393.4841991703442],
        [-48.00298911847762, 55.38667047611177, 239.38149463588212],
    ),
)


"""Correlations and boxes for which rounding leaves no window: a grid wrote beyond its memory."""


@pytest.mark.parametrize(("C", "low", "high"), NEARLY_SINGULAR)
def test_a_box_millions_of_deviations_away_has_moments_inside_it(C, low, high):
    low, high = np.array(low), np.array(high)
    log_prob, mean, cov = box_moments(np.zeros(3), np.array(C), low, high)
    assert np.isfinite(log_prob)
    assert np.all((mean >= low - 1e-9) & (mean <= high + 1e-9))
    assert np.linalg.eigvalsh(cov).min() >= -1e-15


def test_what_is_above_the_prior_is_clipped_to_it_and_the_rest_is_kept():
    C = np.array([[1.0, 0.999, -0.3], [0.999, 1.0, -0.32], [-0.3, -0.32, 1.0]])
    L = np.linalg.cholesky(C)
    Q = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))[0]
    within = L @ Q @ np.diag([0.2, 0.9, 1.0 - 1e-6]) @ Q.T @ L.T
    beyond = L @ Q @ np.diag([0.2, 0.9, 1.3]) @ Q.T @ L.T
    exact = L @ Q @ np.diag([0.2, 0.9, 1.0]) @ Q.T @ L.T
    kept, clipped = within.copy(), beyond.copy()
    clip_to_prior(C, kept)
    clip_to_prior(C, clipped)
    assert below_prior(C, within)
    assert not below_prior(C, beyond)
    assert np.abs(kept - within).max() < 1e-12
    assert np.abs(clipped - exact).max() < 1e-12


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
