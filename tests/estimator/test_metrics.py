"""Metrics against evo (a peer, used as an oracle here alone) and against finite differences."""

from dataclasses import replace

import numpy as np
import pytest
from lie_group import differences, retracted, so3_exp
from motions import motion
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from surefoot.estimator.core import lie
from surefoot.estimator.core.state import NavState
from surefoot.estimator.evaluation.trajectory import (
    Trajectory,
    TrajectoryError,
    UpdateRecord,
    with_mounting,
)
from surefoot.estimator.metrics import (
    _normalised,
    align_first,
    align_se3,
    evaluate,
    matched,
    nees,
    path_length,
    segments,
    vector_jacobian,
)


def drifted(truth: Trajectory, rng: np.random.Generator) -> Trajectory:
    """An estimate that drifts, turned and shifted as a whole: what alignment must undo."""
    n = len(truth.t)
    turn = Rotation.from_euler("Z", 0.7).as_matrix()
    wander = np.cumsum(rng.normal(size=(n, 3)), axis=0) * 2e-3
    R = Rotation.from_rotvec(np.cumsum(rng.normal(size=(n, 3)), axis=0) * 1e-3).as_matrix()
    p_GI = (truth.p_GI + wander) @ turn.T + [3.0, -2.0, 1.0]
    return replace(truth, R_GI=turn @ R @ truth.R_GI, v_GI=truth.v_GI @ turn.T, p_GI=p_GI)


@pytest.fixture(scope="module")
def pair():
    truth = motion(12.0, 100.0).reference()
    return truth, drifted(truth, np.random.default_rng(5))


def test_ape_and_rpe_are_evos(pair, tmp_path):
    metrics_of_evo = pytest.importorskip("evo.core.metrics")
    file_interface = pytest.importorskip("evo.tools.file_interface")
    truth, estimate = pair
    ours = evaluate(truth, estimate)
    aligned = align_first(truth, estimate)
    truth.write_tum(tmp_path / "truth.txt")
    aligned.write_tum(tmp_path / "estimate.txt")
    data = tuple(
        file_interface.read_tum_trajectory_file(tmp_path / name)
        for name in ("truth.txt", "estimate.txt")
    )
    relation = metrics_of_evo.PoseRelation

    def rmse(metric):
        metric.process_data(data)
        return metric.get_statistic(metrics_of_evo.StatisticsType.rmse), metric

    settings = {
        "delta": 1,
        "delta_unit": metrics_of_evo.Unit.meters,
        "all_pairs": True,
        "pairs_from_reference": True,
        "rel_delta_tol": 0.1,
    }
    for value, metric in (
        (ours.ape_trans, metrics_of_evo.APE(relation.translation_part)),
        (ours.ape_rot, metrics_of_evo.APE(relation.rotation_angle_deg)),
        (ours.rpe_trans, metrics_of_evo.RPE(relation.translation_part, **settings)),
        (ours.rpe_rot, metrics_of_evo.RPE(relation.rotation_angle_deg, **settings)),
    ):
        assert_allclose(value, rmse(metric)[0], rtol=1e-9, atol=1e-12)
    file_estimate = data[1]
    file_estimate.align(data[0])
    for value, metric in (
        (ours.ape_trans_se3, metrics_of_evo.APE(relation.translation_part)),
        (ours.ape_rot_se3, metrics_of_evo.APE(relation.rotation_angle_deg)),
    ):
        assert_allclose(value, rmse(metric)[0], rtol=1e-9)


def test_segments_are_evos_where_the_robot_stands_still():
    filters = pytest.importorskip("evo.core.filters")
    rng = np.random.default_rng(1)
    steps = rng.uniform(0, 0.08, size=(400, 1)) * (rng.random((400, 1)) < 0.6) * [[0.6, 0.8, 0.0]]
    p = np.cumsum(steps, axis=0)
    poses = [np.block([[np.eye(3), x[:, None]], [np.zeros((1, 3)), 1]]) for x in p]
    wanted = filters.filter_pairs_by_path(poses, 1.0, 0.1, all_pairs=True)
    assert list(zip(*segments(p), strict=True)) == wanted


def test_a_perfect_estimate_has_no_error(pair):
    truth, _ = pair
    metrics = evaluate(truth, truth)
    for name in ("ape_trans", "ape_rot", "rpe_trans", "rpe_rot", "ape_trans_se3", "velocity"):
        assert getattr(metrics, name) < 1e-5
    assert np.isnan(metrics.nees_position)
    assert np.isnan(metrics.pi_below_gamma)
    assert metrics.duration == pytest.approx(12.0)


def test_alignment_removes_position_and_yaw_and_nothing_else(pair):
    truth, _ = pair
    for angles, remains in (((0.9, 0.0, 0.0), False), ((0.0, 0.0, 0.2), True)):
        T = Rotation.from_euler("ZYX", angles).as_matrix()
        moved = replace(
            truth, R_GI=T @ truth.R_GI, v_GI=truth.v_GI @ T.T, p_GI=truth.p_GI @ T.T + 5
        )
        assert (evaluate(truth, moved).ape_trans > 0.01) == remains


def test_pairs_are_chosen_on_the_reference(pair):
    """An estimate that shrinks the world is scored on the same segments as one that does not."""
    truth, _ = pair
    shrunk = replace(truth, p_GI=0.5 * truth.p_GI)
    assert evaluate(truth, shrunk).segments == evaluate(truth, truth).segments
    assert 0.4 < evaluate(truth, shrunk).rpe_trans < 0.6


def test_metrics_are_taken_at_100_hz():
    fine = motion(3.0, 500.0).reference()
    reference, estimate = matched(fine, fine)
    assert_allclose(np.diff(reference.t), 0.01, atol=1e-9)
    assert_allclose(reference.t, estimate.t)
    coarse = fine.rows(slice(0, None, 5))
    assert evaluate(fine, coarse).samples == evaluate(fine, fine).samples == 301


def test_nees_jacobians_are_derivatives():
    rng = np.random.default_rng(2)
    state = NavState(so3_exp(rng.normal(size=3)), rng.normal(size=3), 10 * rng.normal(size=3))
    for row, at in ((3, 3), (4, 6)):
        mean = state.pack()

        def truth(delta, mean=mean, row=row):
            return retracted(mean, np.append(delta, np.zeros(6)))[row]

        # error = estimate - truth, and truth = exp(-xi^) estimate
        J = -differences(truth, 9)
        assert_allclose(vector_jacobian(mean[row][None], at)[0], J, atol=1e-7)


def test_nees_is_3_for_errors_drawn_from_the_covariance():
    """Also far from the origin, and whatever frame the estimate is expressed in."""
    rng = np.random.default_rng(11)
    n = 4000
    A = rng.normal(size=(15, 15)) * 0.001
    covariance = A @ A.T + 1e-8 * np.eye(15)
    truth = Trajectory(
        np.arange(n) * 0.01,
        np.tile(np.eye(3), (n, 1, 1)),
        np.tile([1.0, 0.2, 0.0], (n, 1)),
        np.tile([20.0, -10.0, 1.0], (n, 1)),
        np.zeros((n, 3)),
        np.zeros((n, 3)),
    )
    means = []
    for k in range(n):
        mean = NavState(np.eye(3), truth.v_GI[k], truth.p_GI[k]).pack()
        # The truth is exp(-xi^) of the estimate; moving it by -xi gives the estimate of a truth.
        xi = rng.multivariate_normal(np.zeros(15), covariance) if k else np.zeros(15)
        means.append(retracted(mean, -xi))
    means = np.array(means)
    turn = Rotation.from_euler("Z", 1.0).as_matrix()
    big = np.eye(15)
    big[:9, :9] = np.kron(np.eye(3), turn)
    big[6:9, :3] = lie.hat(np.array([4.0, 5.0, 6.0])) @ turn
    R_GI, v_GI, p_GI = turn @ means[:, :3], means[:, 3] @ turn.T, means[:, 4] @ turn.T
    moved = p_GI + np.array([4.0, 5.0, 6.0])
    S = np.tile(big @ covariance @ big.T, (n, 1, 1))
    estimate = Trajectory(truth.t, R_GI, v_GI, moved, means[:, 5], means[:, 6], S)
    result = evaluate(truth, estimate)
    for value in (result.nees_position, result.nees_velocity, result.nees_attitude):
        assert value == pytest.approx(3.0, abs=4 * np.sqrt(6 / n))


def test_a_normalised_error_has_no_unit():
    """The same in metres and in micrometres, but for the first sample, to which one aligns."""
    rng = np.random.default_rng(12)
    error, A = rng.normal(size=(5, 3)), rng.normal(size=(5, 3, 3))
    J, S = np.tile(np.eye(3), (5, 1, 1)), A @ np.swapaxes(A, 1, 2) + np.eye(3)
    plain = _normalised(error, J, S)
    assert np.isnan(plain).tolist() == [True, False, False, False, False]
    assert_allclose(_normalised(1e-6 * error, J, 1e-12 * S), plain, rtol=1e-9)


def test_share_of_active_updates(pair):
    truth, _ = pair
    pi = np.array([0.1, 0.9, 0.5, 0.7])
    updates = UpdateRecord(truth.t[:4], np.zeros((4, 3)), np.ones((4, 3)), pi, pi < 0.8)
    assert evaluate(truth, replace(truth, updates=updates)).pi_below_gamma == 75.0


def test_nothing_in_common_is_one_clear_error(pair):
    truth, estimate = pair
    later = replace(estimate, t=estimate.t + 0.005)
    with pytest.raises(TrajectoryError, match="no two stamps in common"):
        evaluate(truth, later)


def test_a_path_s_length_bears_a_stamp_that_rounding_puts_behind_its_end():
    truth = motion(10.01, 100.0).reference()
    late = replace(truth, t=15.502 + 0.01 * np.arange(len(truth.t)))
    assert path_length(late.t, late.p_GI) == pytest.approx(
        path_length(truth.t, truth.p_GI), rel=1e-2
    )


def test_where_the_reference_is_does_not_turn_the_aligned_estimate(pair):
    """A reference in metres from far away: on a grid that stays exact when it is moved there."""
    truth, estimate = pair
    near = replace(truth, p_GI=np.round(truth.p_GI * 1024.0) / 1024.0)
    far = replace(near, p_GI=near.p_GI + 2.0**40)
    wanted, found = align_se3(near, estimate), align_se3(far, estimate)
    assert_allclose(found.R_GI, wanted.R_GI, atol=1e-9)


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
    J = np.concatenate([-lie.hat(p), np.zeros((n, 3, 3)), np.tile(np.eye(3), (n, 1, 1))], axis=2)
    assert claimed.covariance is not None
    spread = J @ claimed.covariance[:, :9, :9] @ np.swapaxes(J, 1, 2)
    plain = J @ tiny[:, :9, :9] @ np.swapaxes(J, 1, 2)
    assert_allclose(spread, plain, atol=1e-12)
