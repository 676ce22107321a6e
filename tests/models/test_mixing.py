"""The mixing estimate against chains whose coefficients are known."""

import numpy as np
import pytest
from scipy.optimize import root_scalar
from scipy.stats import norm
from synthetic import gauss_markov

from surefoot.models.calibration.mixing import (
    beta_coefficient,
    discretise,
    independence_floor,
    mixing,
)


def markov_chain(P, n, rng):
    states = np.zeros(n, dtype=int)
    steps = rng.random(n)
    edges = P.cumsum(axis=1)
    for i in range(1, n):
        states[i] = np.searchsorted(edges[states[i - 1]], steps[i])
    return states


def gaussian_beta(r):
    """beta of two standard normal variables with correlation r, by quadrature."""
    g = np.linspace(-6, 6, 601)
    X, Y = np.meshgrid(g, g)
    joint = np.exp(-(X * X - 2 * r * X * Y + Y * Y) / (2 * (1 - r * r)))
    joint /= 2 * np.pi * np.sqrt(1 - r * r)
    return 0.5 * np.abs(joint - norm.pdf(X) * norm.pdf(Y)).sum() * (g[1] - g[0]) ** 2


@pytest.mark.parametrize("phi", [0.8, 0.9])
def test_the_curve_of_an_autoregression(phi):
    x = gauss_markov(np.random.default_rng(2), 7000, phi)
    curve = mixing(x)
    for lag in (5, 10, 20):
        assert curve.excess[lag - 1] == pytest.approx(gaussian_beta(phi**lag), abs=0.05)
    assert curve.mixed


def test_independent_samples_stay_at_the_floor():
    states = discretise(np.random.default_rng(3).standard_normal(5000))
    values = [beta_coefficient(states, lag) for lag in range(1, 30)]
    assert np.mean(values) == pytest.approx(independence_floor(states), rel=0.1)
    assert mixing(np.random.default_rng(4).standard_normal((5000, 3))).K <= 2


def test_what_never_mixes_is_said():
    x = np.repeat([0.0, 1.0], 2000)[:, None] + 0.01 * np.random.default_rng(5).random((4000, 1))
    assert not mixing(x).mixed


def test_monotone_maps_do_not_matter():
    x = gauss_markov(np.random.default_rng(6), 2000, 0.9, axes=1)
    assert np.array_equal(mixing(x).beta, mixing(np.exp(3 * x)).beta)


def test_a_chain_of_four_states_exactly():
    """On the chain's own states the estimate is the coefficient, up to the floor of its noise."""
    rng = np.random.default_rng(7)
    P = rng.dirichlet(np.ones(4), 4) * 0.5 + 0.5 * np.eye(4)
    pi = np.linalg.matrix_power(P, 200)[0]
    states = markov_chain(P, 60_000, rng)
    for lag in (1, 2, 3, 5, 8):
        true = 0.5 * pi @ np.abs(np.linalg.matrix_power(P, lag) - pi).sum(axis=1)
        assert beta_coefficient(states, lag) == pytest.approx(true, abs=0.012)


@pytest.mark.parametrize(("phi", "n"), [(0.8, 6700), (0.9, 6700), (0.95, 20_000)])
def test_spacing_is_close_to_the_true_one_and_never_much_below(phi, n):
    """Over records as long as a calibration: true K is where gaussian_beta(phi^K) = 0.05."""
    rng = np.random.default_rng(8)
    correlation = root_scalar(lambda r: gaussian_beta(r) - 0.05, bracket=(0.1, 0.2), xtol=1e-3)
    true = np.log(correlation.root) / np.log(phi)
    found = np.array([mixing(gauss_markov(rng, n, phi)).K for _ in range(8)])
    assert true * 0.85 <= found.min()
    assert true <= np.median(found) <= 1.35 * true


def test_a_clock_never_mixes_and_its_period_is_avoided():
    """A gait by the clock: errors repeat with the stride, however far apart they are taken."""
    rng, period = np.random.default_rng(9), 50
    clock = np.tile(np.sign(np.arange(period) - 9.5), 200)  # one fifth of the stride differs
    x = gauss_markov(rng, len(clock), 0.9, axes=1)[:, 0]
    curve = mixing((x / x.std() + 2 * clock)[:, None])
    beta = curve.excess[:, 0]
    at_stride, between = beta[period - 1 :: period], beta[period // 2 - 1 :: period]
    assert at_stride.min() > 0.2
    assert at_stride.min() > 2 * between.max()
    assert at_stride[-1] > 0.9 * at_stride[0]
    assert min(curve.K % period, period - curve.K % period) > 2
