"""Theorem 1 and its moments against direct integration, and the update's limits."""

import numpy as np
import pytest
from lie_group import so3_exp
from numpy.testing import assert_allclose, assert_array_equal
from scipy.integrate import quad

from surefoot.estimator.core.state import NavState, retract
from surefoot.estimator.filter import InvariantFilter
from surefoot.estimator.updates.coverage import posterior_moments, update_coverage
from surefoot.estimator.updates.velocity import (
    SIGMAS,
    UNLIMITED,
    fresh_counts,
    is_outlier,
    note_velocity,
    update_velocity,
    update_velocity_checked,
    velocity_output,
)

WIDE = 60.0


def posterior(mean, cov, lower, upper, gamma):
    out_mean, out_cov = np.empty(3), np.empty((3, 3))
    mean, cov, lower, upper = (np.array(x, dtype=float) for x in (mean, cov, lower, upper))
    pi = posterior_moments(mean, cov, lower, upper, gamma, out_mean, out_cov)
    return pi, out_mean, out_cov


@pytest.mark.parametrize(
    ("centre", "half", "gamma"),
    [(0.0, 0.3, 0.8), (1.5, 0.5, 0.8), (4.0, 0.5, 0.9), (0.2, 1.2, 0.999), (8.0, 1.0, 0.7)],
)
def test_one_dimension_is_theorem_1_integrated(centre, half, gamma):
    """eq. posterior_piecewise, its density integrated as it is written, on one axis."""
    variance = 1.7
    lower, upper = centre - half, centre + half

    def prior(z):
        return np.exp(-0.5 * z * z / variance) / np.sqrt(2 * np.pi * variance)

    def integral(f, pieces):
        return sum(quad(f, a, b, epsabs=1e-13, epsrel=1e-11, limit=400)[0] for a, b in pieces)

    outside = [(-30.0, min(lower, 0.0)), (min(lower, 0.0), lower), (upper, upper + 5.0),
               (upper + 5.0, 40.0)]  # fmt: skip
    outside = [(a, b) for a, b in outside if b > a]
    pi = integral(prior, [(lower, upper)])

    def moment(n):
        inside = integral(lambda z: z**n * prior(z), [(lower, upper)])
        beyond = integral(lambda z: z**n * prior(z), outside)
        return gamma / pi * inside + (1 - gamma) / (1 - pi) * beyond

    found, mean, cov = posterior(
        np.zeros(3),
        np.diag([variance, 1.0, 1.0]),
        [lower, -WIDE, -WIDE],
        [upper, WIDE, WIDE],
        gamma,
    )
    assert_allclose(found, pi, rtol=1e-10)
    assert_allclose(moment(0), 1.0, rtol=1e-9)
    assert_allclose(mean, [moment(1), 0, 0], atol=1e-8)
    assert_allclose(cov, np.diag([moment(2) - moment(1) ** 2, 1, 1]), atol=1e-8)


def test_three_dimensions_are_the_papers_complement_moments():
    """eqs. complement_moments and moment_matching as printed, from sampled truncation moments."""
    rng = np.random.default_rng(1)
    A = rng.normal(size=(3, 3))
    cov = A @ A.T + 0.2 * np.eye(3)
    mean = np.array([0.1, -0.2, 0.3])
    lower, upper, gamma = mean + np.array([-0.5, 0.1, -1.0]), mean + np.array([0.9, 2.0, 0.4]), 0.8
    z = rng.multivariate_normal(mean, cov, size=4_000_000)
    inside = np.all((z >= lower) & (z <= upper), axis=1)
    pi = inside.mean()
    m_c, M_c = z[inside].mean(axis=0), z[inside].T @ z[inside] / inside.sum()
    m_o = (mean - pi * m_c) / (1 - pi)
    M_o = (cov + np.outer(mean, mean) - pi * M_c) / (1 - pi)
    m = gamma * m_c + (1 - gamma) * m_o
    S = gamma * M_c + (1 - gamma) * M_o - np.outer(m, m)
    found, mean_plus, cov_plus = posterior(mean, cov, lower, upper, gamma)
    assert_allclose(found, pi, atol=1e-3)
    assert_allclose(mean_plus, m, atol=5e-3)
    assert_allclose(cov_plus, S, atol=2e-2)


def test_mass_of_gamma_or_more_changes_nothing():
    cov = np.eye(3)
    pi, mean, out = posterior(np.zeros(3), cov, [-5, -5, -5], [5, 5, 5], 0.8)
    assert pi > 0.99
    assert_allclose(mean, 0, atol=0)
    assert_allclose(out, cov, atol=0)


def test_limits_of_pi():
    """pi -> 0: all of gamma moves to the box. pi -> gamma -> 1: the posterior meets the prior."""
    cov = np.diag([1.0, 0.5, 2.0])
    pi, mean, out = posterior(np.zeros(3), cov, [40, -1, -1], [41, 1, 1], 0.8)
    assert pi < 1e-300
    assert 0.8 * 40 < mean[0] < 0.8 * 41
    assert np.linalg.eigvalsh(out).min() > 0
    box = np.full(3, 9.0)
    pi, mean, out = posterior(np.zeros(3), np.eye(3), -box, box, 1 - 1e-16)
    assert_allclose(out, np.eye(3), atol=1e-12)
    assert_allclose(mean, 0, atol=1e-12)


def test_outliers_are_rejected_so_often_in_a_row_and_no_more():
    """Three of them; the fourth says that the estimate is wrong. One that fits counts anew."""
    S, most, counts = np.diag([0.04, 0.01, 0.01]), np.array([0.1, 0.2, 0.3]), fresh_counts()
    fits = most + 0.999 * SIGMAS * np.sqrt(np.diag(S))
    for axis in range(3):
        beyond = fits * np.where(np.arange(3) == axis, -1.002, 1.0)
        found = [is_outlier(S, beyond, most, 3, counts) for _ in range(5)]
        assert found == [True, True, True, False, False]
        assert not is_outlier(S, fits, most, 3, counts)


def test_output_jacobian_by_differences():
    """H = [0 -R^T 0 0 0 | -I]: sign and place, for a state with a persistent error."""
    rng = np.random.default_rng(2)
    mean = NavState(so3_exp(rng.normal(size=3)), rng.normal(size=3)).pack(1)
    mean[7] = rng.normal(size=3)
    A = rng.normal(size=(18, 18))
    P = A @ A.T
    h = 1e-6

    def measured(delta):
        other = mean.copy()
        retract(other, delta, 0)
        return other[:3].T @ other[3] + other[7]

    H = np.column_stack([(measured(h * e) - measured(-h * e)) / (2 * h) for e in np.eye(18)])
    PHt, S, residual = np.empty((18, 3)), np.empty((3, 3)), np.empty(3)
    velocity_output(
        mean, P, 0, measured(np.zeros(18)) + np.array([0.1, 0.2, 0.3]), PHt, S, residual
    )
    assert_allclose(H[:, :3], 0, atol=1e-9)
    assert_allclose(H[:, 3:6], -mean[:3].T, atol=1e-9)
    assert_allclose(PHt, P @ H.T, atol=1e-7)
    assert_allclose(S, H @ P @ H.T, atol=1e-7)
    assert_allclose(residual, [0.1, 0.2, 0.3], atol=1e-14)


def test_lift_keeps_the_conditional_and_replaces_the_marginal():
    """eqs. lift_mean and lift_cov with a dense H, K and S, as the paper prints them."""
    rng = np.random.default_rng(3)
    state = NavState(so3_exp(rng.normal(size=3)), rng.normal(size=3))
    A = 0.3 * rng.normal(size=(15, 15))
    P = A @ A.T + 1e-3 * np.eye(15)
    one = InvariantFilter(state, P)
    v_I = state.v_I + np.array([0.3, -0.2, 0.5])
    epsilon, gamma = np.array([0.1, 0.2, 0.3]), 0.8
    pi = one.update_coverage(v_I, epsilon, gamma)
    H = np.zeros((3, 15))
    H[:, 3:6] = -state.R_GI.T
    S = H @ P @ H.T
    K = P @ H.T @ np.linalg.inv(S)
    r = v_I - state.v_I
    wanted_pi, z_mean, z_cov = posterior(np.zeros(3), S, r - epsilon, r + epsilon, gamma)
    assert_allclose(pi, wanted_pi, rtol=1e-7)
    assert_allclose(one.covariance, P + K @ (z_cov - S) @ K.T, atol=1e-8)
    mean = state.pack()
    retract(mean, K @ z_mean, 0)
    assert_allclose(one.state.v_GI, mean[3], atol=1e-7)
    assert_allclose(one.state.b_a, mean[5], atol=1e-7)
    moved = np.abs(one.state.v_I - v_I)
    assert np.all(moved < np.abs(r)), "the estimate moves towards the statement"


def test_covariance_survives_a_hundred_thousand_updates():
    """Outliers of 40 sigma, dropouts and no process noise at all: PD and finite to the end."""
    rng = np.random.default_rng(6)
    mean, P, counts, steps = NavState().pack(), np.eye(15) * 0.01, fresh_counts(), 100_000
    P[9:, 9:] *= 1e-2
    epsilon = np.array([0.05, 0.2, 0.05])
    noise = rng.normal(size=(steps, 3)) * 0.04
    for k in range(steps):
        v = noise[k]
        if k % 1000 == 500:
            v = v + 40 * np.sqrt(P[3, 3] + 1e-4) * np.array([1.0, -1.0, 0.3])
        if k % 5000 < 4500:
            update_coverage(mean, P, v, epsilon, 0.8, 1, UNLIMITED, 1, counts)
        P[3, 3] += 1e-7
        if k % 10_000 == 9_999:
            assert np.all(np.isfinite(P))
            assert np.all(np.isfinite(mean))
            np.linalg.cholesky(P)
    assert np.abs(mean[3]).max() < 0.5


def test_the_update_moves_the_packed_state_into_the_bounds():
    """Of a velocity known to 0.1 m/s, said to be 0.5 m/s away with bounds of 0.05."""
    mean, P = NavState().pack(), np.eye(15) * 0.01
    v_I, epsilon = np.array([0.5, 0.0, 0.0]), np.array([0.05, 1.0, 1.0])
    pi = update_coverage(mean, P, v_I, epsilon, 0.99, 1, UNLIMITED, 1, fresh_counts())
    assert pi < 1e-5
    assert 0.4 < mean[3, 0] < 0.5
    assert P[3, 3] < 0.01
    again = mean.copy()
    options = 0.99, 1, UNLIMITED, 1, fresh_counts()
    assert update_coverage(again, P.copy(), v_I, epsilon, *options) > pi


def test_what_is_noted_of_a_velocity_is_what_its_update_uses():
    """With a persistent error in the state, with contacts, and with neither."""
    rng = np.random.default_rng(7)
    for extras, contacts in ((0, 0), (1, 0), (2, 2)):
        n = 15 + 3 * extras
        mean = NavState(so3_exp(rng.normal(size=3)), rng.normal(size=3)).pack(extras)
        mean[7:] = rng.normal(size=(extras, 3))
        A, v_I, R = rng.normal(size=(n, n)), rng.normal(size=3), np.diag([0.1, 0.2, 0.3])
        PHt, S, residual = np.empty((n, 3)), np.empty((3, 3)), np.empty(3)
        velocity_output(mean, A @ A.T, contacts, v_I, PHt, S, residual)
        note = np.empty((7, 3))
        note_velocity(mean, A @ A.T, contacts, v_I, R, note)
        assert_allclose(note, np.vstack([residual, S, R]), atol=1e-12)


def test_a_checked_velocity_update_is_the_plain_one_or_none():
    rng = np.random.default_rng(8)
    A = rng.normal(size=(15, 15))
    state, P, R = NavState(v_GI=np.ones(3)).pack(), A @ A.T + np.eye(15), np.eye(3)
    mean, cov = state.copy(), P.copy()
    wanted = update_velocity(mean, cov, 0, np.zeros(3), R)
    free = UNLIMITED, 1, fresh_counts()
    found, spread = state.copy(), P.copy()
    assert update_velocity_checked(found, spread, np.zeros(3), R, *free) == wanted > 0.0
    assert_array_equal(found, mean)
    assert_array_equal(spread, cov)
    for v_I, noise in (
        (np.zeros(2), R), (np.zeros(4), R), (np.full(3, 1e9), R), (np.full(3, np.nan), R),
        (np.zeros(3), -R), (np.zeros(3), np.eye(2)),
    ):  # fmt: skip
        found, spread = state.copy(), P.copy()
        assert update_velocity_checked(found, spread, v_I, noise, *free) == -1.0
        assert_array_equal(found, state)
        assert_array_equal(spread, P)
