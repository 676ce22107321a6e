"""The lift from the output to the state, and the Kalman update, in dense H, S and K."""

import numpy as np
import pytest
from lie_group import so3_exp
from numpy.testing import assert_allclose

from surefoot.estimator.core.state import NavState, retract
from surefoot.estimator.updates.velocity import lift, update_velocity, velocity_output


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
    wanted = state.pack()
    retract(wanted, dense(state, P)[2] @ z_mean, 0)
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
    update_velocity(mean, covariance, 0, state.v_I, noise * np.eye(3))
    wanted = noise / (1.0 + noise) + kept
    assert_allclose(np.diag(covariance)[3:6], wanted, rtol=1e-6)


def test_a_lift_is_an_exact_observation_and_what_is_put_back(case):
    """Sigma_z+ = 0 is Kalman's update without noise; K Sigma_z+ K^T comes on top of it."""
    state, P, v_I, z_cov = case
    H, _, K = dense(state, P)
    exact = lifted(state, P, v_I, np.zeros(3), np.zeros((3, 3)))[1]
    assert_allclose(exact, (np.eye(15) - K @ H) @ P, atol=1e-12)
    assert_allclose(H @ exact, 0, atol=1e-12)
    found = lifted(state, P, v_I, np.zeros(3), z_cov)[1]
    assert_allclose(found - exact, K @ z_cov @ K.T, atol=1e-12)
    assert_allclose(H @ found @ H.T, z_cov, atol=1e-12)


def test_the_velocity_update_is_kalmans(case):
    """y = X^-1 d + nu with nu ~ N(0, R): K = Sigma H^T (S + R)^-1, Sigma+ = (I - K H) Sigma."""
    state, P, v_I, R = case
    H, S, _ = dense(state, P)
    K, residual = P @ H.T @ np.linalg.inv(S + R), v_I - state.v_I
    wanted = state.pack()
    retract(wanted, K @ residual, 0)
    mean, covariance = state.pack(), P.copy()
    distance = update_velocity(mean, covariance, 0, v_I, R)
    assert_allclose(mean, wanted, atol=1e-12)
    assert_allclose(covariance, (np.eye(15) - K @ H) @ P, atol=1e-12)
    assert_allclose(distance, residual @ np.linalg.solve(S + R, residual), rtol=1e-10)
