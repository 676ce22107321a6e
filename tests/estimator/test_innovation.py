"""Innovations read off a finished trajectory are those that the filter met on its way."""

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation
from synthetic import synthetic_walk
from whole_runs import run_coverage, run_imu

from surefoot.estimator.evaluation.innovation import innovations
from surefoot.estimator.evaluation.trajectory import Trajectory, TrajectoryError, UpdateRecord
from surefoot.estimator.filter import InvariantFilter
from surefoot.estimator.initial import initial_state, start_covariance
from surefoot.sim.common.gravity import GRAVITY_G
from surefoot.sim.log import Log, Meta


@pytest.mark.parametrize("stride", [1, 5])
def test_they_are_what_the_filter_met(stride):
    rng = np.random.default_rng(0)
    log = synthetic_walk(0, 6.0)
    state, std = initial_state(log)
    rows = np.arange(5, len(log.t), 5)
    v_I = 0.1 * rng.standard_normal((len(rows), 3))
    epsilon = np.full(3, 0.05)
    covariance = start_covariance(state, std)
    f = InvariantFilter(state, covariance)
    met, known, row = [], [], 0
    for k in range(1, len(log.t)):
        f.predict(log.gyro[k], log.accel[k], log.t[k] - log.t[k - 1])
        if row < len(rows) and k == rows[row]:
            R = f.state.R_GI
            met.append(v_I[row] - R.T @ f.state.v_GI)
            known.append(R.T @ f.covariance[3:6, 3:6] @ R)
            f.update_coverage(v_I[row], epsilon, 0.8)
            row += 1
    trajectory = run_coverage(
        log.t, log.gyro, log.accel, rows, v_I, epsilon, 0.8, state, covariance, stride=stride
    )
    found = innovations(log, trajectory)
    assert found.z == pytest.approx(np.array(met), abs=2e-5)
    # Of the sample before: it has grown by five samples of noise since.
    sizes = [np.trace(S, axis1=1, axis2=2) for S in (found.S, np.array(known))]
    assert np.median(np.abs(sizes[0] / sizes[1] - 1)) < 0.1
    by_hand = [z @ np.linalg.inv(S) @ z / 3 for z, S in zip(found.z, found.S, strict=True)]
    assert found.squared == pytest.approx(by_hand)


def test_in_free_fall_they_are_the_errors_of_what_was_measured():
    """v = g t exactly, whether an update comes one or seven samples after the last estimate."""
    t, rng = np.arange(24) / 100.0, np.random.default_rng(1)
    frame = pd.DataFrame({"t": t})
    for name in ("gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z"):
        frame[name] = 0.0
    at, rows = np.array([0, 8, 16]), np.array([1, 7, 11, 16, 19, 23])
    turn = Rotation.from_rotvec([0.3, -0.2, 1.0]).as_matrix()
    errors = rng.normal(size=(len(rows), 3))
    measured = (t[rows, None] * GRAVITY_G) @ turn + errors
    none = np.zeros((len(at), 3))
    trajectory = Trajectory(
        t[at], np.tile(turn, (3, 1, 1)), t[at, None] * GRAVITY_G, none, none, none,
        np.tile(np.eye(15), (3, 1, 1)),
        UpdateRecord(t[rows], measured, None, None, np.ones(len(rows), dtype=bool)),
    )  # fmt: skip
    found = innovations(Log(frame, Meta(rate=100.0)), trajectory)
    assert found.t.tolist() == t[rows].tolist()
    assert np.abs(found.z - errors).max() < 1e-12


def test_a_trajectory_without_updates_is_refused():
    log = synthetic_walk(0, 1.0)
    state, _ = initial_state(log)
    with pytest.raises(TrajectoryError, match="with velocity updates"):
        innovations(log, run_imu(log.t, log.gyro, log.accel, state, np.eye(15)))
