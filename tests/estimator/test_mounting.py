"""An IMU's mounting in the covariance: by sampling, and on a walk with a turned sensor."""

import numpy as np
from lie_group import so3_exp
from motions import feet, motion
from numpy.testing import assert_allclose
from whole_runs import run_leg

from surefoot.estimator.core import lie
from surefoot.estimator.core.state import FilterNoise
from surefoot.estimator.evaluation.trajectory import Trajectory, with_mounting
from surefoot.estimator.leg import LegNoise
from surefoot.estimator.metrics import evaluate, nees

STD = 3e-3


def test_only_attitude_learns_of_it():
    """Estimates off by tilts drawn with STD and by nothing else: their NEES is that of two axes."""
    rng = np.random.default_rng(0)
    n = 4000
    R = np.array([so3_exp(np.array([0.0, 0.0, yaw])) for yaw in rng.uniform(-3, 3, n)])
    p, v = 20.0 * rng.normal(size=(n, 3)), rng.normal(size=(n, 3))
    none = np.zeros((n, 3))
    truth = Trajectory(np.arange(n) * 0.01, R, v, p, none, none)
    tilt = np.column_stack([STD * rng.standard_normal((n, 2)), np.zeros(n)])
    turned = np.array([a @ so3_exp(d) for a, d in zip(R, tilt, strict=True)])
    tiny = np.broadcast_to(np.eye(15) * 1e-14, (n, 15, 15))
    claimed = with_mounting(Trajectory(truth.t, turned, v, p, none, none, tiny), STD)
    found = nees(truth, claimed)
    assert np.nanmean(found.attitude) == np.clip(np.nanmean(found.attitude), 1.9, 2.1)
    J = np.concatenate([-lie_hats(p), np.zeros((n, 3, 3)), np.tile(np.eye(3), (n, 1, 1))], axis=2)
    assert claimed.covariance is not None
    spread = J @ claimed.covariance[:, :9, :9] @ np.swapaxes(J, 1, 2)
    plain = J @ tiny[:, :9, :9] @ np.swapaxes(J, 1, 2)
    assert_allclose(spread, plain, atol=1e-12)


def lie_hats(x):
    return np.array([lie.hat(row) for row in x])


def test_a_turned_imu_is_why_a_sure_filter_is_wrong_of_its_attitude():
    walk = motion(30.0, 500.0)
    legs = feet(walk, 0.0)
    turn = so3_exp(np.array([12e-3, -9e-3, 0.0]))
    cov = np.broadcast_to(np.eye(3) * 4e-6, (*legs.contact.shape, 3, 3))
    found = run_leg(
        walk.t, walk.gyro @ turn, walk.accel @ turn, legs.feet_I, legs.contact, cov, *walk.start(),
        LegNoise(FilterNoise(3e-4, 1e-2, 1e-5, 1e-4), 0.01),
    )  # fmt: skip
    plain = evaluate(walk.reference(), found)
    declared = evaluate(walk.reference(), with_mounting(found, 1e-2))
    assert declared.nees_attitude < 3.0 < 5.0 < plain.nees_attitude
    assert np.isclose(declared.nees_position, plain.nees_position, rtol=1e-6)
