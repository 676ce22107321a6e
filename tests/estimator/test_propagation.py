"""The IMU step against the group's own differences, and against a fine integration."""

import numpy as np
import pytest
from lie_group import differences, error, retracted, so3_exp
from numpy.testing import assert_allclose

from surefoot.estimator.core import lie
from surefoot.estimator.core.propagation import gamma_derivatives, propagate
from surefoot.estimator.core.state import FilterNoise, NavState
from surefoot.sim.common.gravity import GRAVITY

SILENT = np.zeros((4, 3))


@pytest.fixture
def case():
    rng = np.random.default_rng(3)
    state = NavState(
        so3_exp(rng.normal(size=3)),
        rng.normal(size=3),
        5 * rng.normal(size=3),
        0.1 * rng.normal(size=3),
        0.1 * rng.normal(size=3),
    )
    return state.pack(), 3 * rng.normal(size=3), 5 * rng.normal(size=3) + [0, 0, GRAVITY], rng


def step(mean, covariance, gyro, accel, dt, noise=SILENT):
    n = len(covariance)
    propagate(mean, covariance, gyro, accel, dt, noise, np.zeros((n, 6)), np.zeros((n - 15, 3)))
    return mean


@pytest.mark.parametrize("dt", [1e-3, 0.05])
def test_transition_is_the_derivative_of_the_step(case, dt):
    mean, gyro, accel, _ = case
    after = step(mean.copy(), np.eye(15), gyro, accel, dt)

    def moved(delta):
        return error(after, step(retracted(mean, delta), np.eye(15), gyro, accel, dt))

    Phi = differences(moved, 15)
    # The kernel hides Phi: Sigma = a a^T shows Phi a for each direction.
    rng = case[3]
    A = rng.normal(size=(15, 15))
    covariance = A @ A.T
    step(mean.copy(), covariance, gyro, accel, dt)
    assert_allclose(covariance, Phi @ A @ A.T @ Phi.T, atol=3e-7)


def test_noise_is_anisotropic_and_enters_as_the_biases_do(case):
    mean, gyro, accel, _ = case
    dt = 0.01
    noise = FilterNoise(
        np.array([0.1, 0.2, 0.3]), np.array([0.5, 0.1, 0.2]), 0.01, np.array([0.0, 0.1, 0.2])
    )
    after = mean.copy()
    Q = np.zeros((15, 15))
    step(after, Q, gyro, accel, dt, noise.packed())

    def moved(more):
        return error(after, step(mean.copy(), np.eye(15), gyro + more[3:], accel + more[:3], dt))

    B = differences(moved, 6)
    wanted = B @ np.diag(noise.packed()[:2].ravel() / dt) @ B.T
    wanted[9:, 9:] += np.diag(noise.packed()[2:].ravel() * dt)
    assert_allclose(Q, wanted, atol=1e-9)


def test_mean_is_exact_for_a_constant_sample(case):
    """One step of 0.2 s equals ten thousand small Euler steps extrapolated."""
    mean, gyro, accel, _ = case
    one = mean.copy()
    step(one, np.eye(15), gyro, accel, 0.2)
    many = mean.copy()
    for _ in range(100):
        step(many, np.eye(15), gyro, accel, 0.002)
    assert_allclose(one, many, atol=1e-12)
    ends = []
    for n in (2000, 4000):
        R, v, p, dt = mean[:3].copy(), mean[3].copy(), mean[4].copy(), 0.2 / n
        half = so3_exp((gyro - mean[6]) * dt / 2)
        for _ in range(n):
            R = R @ half
            a = R @ (accel - mean[5]) - [0, 0, GRAVITY]
            p += v * dt + 0.5 * a * dt * dt
            v += a * dt
            R = R @ half
        ends.append(np.concatenate([R.ravel(), v, p]))
    # The midpoint rule is of second order: Richardson takes its error out.
    assert_allclose(one[:5].ravel(), (4 * ends[1] - ends[0]) / 3, atol=1e-9)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-7, 1e-2, 1.0, 2.5])
def test_gamma_derivatives(angle):
    rng = np.random.default_rng(0)
    phi, a = rng.normal(size=3), rng.normal(size=3)
    phi *= angle / np.linalg.norm(phi)
    D1, D2 = np.empty((3, 3)), np.empty((3, 3))
    gamma_derivatives(phi, a, lie.entire(phi @ phi), D1, D2)

    def products(x):
        g = [np.empty((3, 3)) for _ in range(3)]
        lie.gammas(x, *g)
        return g[1] @ a, g[2] @ a

    for m, D in enumerate((D1, D2)):
        difference = differences(lambda delta, m=m: products(phi + delta)[m], 3, 1e-5)
        assert_allclose(D, difference, atol=1e-9)


def test_tiny_rates_lose_no_digits(case):
    """At 1e-5 rad/s and below the derivative by the bias is smooth: the series are in use."""
    mean, _, accel, rng = case
    A = rng.normal(size=(15, 15))
    results = []
    for rate in (0.0, 1e-12, 1e-9):
        covariance = A @ A.T
        step(mean.copy(), covariance, mean[6] + rate, accel, 0.002)
        results.append(covariance)
    assert_allclose(results[1], results[0], rtol=1e-10, atol=1e-10)
    assert_allclose(results[2], results[0], rtol=1e-8, atol=1e-8)


def test_the_error_dynamics_are_hartleys(case):
    """dSigma/dt = A Sigma + Sigma A^T + N Q N^T for dt -> 0, with the A and N of Hartley 2020."""
    mean, gyro, accel, rng = case
    R = mean[:3]
    A = np.zeros((15, 15))
    A[3:6, :3], A[6:9, 3:6] = lie.hat(np.array([0.0, 0.0, -GRAVITY])), np.eye(3)
    A[3:6, 9:12], A[:3, 12:] = -R, -R
    A[3:6, 12:], A[6:9, 12:] = -lie.hat(mean[3]) @ R, -lie.hat(mean[4]) @ R
    N = np.zeros((15, 12))
    N[3:6, :3], N[:3, 3:6] = R, R
    N[3:6, 3:6], N[6:9, 3:6] = lie.hat(mean[3]) @ R, lie.hat(mean[4]) @ R
    N[9:, 6:] = np.eye(6)
    noise = FilterNoise(0.3, 0.7, np.array([0.1, 0.2, 0.3]), 0.4)
    start = rng.normal(size=(15, 15))
    start = start @ start.T

    def rate(dt):
        after = start.copy()
        step(mean.copy(), after, gyro, accel, dt, noise.packed())
        return (after - start) / dt

    wanted = A @ start + start @ A.T + N @ np.diag(noise.packed().ravel()) @ N.T
    # The difference is of first order in dt: two steps take that error out.
    assert_allclose(2 * rate(1e-5) - rate(2e-5), wanted, atol=1e-4)
