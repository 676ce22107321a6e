"""The update's moments against the paper's own formulas in sixty digits, its limits and outliers.

The paper forms the complement's moments by subtraction (eq. complement_moments); in doubles that
loses every digit as pi -> 1 and divides nothing by nothing as pi -> 0. With mpmath it is exact.
"""

import mpmath as mp
import numpy as np
import pytest
from lie_group import differences, retracted, so3_exp
from numpy.testing import assert_allclose, assert_array_equal
from theorem import posterior, truncated

from surefoot.estimator.core.state import NavState
from surefoot.estimator.updates.coverage import FLOOR, update_coverage
from surefoot.estimator.updates.velocity import (
    SIGMAS,
    inverse_3,
    is_outlier,
    update_velocity,
    update_velocity_checked,
    velocity_memory,
    velocity_output,
)


def test_outliers_are_rejected_so_often_in_a_row_and_no_more():
    """Three of them; the fourth says that the estimate is wrong. One that fits counts anew."""
    S, most = np.diag([0.04, 0.01, 0.01]), np.array([0.1, 0.2, 0.3])
    memory = velocity_memory(most, 3)
    fits = most + 0.999 * SIGMAS * np.sqrt(np.diag(S))
    for axis in range(3):
        beyond = fits * np.where(np.arange(3) == axis, -1.002, 1.0)
        found = [is_outlier(S, beyond, memory) for _ in range(5)]
        assert found == [True, True, True, False, False]
        assert not is_outlier(S, fits, memory)


def test_output_jacobian_by_differences():
    """H = [0 -R^T 0 0 0 | -I]: sign and place, for a state with a persistent error."""
    rng = np.random.default_rng(2)
    mean = NavState(so3_exp(rng.normal(size=3)), rng.normal(size=3)).pack(1)
    mean[7] = rng.normal(size=3)
    A = rng.normal(size=(18, 18))
    P = A @ A.T

    def measured(delta):
        other = retracted(mean, delta)
        return other[:3].T @ other[3] + other[7]

    H = differences(measured, 18)
    PHt, S, residual = np.empty((18, 3)), np.empty((3, 3)), np.empty(3)
    velocity_output(
        mean, P, 0, measured(np.zeros(18)) + np.array([0.1, 0.2, 0.3]), PHt, S, residual
    )
    assert_allclose(H[:, :3], 0, atol=1e-9)
    assert_allclose(H[:, 3:6], -mean[:3].T, atol=1e-9)
    assert_allclose(PHt, P @ H.T, atol=1e-7)
    assert_allclose(S, H @ P @ H.T, atol=1e-7)
    assert_allclose(residual, [0.1, 0.2, 0.3], atol=1e-14)


def test_a_checked_velocity_update_is_the_plain_one_or_none():
    rng = np.random.default_rng(8)
    A = rng.normal(size=(15, 15))
    state, P, R = NavState(v_GI=np.ones(3)).pack(), A @ A.T + np.eye(15), np.eye(3)
    mean, cov = state.copy(), P.copy()
    memory = velocity_memory()
    wanted = update_velocity(mean, cov, 0, np.zeros(3), R, memory)
    found, spread = state.copy(), P.copy()
    assert update_velocity_checked(found, spread, 0, np.zeros(3), R, *memory[:3]) == wanted > 0.0
    assert_array_equal(found, mean)
    assert_array_equal(spread, cov)
    for v_I, noise in (
        (np.zeros(2), R), (np.zeros(4), R), (np.full(3, 1e9), R), (np.full(3, np.nan), R),
        (np.zeros(3), -R), (np.zeros(3), np.eye(2)),
    ):  # fmt: skip
        found, spread = state.copy(), P.copy()
        assert update_velocity_checked(found, spread, 0, v_I, noise, *memory[:3]) == -1.0
        assert_array_equal(found, state)
        assert_array_equal(spread, P)


INF = np.inf


def as_printed(mean, deviations, lower, upper, gamma):
    """Eqs. complement_moments and moment_matching for independent axes, in mpmath."""
    given = zip(mean, deviations, lower, upper, strict=True)
    masses = [truncated(*(mp.mpf(float(x)) for x in one)) for one in given]
    axes = [(mass, first / mass, second / mass) for mass, first, second in masses]
    pi = axes[0][0] * axes[1][0] * axes[2][0]
    m = [mp.mpf(float(x)) for x in mean]
    prior = mp.matrix(3, 3)
    inside = mp.matrix(3, 3)
    for i in range(3):
        for j in range(3):
            prior[i, j] = m[i] * m[j] + (mp.mpf(float(deviations[i])) ** 2 if i == j else 0)
            inside[i, j] = axes[i][2] if i == j else axes[i][1] * axes[j][1]
    gamma = mp.mpf(float(gamma))
    if pi >= gamma:
        return pi, m, prior - mp.matrix(m) * mp.matrix(m).T
    outside_mean = [(m[i] - pi * axes[i][1]) / (1 - pi) for i in range(3)]
    outside = (prior - pi * inside) / (1 - pi)
    plus = mp.matrix([gamma * axes[i][1] + (1 - gamma) * outside_mean[i] for i in range(3)])
    return pi, list(plus), gamma * inside + (1 - gamma) * outside - plus * plus.T


def numbers(matrix):
    return np.array(matrix.tolist(), dtype=float)


SPREAD = np.array([0.3, 0.05, 1.7])


FAR = {
    "one axis 40 sigma away": ([40, -1, -1], [41, 1, 1]),
    "three axes 40 sigma away": ([40, -42, 40], [41, -40, 44]),
    "one axis 300 sigma away": ([-0.5, 300, -2], [0.5, 300.5, 3]),
    "three axes 300 sigma away": ([300, 300, -310], [301, 310, -300]),
    "a sliver 40 sigma away": ([40, -1, -1], [40 + 1e-9, 1, 1]),
    "half a space": ([7, -INF, -INF], [INF, INF, INF]),
    "nothing cut off but 1e-12": ([-7.1, -7.3, -INF], [7.2, INF, 7.1]),
    "nothing cut off but 1e-15": ([-8.0, -9.0, -INF], [8.1, INF, 8.5]),
}


@pytest.mark.parametrize("gamma", [0.5, 0.8, 1 - 1e-9, 1 - 1e-13, 1 - 2e-16])
@pytest.mark.parametrize("name", FAR)
def test_far_boxes_and_boxes_that_hold_all(name, gamma):
    """pi from exp(-135 000) to 1 - 1e-15, and gamma up to the last double below one."""
    mean = np.array([0.02, -0.01, 0.5])
    lower, upper = (mean + SPREAD * np.array(b, dtype=float) for b in FAR[name])
    with mp.workdps(60):
        pi, wanted_mean, wanted_cov = as_printed(mean, SPREAD, lower, upper, gamma)
        found, found_mean, found_cov = posterior(mean, np.diag(SPREAD**2), lower, upper, gamma)
        assert_allclose(found, float(pi), rtol=1e-9, atol=0)
        wanted_mean = np.array([float(x) for x in wanted_mean])
        wanted_cov = numbers(wanted_cov)
    scale = np.maximum(np.abs(wanted_mean - mean), SPREAD)
    # Where 1 - pi is 1e-12, pi itself has four digits of it left: what is lost moves nothing.
    assert_allclose((found_mean - wanted_mean) / scale, 0, atol=1e-10)
    deviations = np.sqrt(np.diag(wanted_cov))
    assert_allclose((found_cov - wanted_cov) / np.outer(deviations, deviations), 0, atol=1e-9)
    assert np.linalg.eigvalsh(found_cov).min() > 0


@pytest.mark.parametrize("box", [([-1, -1, -1], [1, 1, 1]), ([0.5, -2, -3], [2, 2, 3]),
                                 ([-6, -6, -6], [6, 6, 6.5])])  # fmt: skip
@pytest.mark.parametrize("step", [-1e-12, -1e-15, 0.0, 1e-15, 1e-12])
def test_pi_next_to_gamma(box, step):
    """Just above gamma nothing moves at all; just below, by no more than the step allows."""
    mean = np.zeros(3)
    lower, upper = (SPREAD * np.array(b, dtype=float) for b in box)
    pi = posterior(mean, np.diag(SPREAD**2), lower, upper, 0.5)[0]
    gamma = pi - step
    if not 0 < gamma < 1:
        pytest.skip("gamma is one in doubles")
    found, found_mean, found_cov = posterior(mean, np.diag(SPREAD**2), lower, upper, gamma)
    assert found == pi
    if step >= 0:
        assert_array_equal(found_mean, mean)
        assert_array_equal(found_cov, np.diag(SPREAD**2))
        return
    alpha = (gamma - pi) / (1 - pi)
    assert np.abs(found_mean / SPREAD).max() <= 3.0 * alpha
    assert np.abs(np.diag(found_cov) / SPREAD**2 - 1).max() <= 3.0 * alpha + 1e-15


@pytest.mark.parametrize("correlation", [0.999, 1 - 1e-6, 1 - 1e-10])
@pytest.mark.parametrize(("lower", "upper"), [(0.5, 1.5), (40.0, 41.0), (-7.0, 7.0)])
def test_nearly_singular_covariances(correlation, lower, upper):
    """One axis is bounded, the others follow by regression: exact in sixty digits."""
    cov = np.array([[1.0, correlation, 0.3], [correlation, 1.0, 0.3], [0.3, 0.3, 2.0]])
    gamma = 0.8 if upper != 7.0 else 1 - 1e-13
    free = np.full(2, INF)
    found, found_mean, found_cov = posterior(
        np.zeros(3), cov, np.r_[lower, -free], np.r_[upper, free], gamma
    )
    with mp.workdps(60):
        pi, mean, one = as_printed(
            np.zeros(3), np.ones(3), np.r_[lower, -free], np.r_[upper, free], gamma
        )
        C = mp.matrix(cov.tolist())
        follow = C[:, 0]
        wanted_mean = np.array([float(mean[0] * follow[i]) for i in range(3)])
        wanted_cov = numbers(C + follow * follow.T * (one[0, 0] - 1))
        assert_allclose(found, float(pi), rtol=1e-9)
    assert_allclose(found_mean, wanted_mean, atol=1e-8 * max(1.0, abs(wanted_mean[0])))
    assert_allclose(found_cov, wanted_cov, atol=1e-8 * max(1.0, wanted_cov[0, 0]))
    assert np.linalg.eigvalsh(found_cov).min() > -1e-15 * wanted_cov[0, 0]


@pytest.mark.parametrize("spread", [1e-3, 1.0, 1e3])
def test_the_floor_keeps_a_flat_velocity_covariance_usable(spread):
    """S of rank one, of rank none, and far statements on it: finite, positive semidefinite."""
    rng = np.random.default_rng(4)
    direction = rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    epsilon, memory = np.array([0.05, 0.2, 0.05]), velocity_memory()
    for flat in (spread**2 * np.outer(direction, direction), np.zeros((3, 3))):
        mean, P = NavState().pack(), 1e-6 * np.eye(15)
        P[3:6, 3:6] = flat
        for v_I in (np.zeros(3), 0.1 * spread * direction, 40.0 * spread * rng.normal(size=3)):
            for _ in range(20):
                pi = update_coverage(mean, P, v_I, epsilon, 0.8, 1, memory)
                assert 0.0 <= pi <= 1.0
                assert np.isfinite(mean).all()
                least = np.linalg.eigvalsh(P).min()
                assert least > -1e-9 * spread**2 - FLOOR**2


@pytest.mark.parametrize("thin", [1.0, 1e-3, 1e-6, 1e-9])
def test_the_inverse_of_s_keeps_its_digits(thin):
    """d d^T + e I with e down to the floor: its inverse (Sherman and Morrison) in any units."""
    rng = np.random.default_rng(1)
    for _ in range(200):
        d = rng.uniform(0.5, 2.0, 3) * rng.choice([-1.0, 1.0], 3)
        e = thin * (d @ d)
        wanted = (np.eye(3) - np.outer(d, d) / (e + d @ d)) / e
        units = 10.0 ** rng.integers(-4, 5, 3)
        found = np.empty((3, 3))
        inverse_3((np.outer(d, d) + e * np.eye(3)) * np.outer(units, units), found)
        error = found * np.outer(units, units) - wanted
        assert np.abs(error).max() < 1e-14 / thin * np.abs(wanted).max()


def test_the_floor_is_below_what_matters():
    """A micrometre a second and 1e-10 of S: moments move by less than a hundred millionth."""
    P = np.diag(np.r_[np.full(3, 1e-4), 0.02, 0.03, 0.01, np.full(9, 1e-3)])
    S, PHt, residual = np.empty((3, 3)), np.empty((15, 3)), np.empty(3)
    velocity_output(NavState().pack(), P, 0, np.zeros(3), PHt, S, residual)
    box = np.array([-0.05, 0.02, -0.1]), np.array([0.1, 0.3, 0.2])
    plain = posterior(np.zeros(3), S, *box, 0.8)
    floor = (FLOOR**2 + 1e-10 * np.trace(S)) * np.eye(3)
    lifted = posterior(np.zeros(3), S + floor, *box, 0.8)
    for a, b in zip(plain, lifted, strict=True):
        assert_allclose(a, b, atol=1e-8)
