"""Group axioms over batches, near the identity on purpose, and Jacobians against differences."""

import mpmath as mp
import numpy as np
import pytest
from scipy.linalg import expm

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
        X = lie.se_exp(xi)
        assert np.allclose(X, expm(lie.se_hat(xi)), atol=1e-13, rtol=0)
        assert np.allclose(lie.se_log(X), xi, atol=1e-13, rtol=0)


@pytest.mark.parametrize("angle", ANGLES)
def test_group_axioms(rng, angle):
    for columns in COLUMNS:
        X, Y, Z = (lie.se_exp(tangent(rng, angle, columns)) for _ in range(3))
        identity = np.eye(3 + columns)
        assert np.allclose(X @ lie.se_inverse(X), identity, atol=1e-13)
        assert np.allclose((X @ Y) @ Z, X @ (Y @ Z), atol=1e-13)
        R = (X @ Y)[:3, :3]
        assert np.allclose(R @ R.T, np.eye(3), atol=1e-14)
        assert np.allclose((X @ Y)[3:], identity[3:], atol=0)
        assert np.array_equal(X @ identity, X)
        assert np.array_equal(lie.se_exp(np.zeros(3 * (1 + columns))), identity)
        assert np.array_equal(lie.se_log(identity), np.zeros(3 * (1 + columns)))


@pytest.mark.parametrize("columns", COLUMNS)
@pytest.mark.parametrize("angle", ANGLES)
def test_elements_of_one_axis_commute_and_add(rng, angle, columns):
    """exp(a xi) exp(b xi) = exp((a + b) xi), and exp(-xi) is the inverse."""
    xi = tangent(rng, angle, columns)
    X, Y = lie.se_exp(0.3 * xi), lie.se_exp(0.7 * xi)
    assert np.allclose(X @ Y, lie.se_exp(xi), atol=1e-14 * (1 + np.abs(xi).max()) * 10)
    assert np.allclose(X @ Y, Y @ X, atol=1e-14)
    assert np.allclose(lie.se_exp(-xi), lie.se_inverse(lie.se_exp(xi)), atol=1e-14)


@pytest.mark.parametrize("angle", [a for a in ANGLES if a])
def test_small_rotations_keep_their_relative_digits(rng, angle):
    """No digit is lost on the way to the identity: log(exp(phi)) = phi relative to |phi|."""
    phi = tangent(rng, angle, 0)
    assert np.linalg.norm(lie.so3_log(lie.so3_exp(phi)) - phi) < 1e-14 * max(angle, 1e-3)


@pytest.mark.parametrize("x", [0.0, 1e-24, 1e-14, 9e-5, 1.1e-4, 1e-2, 3.99, 4.01, 9.8, 39.0])
def test_coefficients_to_the_last_digits(x):
    """e_0 ... e_6 against their series in fifty digits, from nothing to a full turn."""
    with mp.workdps(50):
        for k, found in enumerate(lie.entire(x)):
            wanted = mp.nsum(lambda j, k=k: (-mp.mpf(x)) ** j / mp.factorial(2 * j + k), [0, 60])
            assert found == pytest.approx(float(wanted), rel=2e-14, abs=2e-15), k


@pytest.mark.parametrize("angle", ANGLES)
def test_adjoint_is_a_homomorphism(rng, angle):
    X, Y = lie.se_exp(tangent(rng, angle, 3)), lie.se_exp(tangent(rng, 1.0, 3))
    both = lie.se_adjoint(X) @ lie.se_adjoint(Y)
    assert np.allclose(lie.se_adjoint(X @ Y), both, atol=1e-13)
    assert np.allclose(
        lie.se_adjoint(lie.se_inverse(X)) @ lie.se_adjoint(X), np.eye(12), atol=1e-13
    )


@pytest.mark.parametrize("angle", ANGLES)
def test_adjoint_conjugates(rng, angle):
    X = lie.se_exp(tangent(rng, angle, 3))
    xi = tangent(rng, 0.4, 3)
    left = X @ lie.se_exp(xi) @ lie.se_inverse(X)
    assert np.allclose(left, lie.se_exp(lie.se_adjoint(X) @ xi), atol=1e-12)


@pytest.mark.parametrize("angle", ANGLES[:-1])
def test_left_jacobian_is_the_derivative_of_exp(rng, angle):
    xi, h = tangent(rng, angle, 2), 1e-5
    inverse = lie.se_inverse(lie.se_exp(xi))
    columns = [
        lie.se_log(lie.se_exp(xi + h * e) @ inverse) - lie.se_log(lie.se_exp(xi - h * e) @ inverse)
        for e in np.eye(9)
    ]
    assert np.allclose(np.column_stack(columns) / (2 * h), lie.se_left_jacobian(xi), atol=1e-9)


@pytest.mark.parametrize("angle", ANGLES[:-1])
def test_left_jacobian_inverse(rng, angle):
    phi = tangent(rng, angle, 0)
    product = lie.so3_left_jacobian(phi) @ lie.so3_left_jacobian_inverse(phi)
    assert np.allclose(product, np.eye(3), atol=1e-14)


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


def test_log_at_half_a_turn(rng):
    for _ in range(20):
        axis = rng.normal(size=3)
        axis /= np.linalg.norm(axis)
        phi = lie.so3_log(lie.so3_exp(np.pi * axis))
        assert np.isclose(np.linalg.norm(phi), np.pi, atol=1e-12)
        assert np.isclose(abs(phi @ axis), np.pi, atol=1e-12)
