"""Theorem 1, moment matching and the paper's remark, each against what it claims to minimise."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import minimize
from theorem import posterior

from surefoot.estimator.box import box_moments
from surefoot.estimator.core.state import NavState
from surefoot.estimator.filter import InvariantFilter
from surefoot.estimator.updates.coverage import update_coverage
from surefoot.estimator.updates.velocity import velocity_memory
from surefoot.sim.common.errors import SurefootError


def quadrature(edges, order=12):
    """Gauss-Legendre between the edges: nodes (n,), weights (n,), and the interval of each."""
    x, w = np.polynomial.legendre.leggauss(order)
    half, middle = 0.5 * np.diff(edges)[:, None], 0.5 * (edges[1:] + edges[:-1])[:, None]
    return (middle + half * x).ravel(), (half * w).ravel(), np.arange(len(half)).repeat(order)


def prior_cells(mean, cov, edges):
    """A Gaussian on nodes (n, d): their masses (n,) and the cell (n,) of each, by axes' edges."""
    axes = [quadrature(e) for e in edges]
    nodes = np.stack(np.meshgrid(*[a[0] for a in axes], indexing="ij"), axis=-1)
    nodes = nodes.reshape(-1, len(axes))
    weights, cell = np.ones(1), np.zeros(1, dtype=int)
    for _, w, interval in axes:
        weights = np.outer(weights, w).ravel()
        cell = (cell[:, None] * (interval[-1] + 1) + interval).ravel()
    d = nodes - mean
    exponent = -0.5 * np.einsum("ni,ij,nj->n", d, np.linalg.inv(cov), d)
    mass = weights * np.exp(exponent) / np.sqrt(np.linalg.det(2 * np.pi * cov))
    return nodes, mass / mass.sum(), cell


def least_divergence(p, inside, gamma):
    """Cell masses q of least KL(q || p) with q(inside) >= gamma, by a general convex solver.

    It is told the divergence, the two constraints and nothing of the theorem.
    """

    root = np.sqrt(p)  # unknowns y = q / sqrt(p): the divergence's Hessian is then p / q

    def divergence(y):
        return float(root * y @ np.log(y / root))

    found = minimize(
        divergence, root, jac=lambda y: root * (np.log(y / root) + 1.0), method="SLSQP",
        bounds=[(1e-9 * r, None) for r in root],
        constraints=[
            {"type": "eq", "fun": lambda y: root @ y - 1.0, "jac": lambda y: root},
            {"type": "ineq", "fun": lambda y: root[inside] @ y[inside] - gamma,
             "jac": lambda y: root * inside},
        ],
        options={"ftol": 1e-14, "maxiter": 200},
    )  # fmt: skip
    assert found.success, found.message
    return root * found.x, found.fun


def check_against_the_minimum(mean, cov, lower, upper, edges, gamma):
    """Density, mass, divergence and the first two moments of the solver's minimum are ours.

    Cells meet at the box's faces. Inside a cell the prior's own shape is the best one, since the
    divergence is that of the cells' masses and more for any other shape.
    """
    nodes, mass, cell = prior_cells(mean, cov, edges)
    p = np.bincount(cell, mass)
    middle = np.column_stack([np.bincount(cell, mass * x) / p for x in nodes.T])
    d = len(edges)
    inside = np.all((middle > lower[:d]) & (middle < upper[:d]), axis=1)
    q, divergence = least_divergence(p, inside, gamma)
    weight = (q / p)[cell] * mass
    wanted_mean = weight @ nodes
    centred = nodes - wanted_mean
    wanted_cov = centred.T * weight @ centred
    whole_mean, whole_cov = np.zeros(3), np.eye(3)
    whole_mean[:d], whole_cov[:d, :d] = mean, cov
    pi, found_mean, found_cov = posterior(whole_mean, whole_cov, lower, upper, gamma)
    assert_allclose(pi, p[inside].sum(), rtol=1e-7)
    assert_allclose(found_mean[:d], wanted_mean, atol=1e-5)
    assert_allclose(found_cov[:d, :d], wanted_cov, atol=1e-5)
    # The density itself, where there is mass that tells it: one factor inside, one outside.
    seen = p > 1e-6
    if pi >= gamma:
        assert_allclose(q[seen] / p[seen], 1.0, atol=1e-4)
        return
    assert_allclose(q[inside & seen] / p[inside & seen], gamma / pi, rtol=1e-4)
    assert_allclose(q[~inside & seen] / p[~inside & seen], (1 - gamma) / (1 - pi), rtol=1e-4)
    least = gamma * np.log(gamma / pi) + (1 - gamma) * np.log((1 - gamma) / (1 - pi))
    assert_allclose(divergence, least, rtol=1e-7)


@pytest.mark.parametrize(
    ("centre", "half", "gamma"),
    [(0.3, 0.4, 0.8), (2.5, 0.6, 0.8), (-1.0, 1.5, 0.95), (0.1, 2.5, 0.7)],
)
def test_one_axis_is_the_numerical_minimum(centre, half, gamma):
    """The last case has pi >= gamma: the solver leaves the prior alone, as the theorem says."""
    spread = 1.3
    lower = np.array([centre - half, -np.inf, -np.inf])
    upper = np.array([centre + half, np.inf, np.inf])
    left, right = np.linspace(-11, lower[0], 25), np.linspace(upper[0], 11, 25)
    edges = np.r_[left, np.linspace(lower[0], upper[0], 13)[1:-1], right]
    check_against_the_minimum(
        np.zeros(1), np.array([[spread**2]]), lower, upper, [edges], gamma
    )  # fmt: skip


@pytest.mark.parametrize(("half", "gamma"), [(0.7, 0.8), (1.1, 0.95), (2.9, 0.6)])
def test_three_axes_are_the_numerical_minimum(half, gamma):
    """A correlated prior and an off-centre box; the last again with pi >= gamma."""
    cov = np.array([[1.0, 0.5, -0.3], [0.5, 1.5, 0.2], [-0.3, 0.2, 0.7]])
    mean = np.array([0.2, -0.1, 0.3])
    centre = mean + np.array([0.4, -0.5, 0.3])
    lower, upper = centre - half, centre + half
    edges = [
        np.r_[m - 9 * s, a - 0.8, a, c, b, b + 0.8, m + 9 * s]
        for m, s, a, b, c in zip(mean, np.sqrt(np.diag(cov)), lower, upper, centre, strict=True)
    ]
    check_against_the_minimum(mean, cov, lower, upper, edges, gamma)


def test_the_matched_gaussian_is_the_nearest_gaussian():
    """The paper's footnote: no Gaussian has a smaller KL(q || N) than the one we return."""
    cov = np.array([[1.0, 0.6, 0.0], [0.6, 1.2, -0.3], [0.0, -0.3, 0.8]])
    lower, upper, gamma = np.array([0.2, -0.5, -1.0]), np.array([1.9, 0.8, 0.4]), 0.85
    edges = [
        np.r_[-9.0 * s, a, b, 9.0 * s]
        for s, a, b in zip(np.sqrt(np.diag(cov)), lower, upper, strict=True)
    ]
    nodes, mass, _ = prior_cells(np.zeros(3), cov, edges)
    inside = np.all((nodes > lower) & (nodes < upper), axis=1)
    pi = mass[inside].sum()
    q = mass * np.where(inside, gamma / pi, (1 - gamma) / (1 - pi))
    first, second = q @ nodes, nodes.T * q @ nodes
    at = np.tril_indices(3)

    def cross_entropy(x):
        L = np.zeros((3, 3))
        L[at] = x[3:]
        W = np.linalg.inv(L)
        about = second - np.outer(x[:3], first) - np.outer(first, x[:3]) + np.outer(x[:3], x[:3])
        return np.log(np.abs(np.diag(L))).sum() + 0.5 * np.trace(W @ about @ W.T)

    found = minimize(cross_entropy, np.r_[np.zeros(3), np.eye(3)[at]], method="BFGS",
                     options={"gtol": 1e-9}).x  # fmt: skip
    L = np.zeros((3, 3))
    L[at] = found[3:]
    _, mean_plus, cov_plus = posterior(np.zeros(3), cov, lower, upper, gamma)
    assert_allclose(found[:3], mean_plus, atol=1e-5)
    assert_allclose(L @ L.T, cov_plus, atol=1e-5)


def boxes(rng, count):
    """Correlated priors and boxes of all widths and places (up to eight deviations off)."""
    for _ in range(count):
        A = rng.normal(size=(3, 3)) * np.exp(rng.normal(size=(3, 1)))
        cov = A @ A.T + 1e-4 * np.eye(3)
        s = np.sqrt(np.diag(cov))
        centre = s * rng.normal(size=3) * rng.choice([0.1, 1.0, 3.0])
        half = s * np.exp(rng.uniform(np.log(0.02), np.log(5.0), 3))
        yield cov, centre - half, centre + half


def test_the_papers_remark_holds_everywhere():
    """pi < pi+ <= gamma, as the docstring of `estimator.updates.coverage` proves, at every
    gamma."""
    rng = np.random.default_rng(9)
    active = 0
    for cov, lower, upper in boxes(rng, 2000):
        gamma = rng.choice([0.05, 0.3, 0.7, 0.8, 0.95, 0.999])
        pi, mean, out = posterior(np.zeros(3), cov, lower, upper, gamma)
        if 1e-200 < pi < gamma:
            active += 1
            raised = np.exp(box_moments(mean, out, lower, upper)[0])
            assert pi < raised < gamma
    assert active > 1000


def test_the_divergence_splits_as_the_proof_says():
    """kl(gamma || pi) >= kl(gamma || pi+) + KL(p+ || p), and KL(p+ || p) >= kl(pi+ || pi)."""

    def kl(a, b):
        return a * np.log(a / b) + (1 - a) * np.log((1 - a) / (1 - b))

    rng, gamma = np.random.default_rng(3), 0.8
    for cov, lower, upper in boxes(rng, 200):
        pi, mean, out = posterior(np.zeros(3), cov, lower, upper, gamma)
        if 1e-100 < pi < gamma:
            ratio = np.linalg.solve(cov, out)
            between = 0.5 * (
                np.trace(ratio) - 3 - np.linalg.slogdet(ratio)[1]
                + mean @ np.linalg.solve(cov, mean)
            )  # fmt: skip
            raised = np.exp(box_moments(mean, out, lower, upper)[0])
            assert kl(gamma, pi) > kl(gamma, raised) + between
            assert between > kl(raised, pi)


def filters():
    """A filter that knows its attitude well, so that z is linear in what the update moves."""
    A = 0.2 * np.random.default_rng(5).normal(size=(15, 15))
    A[:3] *= 1e-4
    P = A @ A.T + 1e-8 * np.eye(15)
    return InvariantFilter(NavState(), P), P, np.array([0.3, -0.2, 0.4]), np.array([0.1, 0.2, 0.1])


def mass_inside(one, v_I, epsilon):
    """P(|v_I - velocity of the IMU| <= epsilon) as the filter's state and covariance have it."""
    R, residual = one.state.R_GI, v_I - one.state.v_I
    cov = R.T @ one.covariance[3:6, 3:6] @ R
    return np.exp(box_moments(np.zeros(3), cov, residual - epsilon, residual + epsilon)[0])


def test_iterations_lead_towards_gamma():
    """Each projection raises the mass in the filter's own state, and many reach gamma."""
    one, P, v_I, epsilon = filters()
    masses = [mass_inside(one, v_I, epsilon)]
    for iterations in (1, 2, 5, 50):
        one = InvariantFilter(NavState(), P)
        pi = one.update_coverage(v_I, epsilon, 0.8, iterations)
        assert pi == pytest.approx(masses[0], rel=1e-6)
        masses.append(mass_inside(one, v_I, epsilon))
    assert np.all(np.diff(masses) > 0)
    assert masses[-1] == pytest.approx(0.8, abs=1e-3)


def test_iterations_stay_finite_on_far_boxes():
    rng = np.random.default_rng(8)
    mean, P = NavState().pack(), 1e-4 * np.eye(15)
    for k in range(300):
        v = 0.02 * rng.normal(size=3) + (0.4 if k % 50 == 25 else 0.0)
        update_coverage(mean, P, v, np.full(3, 0.03), 0.8, 50, velocity_memory())
        np.linalg.cholesky(P)
        P[3:6, 3:6] += 1e-6 * np.eye(3)
    assert np.isfinite(mean).all()


@pytest.mark.parametrize("iterations", [0, -1, 1001])
def test_bad_iterations_are_one_clear_line(iterations):
    one, _, v_I, epsilon = filters()
    with pytest.raises(SurefootError, match="iterations"):
        one.update_coverage(v_I, epsilon, 0.8, iterations)
