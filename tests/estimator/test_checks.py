"""What a filter takes, refuses and stores, and the limits beyond which it has diverged."""

from typing import Any

import numpy as np
import pytest
from refusals import refusal, refused

from surefoot.estimator.core.checks import DivergedError, SampleError, check_sound, spd
from surefoot.estimator.core.state import FilterNoise, NavState
from surefoot.estimator.filter import InvariantFilter
from surefoot.estimator.leg import LegFilter
from surefoot.estimator.run import every_row, output_stride


@pytest.mark.parametrize("given", [np.asarray, np.ndarray.tolist, np.asfortranarray])
def test_a_covariance_is_symmetric_and_definite_in_whatever_form(given):
    right = np.array([[2.0, 0.5, 0.1], [0.5, 1.0, 0.2], [0.1, 0.2, 3.0]])
    found = spd("R", given(right), 3)
    assert type(found) is np.ndarray
    np.testing.assert_array_equal(found, right)
    skew, infinite = right.copy(), right.copy()
    skew[0, 2] += 0.1
    infinite[1, 1] = np.inf
    for wrong in (-right, right - 1.5 * np.eye(3), skew, infinite, np.eye(2), np.eye(4)):
        refused("R: ", spd, "R", given(wrong), 3)


@pytest.mark.parametrize("name", ["v_GI", "p_GI", "b_a", "b_g"])
def test_a_state_has_vectors_of_three_numbers(name):
    given: dict[str, Any] = {name: [1, 2, 3]}
    found = getattr(NavState(**given), name)
    assert (type(found), found.dtype, found.tolist()) == (np.ndarray, float, [1.0, 2.0, 3.0])
    for wrong in ([1.0, 2.0], np.zeros((3, 1)), [0.0, np.nan, 0.0]):
        given[name] = wrong
        refused(name, NavState, **given)


@pytest.mark.parametrize("name", ["gyro", "accel", "gyro_walk", "accel_walk"])
def test_a_density_is_one_or_three_finite_numbers_from_zero(name):
    given: dict[str, Any] = {}
    for wrong in (-1e-3, np.inf, np.nan, [1e-3, 1e-3], [1e-3, 1e-3, -1e-3], np.zeros((3, 1))):
        given[name] = wrong
        refused(f"noise: {name} must be", FilterNoise(**given).packed)
    row = ("accel", "gyro", "accel_walk", "gyro_walk").index(name)
    for right in (0.0, 0.5, [0.1, 0.2, 0.3]):
        given[name] = right
        packed = FilterNoise(**given).packed()
        np.testing.assert_array_equal(packed[row], np.broadcast_to(right, 3) ** 2)


def test_a_foot_is_within_a_hundred_metres():
    """Further off, the sample is refused and the filter as before."""
    one = LegFilter(NavState(), np.eye(15), feet=1)
    cov, standing = np.eye(3)[None], np.ones(1, dtype=bool)
    for sign in (-1.0, 1.0):
        with pytest.raises(SampleError, match="foot_positions_I: beyond 100 m"):
            one.update_contacts(np.array([[0.0, 0.0, 101.0 * sign]]), standing, cov)
    assert not one.contacts
    one.update_contacts(np.array([[0.0, 0.0, -99.0]]), standing, cov)
    assert list(one.contacts) == [0]


LARGEST = {"rotation": 1e3, "velocity": 1e7, "position": 1e11, "b_a": 1e3, "b_g": 1e3}


@pytest.mark.parametrize("name", LARGEST)
def test_a_filter_has_diverged_with_any_one_deviation_out_of_range(name):
    at = 3 * list(LARGEST).index(name)
    for i in range(at, at + 3):
        variances = np.ones(15)
        variances[i] = (0.99 * LARGEST[name]) ** 2
        check_sound(NavState().pack(), np.diag(variances))
        variances[i] = (1.01 * LARGEST[name]) ** 2
        refusal(check_sound, NavState().pack(), np.diag(variances), error=DivergedError)


GYRO, ACCEL, V_I = np.array([0.1, -0.2, 0.3]), np.array([0.2, 0.1, 9.7]), np.array([0.5, 0.1, 0.0])


COV = np.diag([0.01, 0.02, 0.03])


def made(gyro, accel, v_I, cov) -> np.ndarray:
    f = InvariantFilter(NavState(v_GI=np.array([0.4, 0.0, 0.0])), 0.01 * np.eye(15))
    for _ in range(3):
        f.predict(gyro, accel, 0.002)
        f.update_velocity(v_I, cov)
    return f.covariance


def test_lists_and_strided_arrays_give_the_numbers_of_plain_arrays():
    plain = made(GYRO, ACCEL, V_I, COV)
    strided = np.stack([GYRO, GYRO], axis=1)[:, 0]
    readonly = ACCEL.copy()
    readonly.flags.writeable = False
    assert np.array_equal(made(list(GYRO), list(ACCEL), list(V_I), COV.tolist()), plain)
    assert np.array_equal(made(strided, readonly, V_I, np.asfortranarray(COV)), plain)


def test_a_covariance_stays_symmetric_to_the_last_bit():
    f = InvariantFilter(NavState(), 0.01 * np.eye(15))
    rng = np.random.default_rng(0)
    for _ in range(200):
        f.predict(GYRO + 0.1 * rng.standard_normal(3), ACCEL, 0.002)
        f.update_velocity(V_I + 0.1 * rng.standard_normal(3), COV)
    assert np.array_equal(f.covariance, f.covariance.T)


@pytest.mark.parametrize(("rate", "stride"), [(100, 1), (400, 4), (500, 5), (50, 1)])
def test_estimates_are_stored_at_100_hz_or_the_rate_of_the_log(rate, stride):
    t = np.arange(50) / rate
    assert output_stride(t) == stride
    np.testing.assert_array_equal(every_row(t), np.arange(0, 50, stride))
