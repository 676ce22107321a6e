"""State, right-invariant error, output, lift and Kalman update in the paper's dense matrices."""

import numpy as np
import pytest
from lie_group import group, retracted, so3_exp, wedge
from numpy.testing import assert_allclose, assert_array_equal
from scipy.linalg import expm

from surefoot.estimator.box import box_moments
from surefoot.estimator.core.state import NavState
from surefoot.estimator.initial import InitialStd, start_covariance
from surefoot.estimator.updates.coverage import update_coverage
from surefoot.estimator.updates.velocity import (
    lift,
    update_velocity,
    velocity_memory,
    velocity_output,
)

D = np.array([0.0, 0.0, 0.0, -1.0, 0.0])


"""The paper's d of the velocity output."""


def cross(x):
    return np.array([[0.0, -x[2], x[1]], [x[2], 0.0, -x[0]], [-x[1], x[0], 0.0]])


@pytest.fixture
def rng():
    return np.random.default_rng(12)


@pytest.fixture
def state(rng):
    x = rng.normal(size=(5, 3))
    return NavState(so3_exp(x[0]), x[1], 5 * x[2], 0.1 * x[3], 0.1 * x[4])


def test_a_state_is_packed_in_the_papers_order(state):
    mean = state.pack()
    wanted = [*state.R_GI, state.v_GI, state.p_GI, state.b_a, state.b_g]
    assert_array_equal(mean, wanted)
    assert_array_equal(NavState.unpack(mean).pack(), mean)


def test_the_error_is_right_invariant(state, rng):
    """eta = X_bar X^-1 = exp(xi^), and a common motion T from the right leaves it as it is."""
    xi = rng.normal(size=9)
    mean = retracted(state.pack(), np.r_[xi, np.zeros(6)])
    estimate, truth = group(state.pack()), group(mean)
    assert_allclose(estimate @ np.linalg.inv(truth), expm(wedge(xi)), atol=1e-12)
    T = expm(wedge(rng.normal(size=9)))
    moved = (estimate @ T) @ np.linalg.inv(truth @ T)
    assert_allclose(moved, expm(wedge(xi)), atol=1e-12)


def test_boxplus_is_the_papers(state, rng):
    """X = exp(-xi^) X_bar and b = b_bar - delta b, b_a before b_g."""
    delta = rng.normal(size=15)
    mean = retracted(state.pack(), delta)
    assert_allclose(group(mean), expm(-wedge(delta[:9])) @ group(state.pack()), atol=1e-12)
    assert_allclose(mean[5], state.b_a - delta[9:12], atol=1e-15)
    assert_allclose(mean[6], state.b_g - delta[12:], atol=1e-15)


def test_the_start_is_as_uncertain_as_its_plain_deviations_say(state):
    """Plain errors are v_bar - v = xi_v - [v]x xi_R, p likewise: of these the deviations are."""
    std = InitialStd(tilt=0.02, yaw=0.01, velocity=0.3, position=0.5, b_a=0.1, b_g=0.01)
    plain = np.eye(15)
    plain[3:6, :3], plain[6:9, :3] = -cross(state.v_GI), -cross(state.p_GI)
    wanted = np.diag(np.r_[0.02, 0.02, 0.01, np.repeat([0.3, 0.5, 0.1, 0.01], 3)])
    assert_allclose(plain @ start_covariance(state, std) @ plain.T, wanted**2, atol=1e-14)


def test_the_output_is_the_velocity_in_the_imus_frame(state):
    """y = X^-1 d = (v_I, -1, 0)."""
    wanted = np.r_[state.v_I, -1.0, 0.0]
    assert_allclose(np.linalg.inv(group(state.pack())) @ D, wanted, atol=1e-13)


def test_the_feasible_set_is_the_papers(state, rng):
    """H delta X = Pi X_bar^-1 xi^ d, its first order, and l and u about -Pi (X_bar^-1 d - y)."""
    mean, P = state.pack(), rng.normal(size=(15, 15))
    P = 0.04 * P @ P.T
    v_I, epsilon = state.v_I + rng.normal(size=3), np.array([0.3, 0.8, 0.5])
    inverse, y = np.linalg.inv(group(mean)), np.r_[v_I, -1.0, 0.0]
    H = np.zeros((3, 15))
    H[:, :9] = np.column_stack([(inverse @ wedge(e) @ D)[:3] for e in np.eye(9)])
    delta = 1e-6 * rng.normal(size=15)
    change = (np.linalg.inv(group(retracted(mean, delta))) @ D - inverse @ D)[:3]
    assert_allclose(change, H @ delta, atol=1e-10)
    PHt, S, residual = np.empty((15, 3)), np.empty((3, 3)), np.empty(3)
    velocity_output(mean, P, 0, v_I, PHt, S, residual)
    assert_allclose(PHt, P @ H.T, atol=1e-12)
    assert_allclose(S, H @ P @ H.T, atol=1e-12)
    middle = -(inverse @ D - y)[:3]
    assert_allclose(residual, middle, atol=1e-13)
    log_pi, _, _ = box_moments(np.zeros(3), S, middle - epsilon, middle + epsilon)
    pi = update_coverage(mean, P, v_I, epsilon, 0.8, 1, velocity_memory())
    assert_allclose(pi, np.exp(log_pi), rtol=1e-8)


@pytest.fixture
def case():
    """A state, its covariance, a measured velocity, and a covariance (3, 3) to go with it."""
    rng = np.random.default_rng(4)
    state = NavState(so3_exp(rng.normal(size=3)), *rng.normal(size=(2, 3)))
    A, B = 0.3 * rng.normal(size=(15, 15)), 0.2 * rng.normal(size=(3, 3))
    return state, A @ A.T + 1e-3 * np.eye(15), state.v_I + np.array([0.3, -0.2, 0.5]), B @ B.T


def dense(state, P):
    """H, S and K as the paper prints them."""
    H = np.zeros((3, 15))
    H[:, 3:6] = -state.R_GI.T
    S = H @ P @ H.T
    return H, S, P @ H.T @ np.linalg.inv(S)


def lifted(state, P, v_I, z_mean, z_cov):
    """Packed mean and covariance after `lift`."""
    mean, covariance = state.pack(), P.copy()
    PHt, S, residual = np.empty((15, 3)), np.empty((3, 3)), np.empty(3)
    velocity_output(mean, covariance, 0, v_I, PHt, S, residual)
    lift(mean, covariance, 0, PHt, S, z_mean, z_cov)
    return mean, covariance


def test_the_mean_is_lifted_by_the_gain(case):
    """mu+ = K (mu_z+ - mu_z) about a prior of mean zero, then X = X_bar boxplus mu+."""
    state, P, v_I, z_cov = case
    z_mean = np.array([0.2, -0.1, 0.3])
    wanted = retracted(state.pack(), dense(state, P)[2] @ z_mean)
    assert_allclose(lifted(state, P, v_I, z_mean, z_cov)[0], wanted, atol=1e-12)


def test_the_covariance_is_lifted_by_the_gain(case):
    """Sigma+ = Sigma + K (Sigma_z+ - S) K^T."""
    state, P, v_I, z_cov = case
    _, S, K = dense(state, P)
    found = lifted(state, P, v_I, np.zeros(3), z_cov)[1]
    assert_allclose(found, P + K @ (z_cov - S) @ K.T, atol=1e-12)


@pytest.mark.parametrize(("relative", "kept"), [(1.05e-8, 0.0), (0.95e-8, 1e-12)])
def test_of_a_noise_below_a_hundred_millionth_something_is_kept(relative, kept):
    """Of the trace of the prior, in the output: there the posterior is a difference of eight
    digits, and a share of the prior is added to it."""
    state, P = NavState(), np.diag(np.repeat([1e-2, 1.0, 1.0, 1e-4, 1e-4], 3))
    noise = 3.0 * relative
    mean, covariance = state.pack(), P.copy()
    update_velocity(mean, covariance, 0, state.v_I, noise * np.eye(3), velocity_memory())
    wanted = noise / (1.0 + noise) + kept
    assert_allclose(np.diag(covariance)[3:6], wanted, rtol=1e-6)


def test_the_velocity_update_is_kalmans(case):
    """y = X^-1 d + nu with nu ~ N(0, R): K = Sigma H^T (S + R)^-1, Sigma+ = (I - K H) Sigma."""
    state, P, v_I, R = case
    H, S, _ = dense(state, P)
    K, residual = P @ H.T @ np.linalg.inv(S + R), v_I - state.v_I
    wanted = retracted(state.pack(), K @ residual)
    mean, covariance = state.pack(), P.copy()
    distance = update_velocity(mean, covariance, 0, v_I, R, velocity_memory())
    assert_allclose(mean, wanted, atol=1e-12)
    assert_allclose(covariance, (np.eye(15) - K @ H) @ P, atol=1e-12)
    assert_allclose(distance, residual @ np.linalg.solve(S + R, residual), rtol=1e-10)
