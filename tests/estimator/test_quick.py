"""The calls of a robot's own loop: what they take, and the same numbers whatever they are given."""

import numpy as np

from surefoot.estimator.core.state import NavState
from surefoot.estimator.filter import InvariantFilter

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
