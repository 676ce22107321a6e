"""Exponential, logarithm and Gamma functions over batches, near the identity on purpose."""

import mpmath as mp
import numpy as np
import pytest
from lie_group import se_exp, se_log, so3_exp, so3_log

from surefoot.estimator.core import lie

ANGLES = [0.0, 1e-12, 1e-9, 1e-7, 1e-5, 1e-3, 0.03, 0.3, 1.99, 2.01, 3.0, np.pi - 1e-9]
COLUMNS = [0, 2, 6]


def tangent(rng: np.random.Generator, angle: float, columns: int) -> np.ndarray:
    xi = rng.normal(size=3 * (1 + columns))
    xi[:3] *= angle / np.linalg.norm(xi[:3])
    return xi


@pytest.fixture
def rng():
    return np.random.default_rng(7)


@pytest.mark.parametrize("columns", COLUMNS)
@pytest.mark.parametrize("angle", ANGLES)
def test_exp_is_the_matrix_exponential_and_log_its_inverse(rng, angle, columns):
    for _ in range(5):
        xi = tangent(rng, angle, columns)
        gamma = [np.empty((3, 3)) for _ in range(3)]
        lie.gammas(xi[:3], *gamma)
        X = se_exp(xi)
        assert np.allclose(so3_exp(xi[:3]), X[:3, :3], atol=1e-14, rtol=0)
        assert np.allclose(gamma[0], X[:3, :3], atol=1e-14, rtol=0)
        assert np.allclose(gamma[1] @ xi[3:].reshape(columns, 3).T, X[:3, 3:], atol=1e-13, rtol=0)
        assert np.allclose(se_log(X), xi, atol=1e-13, rtol=0)


@pytest.mark.parametrize("angle", [a for a in ANGLES if a])
def test_small_rotations_keep_their_relative_digits(rng, angle):
    """No digit is lost on the way to the identity: log(exp(phi)) = phi relative to |phi|."""
    phi = tangent(rng, angle, 0)
    assert np.linalg.norm(so3_log(so3_exp(phi)) - phi) < 1e-14 * max(angle, 1e-3)


@pytest.mark.parametrize("x", [0.0, 1e-24, 1e-14, 9e-5, 1.1e-4, 1e-2, 3.99, 4.01, 9.8, 39.0])
def test_coefficients_to_the_last_digits(x):
    """e_0 ... e_6 against their series in fifty digits, from nothing to a full turn."""
    with mp.workdps(50):
        for k, found in enumerate(lie.entire(x)):
            wanted = mp.nsum(lambda j, k=k: (-mp.mpf(x)) ** j / mp.factorial(2 * j + k), [0, 60])
            assert found == pytest.approx(float(wanted), rel=2e-14, abs=2e-15), k


@pytest.mark.parametrize("angle", ANGLES)
def test_gammas_are_their_power_series(rng, angle):
    phi = tangent(rng, angle, 0)
    gammas = [np.empty((3, 3)) for _ in range(3)]
    lie.gammas(phi, *gammas)
    for m, gamma in enumerate(gammas):
        term = np.eye(3) / [1, 1, 2][m]
        series = np.zeros((3, 3))
        for n in range(1, 40):
            series += term
            term = term @ lie.hat(phi) / (n + m)
        assert np.allclose(gamma, series, atol=1e-14)


def test_the_series_meets_the_closed_form():
    """The coefficients are continuous where the series hands over to the recursion."""
    for switch in (1e-4, 4.0):
        below, above = lie.entire(switch * (1 - 1e-15)), lie.entire(switch)
        assert np.allclose(below, above, rtol=1e-13, atol=0)
