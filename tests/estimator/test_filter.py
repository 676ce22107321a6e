"""The invariant filter: known truth, streaming against compiled runs, consistency, bad input."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from motions import motion
from numpy.testing import assert_array_equal
from refusals import refused
from whole_runs import run_coverage, run_imu, run_velocity

from surefoot.estimator.core.state import FilterNoise, NavState
from surefoot.estimator.filter import InvariantFilter, PersistentFilter
from surefoot.estimator.metrics import evaluate, nees
from surefoot.estimator.run import imu_samples
from surefoot.estimator.updates.bias_states import PersistentError
from surefoot.sim.common.gravity import GRAVITY

EPSILON = np.array([0.06, 0.06, 0.04])


@pytest.fixture(scope="module")
def walk():
    return motion(20.0, 500.0)


@pytest.fixture(scope="module")
def rows(walk):
    return np.arange(5, len(walk.t), 5)


def test_perfect_data_give_the_truth(walk, rows):
    imu, perfect = (walk.t, walk.gyro, walk.accel), (rows, walk.v_I[rows])
    alone = evaluate(walk.reference(), run_imu(*imu, *walk.start()))
    assert alone.ape_trans < 5e-3
    assert alone.ape_rot < 1e-3
    whole = run_velocity(*imu, *perfect, np.eye(3) * 1e-4, *walk.start())
    result = evaluate(walk.reference(), whole)
    assert result.ape_trans < 1e-3
    assert result.velocity < 1e-3
    bounded = run_coverage(*imu, *perfect, EPSILON, 0.8, *walk.start())
    assert evaluate(walk.reference(), bounded).ape_trans < 5e-3


def test_a_gyro_bias_is_found_through_velocities(walk, rows):
    bias = np.array([0.02, -0.01, 0.0])
    whole = run_velocity(
        walk.t, walk.gyro + bias, walk.accel, rows, walk.v_I[rows], np.eye(3) * 1e-4,
        *walk.start(b_g=0.02),
    )  # fmt: skip
    assert np.abs(whole.b_g[-1] - bias)[:2].max() < 2e-3


def trial(walk, rows, rng, noise, std):
    """A start and measurements drawn exactly as the filter believes them to be."""
    start = walk.drawn_start(rng, b_a=0.02, b_g=2e-3)
    gyro, accel = walk.sensed(rng, noise)
    v_I = walk.v_I[rows] + rng.normal(size=(len(rows), 3)) * std
    return (walk.t, gyro, accel, rows, v_I), start


def test_nees_is_within_its_chi_square_bounds(walk, rows):
    rng = np.random.default_rng(4)
    noise, std, runs = FilterNoise(1e-3, 1e-2, 1e-5, 1e-4), 0.05, 16
    walk, rows = walk.part(5001), rows[rows < 5001]
    reference = walk.reference().rows(slice(None, None, 5))
    found = []
    for _ in range(runs):
        data, (state, P) = trial(walk, rows, rng, noise, std)
        result = nees(reference, run_velocity(*data, np.eye(3) * std**2, state, P, noise))
        found.append([series[-1] for series in (result.position, result.velocity, result.attitude)])
    # The mean of `runs` chi-square(3) variables has deviation sqrt(6 / runs).
    assert np.all(np.abs(np.mean(found, axis=0) - 3.0) < 3 * np.sqrt(6 / runs))


def test_coverage_stays_consistent_where_the_gaussian_filter_does_not(walk, rows):
    """A bias that persists through a run and that the Gaussian filter does not believe in."""
    rng = np.random.default_rng(5)
    noise, walk = FilterNoise(1e-3, 1e-2, 1e-5, 1e-4), walk.part(5001)
    rows = rows[rows < 5001]
    reference = walk.reference().rows(slice(None, None, 5))
    gaussian, coverage, persistent = [], [], []
    lasting = PersistentError(np.eye(3) * 0.05**2)
    for _ in range(6):
        (t, gyro, accel, rows, v_I), start = trial(walk, rows, rng, noise, 0.02)
        v_I = v_I + rng.choice([-0.05, 0.05], size=3)
        cov = np.eye(3) * 0.02**2
        data = (t, gyro, accel, rows, v_I)
        for series, estimate in (
            (gaussian, run_velocity(*data, cov, *start, noise)),
            (coverage, run_coverage(*data, np.full(3, 0.15), 0.8, *start, noise)),
            (persistent, run_velocity(*data, cov, *start, noise, persistent=lasting)),
        ):
            series.append(nees(reference, estimate).position[-1])
    assert np.mean(gaussian) > 30
    assert np.mean(coverage) < 0.5 * np.mean(gaussian)
    assert np.mean(persistent) < 10


def moving(n, rng):
    """Stamps (n,), gyro and accelerometer (n, 3) of an IMU that is shaken, stamped unevenly."""
    t = np.cumsum(rng.uniform(0.002, 0.02, n))
    accel = np.array([0.0, 0.0, GRAVITY]) + rng.normal(size=(n, 3))
    return t, 0.3 * rng.normal(size=(n, 3)), accel


def test_a_run_goes_on_from_the_last_row_of_the_one_before():
    t, gyro, accel = moving(6, np.random.default_rng(12))
    whole, parts = (InvariantFilter(NavState(), np.eye(15)) for _ in range(2))
    whole.run(imu_samples(t, gyro, accel))
    for piece in (slice(0, 4), slice(4, 6)):
        parts.run(imu_samples(t[piece], gyro[piece], accel[piece], after=parts.t))
        assert parts.t == t[piece][-1]
    assert_array_equal(parts.state.pack(), whole.state.pack())
    assert_array_equal(parts.covariance, whole.covariance)


def test_the_persistent_error_is_its_prior_at_first():
    """And measurements tell of it."""
    start, prior = (NavState(), np.eye(15)), np.diag([1e-3, 2e-3, 3e-3])
    one = PersistentFilter(*start, PersistentError(prior))
    mean, covariance = one.persistent
    assert_array_equal(mean, np.zeros(3))
    assert_array_equal(covariance, prior)
    one.update_velocity(np.full(3, 0.1), 1e-4 * np.eye(3))
    assert np.all(np.diag(one.persistent[1]) < np.diag(prior))
    assert np.all(one.persistent[0] > 0.0)


@pytest.mark.parametrize("word", ["fast", None])
def test_a_velocity_in_words_is_refused_and_changes_nothing(word):
    one = InvariantFilter(NavState(), np.eye(15))
    refused("v_I: ", one.update_velocity, np.full(3, word), np.eye(3))
    assert_array_equal(one.covariance, np.eye(15))


BAD = st.sampled_from([np.nan, np.inf, -np.inf])


@settings(max_examples=30, deadline=None)
@given(bad=BAD, index=st.integers(0, 2), name=st.sampled_from(["gyro", "accel", "v_I", "epsilon"]))
def test_what_is_not_finite_is_refused_and_changes_nothing(bad, index, name):
    one = InvariantFilter(NavState(), np.eye(15))
    value = np.ones(3)
    value[index] = bad
    before = one.covariance
    calls = {
        "gyro": lambda: one.predict(value, np.zeros(3), 0.01),
        "accel": lambda: one.predict(np.zeros(3), value, 0.01),
        "v_I": lambda: one.update_coverage(value, np.ones(3), 0.8),
        "epsilon": lambda: one.update_coverage(np.ones(3), value, 0.8),
    }
    refused(name, calls[name])
    assert_array_equal(one.covariance, before)


def test_bad_input_is_one_clear_line(walk, rows):
    state, P = walk.start()
    one, imu = InvariantFilter(state, P), (walk.t, walk.gyro, walk.accel)
    for call, words in (
        (lambda: one.predict(np.zeros(3), np.zeros(3), 0.0), "dt"),
        (lambda: one.predict(np.zeros(2), np.zeros(3), 0.1), "gyro: shape"),
        (lambda: one.update_coverage(np.zeros(3), np.array([0.1, 0.0, 0.1]), 0.8), "epsilon"),
        (lambda: one.update_coverage(np.zeros(3), np.ones(3), 1.0), "gamma"),
        (lambda: one.update_velocity(np.zeros(3), -np.eye(3)), "cov: is not positive definite"),
        (lambda: InvariantFilter(state, np.eye(9)), "covariance: shape"),
        (lambda: NavState(2 * np.eye(3)), "R_GI is not a rotation"),
        (lambda: run_imu(walk.t[::-1], walk.gyro, walk.accel, state, P), "strictly increasing"),
        (lambda: run_imu(walk.t, walk.gyro[:-1], walk.accel, state, P), "gyro: shape"),
        (
            lambda: run_coverage(*imu, rows[::-1], walk.v_I[rows], EPSILON, 0.8, state, P),
            "rows: must increase",
        ),
        (
            lambda: run_coverage(*imu, rows, walk.v_I[rows], 0 * EPSILON, 0.8, state, P),
            "every bound must be > 0",
        ),
    ):
        refused(words, call)
