"""What a filter refuses, and the limits beyond which it has diverged."""

import numpy as np
import pytest

from surefoot.estimator.core.checks import DivergedError, SampleError, check_sound, vector
from surefoot.estimator.core.state import NavState
from surefoot.estimator.leg import LegFilter
from surefoot.sim.common.errors import SurefootError


@pytest.mark.parametrize("shape", [(2,), (4,), (3, 3), (3, 1), ()])
def test_a_vector_is_of_three_numbers(shape):
    with pytest.raises(SurefootError, match="v_I: shape"):
        vector("v_I", np.zeros(shape))


@pytest.mark.parametrize("value", [[1.0, 2.0, 3.0], np.arange(1, 4), np.arange(1.0, 7.0)[::2]])
def test_whatever_holds_three_numbers_is_a_vector(value):
    found = vector("v_I", value)
    assert found.dtype == float
    assert found.flags.carray
    assert found.tolist() == list(value)


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
        with pytest.raises(DivergedError):
            check_sound(NavState().pack(), np.diag(variances))
