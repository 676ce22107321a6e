"""Trajectories go out and come back whole; starts come from the reference or from gravity."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from motions import motion
from numpy.testing import assert_allclose, assert_array_equal
from refusals import refused
from scipy.spatial.transform import Rotation
from whole_runs import run_coverage

from surefoot.estimator.core.lie import hat
from surefoot.estimator.evaluation.trajectory import Trajectory, TrajectoryError, reference
from surefoot.estimator.initial import (
    GRAVITY_STD,
    initial_state,
    level,
    start_covariance,
    still_gyro_bias,
)
from surefoot.sim.log import Log


@pytest.fixture(scope="module")
def estimate():
    walk = motion(2.0, 500.0)
    rows = np.arange(5, len(walk.t), 7)
    return run_coverage(
        walk.t, walk.gyro, walk.accel, rows, walk.v_I[rows] + 0.05, np.full(3, 0.1), 0.8,
        *walk.start(),
    )  # fmt: skip


def test_parquet_returns_what_was_written(estimate, tmp_path):
    path = tmp_path / "estimate.parquet"
    estimate.write(path)
    back = Trajectory.read(path)
    for name in ("t", "v_GI", "p_GI", "b_a", "b_g", "covariance"):
        assert_array_equal(getattr(back, name), getattr(estimate, name))
    assert_allclose(back.R_GI, estimate.R_GI, atol=1e-15)
    for name in ("t", "v_I", "epsilon", "pi", "active"):
        assert_array_equal(getattr(back.updates, name), getattr(estimate.updates, name))


def test_never_overwrites_without_force(estimate, tmp_path):
    for write in (estimate.write, estimate.write_tum):
        path = tmp_path / f"{write.__name__}.out"
        write(path)
        before = path.read_bytes()
        refused("exists already", write, path)
        assert path.read_bytes() == before
        write(path, force=True)
    assert not list(tmp_path.glob(".*"))


def test_tum_keeps_every_digit(estimate, tmp_path):
    estimate.write_tum(tmp_path / "estimate.txt")
    table = np.loadtxt(tmp_path / "estimate.txt")
    assert_array_equal(table[:, 0], estimate.t)
    assert_array_equal(table[:, 1:4], estimate.p_GI)
    assert_allclose(Rotation.from_quat(table[:, 4:]).as_matrix(), estimate.R_GI, atol=1e-15)


def test_bad_files_are_one_clear_line(estimate, tmp_path):
    text = tmp_path / "text.parquet"
    text.write_text("no parquet")
    other = tmp_path / "other.parquet"
    pd.DataFrame({"t": [1.0]}).to_parquet(other)
    for path, words in (
        (tmp_path / "absent.parquet", "No such file or directory"),
        (text, "cannot be read"),
        (other, "is not a trajectory"),
    ):
        assert str(path) in refused(words, Trajectory.read, path, error=TrajectoryError)
    refused("p_GI has shape", replace, estimate, p_GI=np.zeros((3, 3)), error=TrajectoryError)


def test_reference_is_cut_to_ref_ok():
    walk = motion(1.0, 500.0)
    whole = walk.log()
    ok = np.ones(len(walk.t))
    ok[100:200] = 0
    cut = reference(Log(whole.frame.assign(ref_ok=ok), whole.meta))
    assert len(cut.t) == len(walk.t) - 100
    assert_allclose(cut.v_GI[150], walk.v[250])
    assert cut.covariance is None


def test_start_is_the_references_first_row():
    walk = motion(1.0, 500.0)
    state, std = initial_state(walk.log())
    covariance = start_covariance(state, std)
    assert_allclose(state.R_GI, walk.R[0], atol=1e-12)
    assert_allclose(state.p_GI, walk.p[0])
    assert_allclose(state.v_GI, walk.v[0])
    np.linalg.cholesky(covariance)
    J = np.zeros((3, 15))
    J[:, :3], J[:, 6:9] = -hat(state.p_GI), np.eye(3)
    assert_allclose(J @ covariance @ J.T, np.eye(3) * 1e-6, atol=1e-12)


def test_start_without_a_reference_is_gravity():
    walk = motion(1.0, 500.0)
    R = Rotation.from_euler("ZYX", [0.0, 0.2, -0.3]).as_matrix()
    still = np.tile(R.T @ [0, 0, 9.81], (len(walk.t), 1))
    state, std = initial_state(walk.log(accel=still), "rest")
    assert_allclose(state.R_GI, R, atol=1e-12)
    assert_allclose(state.v_GI, 0)
    assert std.tilt == GRAVITY_STD.tilt
    falling = walk.log(accel=np.tile([0.0, 0.0, 0.1], (len(walk.t), 1)))
    for start in ("rest", "moving"):
        refused("gravity is unknown", initial_state, falling, start)


@pytest.mark.parametrize(("shaken", "known"), [(0.01, True), (0.1, False)])
def test_a_gyro_bias_is_read_where_the_log_starts_still(shaken, known):
    """With 0.1 rad/s of shaking it is none that a standing robot has, though no force says so."""
    walk, bias = motion(1.0, 500.0), np.array([0.02, -0.01, 0.005])
    gyro = bias + shaken * np.random.default_rng(4).normal(size=walk.gyro.shape)
    still = np.tile([0.0, 0.0, 9.81], (len(walk.t), 1))
    found, std = still_gyro_bias(walk.log(gyro, still), GRAVITY_STD)
    assert_allclose(found, known * bias, atol=3e-3 * known)
    assert (std.b_g < GRAVITY_STD.b_g) == known


def test_a_bias_read_at_rest_is_as_sure_as_its_independent_readings():
    """50 a second, for half a second: the largest axis' spread, of however many rows."""
    walk = motion(1.0, 500.0)
    turns = 0.01 * (-1.0) ** np.arange(len(walk.t))
    still = np.tile([0.0, 0.0, 9.81], (len(walk.t), 1))
    _, std = still_gyro_bias(walk.log(np.outer(turns, [1.0, 0.5, 0.0]), still), GRAVITY_STD)
    assert std.b_g == pytest.approx(0.01 / np.sqrt(25.0), rel=0.01)


def test_a_single_reading_of_a_slow_log_gives_no_bias():
    """At 1 Hz the first half second has one row, whose two halves nobody can compare."""
    slow = motion(3.0, 500.0).log().rows(slice(None, None, 500))
    found, std = still_gyro_bias(slow, GRAVITY_STD)
    assert slow.gyro[0].any()
    assert not found.any()
    assert std is GRAVITY_STD


def test_level_turns_the_force_upwards():
    rng = np.random.default_rng(0)
    for force in [*rng.normal(size=(20, 3)), np.array([1.0, 0, 0]), np.array([0, 0, -1.0])]:
        R = level(force)
        assert_allclose(R @ R.T, np.eye(3), atol=1e-14)
        assert np.linalg.det(R) > 0
        assert_allclose(R @ force, np.array([0, 0, np.linalg.norm(force)]), atol=1e-12)
