"""Persistent errors as states: the derivation's Jacobians, limits, outliers, and what it is for."""

import numpy as np
import pytest
from lie_group import differences, retracted, so3_exp
from motions import motion
from numpy.testing import assert_allclose, assert_array_equal
from refusals import refused

from surefoot.estimator.core.propagation import propagate
from surefoot.estimator.core.state import FilterNoise, NavState
from surefoot.estimator.filter import InvariantFilter, PersistentFilter
from surefoot.estimator.updates.bias_states import (
    EXTRAS,
    PersistentError,
    propagate_bias,
)
from surefoot.estimator.updates.coverage import update_coverage
from surefoot.estimator.updates.velocity import update_velocity, velocity_memory

INF = np.full(3, np.inf)
GRAVITY = np.array([0.0, 0.0, 9.8])


def prior(rng, size=1e-3):
    """A state with a persistent part, and its covariance (24, 24), s at zero."""
    mean = NavState(so3_exp(rng.normal(size=3)), rng.normal(size=3)).pack(EXTRAS)
    mean[7] = 0.1 * rng.normal(size=3)
    mean[9] = 0.1 * rng.normal(size=3)
    A = rng.normal(size=(21, 21)) * size
    P = np.zeros((24, 24))
    some = np.r_[:18, 21:24]
    P[np.ix_(some, some)] = A @ A.T + 1e-3 * size**2 * np.eye(21)
    return mean, P


def gather(mean, P, samples, v_I, window):
    """IMU steps with a measurement after each, all gathered; nothing wanders and nothing is new."""
    work = np.zeros((24, 6)), np.zeros((9, 3))
    for (gyro, accel), v in zip(samples, v_I, strict=True):
        propagate(mean, P, gyro, accel, 0.02, np.zeros((4, 3)), *work)
        update_coverage(mean, P, v, np.ones(3), 0.8, 1, velocity_memory(INF, window))


def test_the_windows_mean_by_differences():
    """Covariance of s, and with all other errors, after turning steps: J P J^T, J differenced."""
    rng = np.random.default_rng(0)
    mean, P = prior(rng)
    samples = [(rng.normal(size=3), rng.normal(size=3) + GRAVITY) for _ in range(6)]
    v_I = rng.normal(size=(6, 3))

    def s_after(delta):
        moved = retracted(mean, delta)
        gather(moved, np.zeros((24, 24)), samples, v_I, 50)
        return moved[8]

    # True state = X_bar moved by delta, so delta s = s_bar - s is minus what the state does.
    J = -differences(s_after, 24, 1e-5)
    after, spread = mean.copy(), P.copy()
    gather(after, spread, samples, v_I, 50)
    assert_allclose(spread[18:21, 18:21], J @ P @ J.T, rtol=1e-6, atol=1e-12)
    # b_p did not change on the way: its cross covariance with s is P J^T's.
    assert_allclose(spread[15:18, 18:21], (P @ J.T)[15:18], rtol=1e-6, atol=1e-12)
    assert_array_equal(spread, spread.T)


def test_it_wanders_as_gauss_and_markov_say():
    rng = np.random.default_rng(1)
    mean, P = prior(rng)
    A = 0.03 * rng.normal(size=(3, 3))
    C, tau, dt = A @ A.T + 1e-4 * np.eye(3), 5.0, 0.7
    before, spread = mean.copy(), P.copy()
    propagate_bias(mean, P, C, tau, dt)
    F = np.eye(24)
    F[15:18, 15:18] *= np.exp(-dt / tau)
    F[15:18, 21:] = (1 - np.exp(-dt / tau)) * np.eye(3)
    Q = np.zeros((24, 24))
    Q[15:18, 15:18] = (1 - np.exp(-2 * dt / tau)) * C
    assert_allclose(P, F @ spread @ F.T + Q, rtol=1e-12, atol=1e-18)
    assert_allclose(mean[7], before[9] + (before[7] - before[9]) * np.exp(-dt / tau))
    for _ in range(200):
        propagate_bias(mean, P, C, tau, dt)
    assert_allclose(P[15:18, 15:18], C + spread[21:, 21:], rtol=1e-10, atol=1e-15)
    assert_allclose(mean[7], mean[9])
    lasting = PersistentError(C, tau, course=np.eye(3) * 4e-3)
    start = lasting.enter(np.eye(15))
    before = start.copy()
    propagate_bias(mean, start, C, tau, dt)
    assert_allclose(start, before, rtol=1e-12, atol=1e-18, err_msg="the prior is stationary")
    spread = P.copy()
    propagate_bias(mean, P, C, np.inf, dt)
    assert_array_equal(P, spread)


def test_a_window_of_one_without_a_persistent_part_is_the_papers_update():
    state, P = NavState(v_GI=np.array([0.5, 0.1, 0.0])), np.eye(15) * 1e-2
    epsilon = np.array([0.1, 0.2, 0.05])
    plain = InvariantFilter(state, P)
    ours = PersistentFilter(state, P, PersistentError(np.eye(3) * 1e-14))
    for _ in range(3):
        v_I = state.v_I + np.array([0.2, -0.1, 0.3])
        pi = plain.update_coverage(v_I, epsilon, 0.8)
        assert ours.update_coverage(v_I, epsilon, 0.8) == pytest.approx(pi, rel=1e-6)
    assert_allclose(ours.covariance, plain.covariance, atol=1e-9)
    assert_allclose(ours.state.v_GI, plain.state.v_GI, atol=1e-8)


def test_a_bias_is_told_from_motion_by_turning():
    """A constant error of the observer is found where the body turns, by both updates."""
    walk = motion(20.0, 500.0)
    rows = np.arange(5, len(walk.t), 5)
    bias = np.array([0.08, -0.05, 0.0])
    lasting = PersistentError(np.eye(3) * 0.05**2, window=20)
    one = PersistentFilter(*walk.start(), lasting, FilterNoise(1e-4, 1e-3, 0, 0))
    two = PersistentFilter(*walk.start(), lasting, FilterNoise(1e-4, 1e-3, 0, 0))
    for k in range(1, len(walk.t)):
        for each in (one, two):
            each.predict(walk.gyro[k], walk.accel[k], walk.t[k] - walk.t[k - 1])
        if k in rows:
            one.update_coverage(walk.v_I[k] + bias, np.full(3, 0.01), 0.8)
            two.update_velocity(walk.v_I[k] + bias, np.eye(3) * 1e-3)
    for each in (one, two):
        assert each.persistent is not None
        found, cov = each.persistent
        assert np.abs(found - bias)[:2].max() < 0.02
        assert np.all(np.abs(found - bias) < 4 * np.sqrt(np.diag(cov)))


def test_outliers_alone_are_left_out_and_a_jump_is_not():
    state, P = NavState(), np.eye(15) * 1e-4
    lasting = PersistentError(np.eye(3) * 1e-4, window=5, max_error=np.full(3, 0.2))
    far = np.array([30.0, 0.0, 0.0])
    for kind in ("coverage", "velocity"):
        one = PersistentFilter(state, P, lasting)

        def tell(v, one=one, kind=kind):
            if kind == "coverage":
                return one.update_coverage(v, np.full(3, 0.05), 0.8)
            return one.update_velocity(v, np.eye(3) * 0.01)

        for _ in range(20):
            tell(np.zeros(3))
            assert np.isnan(tell(far))
        assert np.abs(one.state.v_GI).max() < 1e-3
        for _ in range(10):
            tell(far)
        assert one.state.v_GI[0] > 0.1, "a jump that stays is believed in the end"


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"covariance": np.zeros((3, 3))}, "persistent: is not positive definite"),
        ({"covariance": np.eye(2)}, "persistent: shape"),
        ({"time_constant": 0.0}, "time_constant"),
        ({"window": 0}, "window"),
        ({"window": 1.5}, "window"),
        ({"max_error": np.zeros(3)}, "max_error"),
        ({"course": -np.eye(3)}, "course"),
        ({"course": np.eye(2)}, "course"),
    ],
)
def test_what_is_no_persistent_error_is_one_line(values, says):
    refused(says, PersistentError, **{"covariance": np.eye(3)} | values)


def test_a_velocity_left_out_changes_nothing():
    mean, P = prior(np.random.default_rng(5))
    before = mean.copy(), P.copy()
    memory, far = velocity_memory(np.full(3, 0.1), 5), np.full(3, 1e3)
    found = update_velocity(mean, P, 0, far, np.eye(3), memory)
    assert np.isnan(found)
    assert_array_equal(mean, before[0])
    assert_array_equal(P, before[1])


def test_a_window_holds_minus_its_share_of_the_errors_until_it_ends():
    """A state known exactly: s is minus the sum of what was measured beyond it, over the window;
    at the end it starts from zero, whatever the update made of it."""
    mean, P = NavState(v_GI=np.array([0.5, 0.0, 0.0])).pack(EXTRAS), np.zeros((24, 24))
    mean[7] = [0.0, 0.1, 0.0]
    memory = velocity_memory(window=3)
    off = np.array([[0.3, 0.0, -0.1], [0.1, -0.2, 0.0], [0.0, 0.0, 0.0]])
    expected, pi = mean[3] + mean[7], np.nan
    for k in range(3):
        bounds = np.full(3, 0.5)
        pi = update_coverage(mean, P, expected + off[k], bounds, 0.8, 1, memory)
        if k < 2:
            assert np.isnan(pi)
            assert_allclose(mean[8], -off[: k + 1].sum(axis=0) / 3, atol=1e-15)
    assert 0.0 <= pi <= 1.0
    assert_array_equal(mean[8], 0.0)
    assert memory.counts[0] == 0
