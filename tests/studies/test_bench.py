"""The bench compares like with like: the same work on both sides, the smallest times."""

from dataclasses import replace

import numpy as np
import pytest
from whole_runs import run_coverage

from studies.bench import walking
from studies.bench.box import box_kinds, less_error
from studies.bench.filter import BENCH_GAMMA, gtsam_filter, run_updates, trial, velocity_filter
from studies.bench.ratio import SAMPLES
from studies.bench.run import bench
from studies.montecarlo.qmc import evaluate_boxes
from surefoot.estimator.core.state import FilterNoise, NavState
from surefoot.estimator.updates.velocity import velocity_memory
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.scenario import Scenario, Segment


@pytest.fixture(autouse=True)
def short_course(monkeypatch):
    monkeypatch.setattr(walking, "COURSE", Scenario("bench", (Segment(0.5, 0.5),), Ground(0.8)))


def test_walk_and_replay_take_as_many_steps_to_the_same_bits():
    """`race` itself raises where a replay ends elsewhere."""
    pair = walking.race(robots=3, threads=2)
    assert pair.steps == 3 * round(6.5 / 0.002)  # 3 s and twice 1 s of standing, 1 s at the end


def test_a_replay_that_ends_elsewhere_is_no_measure():
    bare = walking.race(robots=1, threads=1).bare
    with pytest.raises(RuntimeError, match="differs"):
        replace(bare, last=bare.last + 1e-15).run()


def test_unknown_items_and_too_many_rounds_are_refused():
    for rounds, only, option in (
        (1, ["flying"], "--only"),
        (0, [], "--rounds"),
        (10**12, [], "--rounds"),
    ):
        with pytest.raises(SurefootError, match=option):
            bench(rounds, only)


def test_samples_and_box_moments_do_the_same_work():
    """On every kind of box where the samples give a number, both mean the same Gaussian."""
    for name, boxes in box_kinds(np.random.default_rng(4), 20).items():
        shifts = np.random.default_rng(5).random((1, 20, 3))
        ours, theirs = (evaluate_boxes(*boxes, samples, shifts) for samples in (0, SAMPLES))
        # Where nothing is left of the box's mass, nothing is left of the samples either.
        fair = ours[0] > 1e-3
        assert np.abs(ours[0] - theirs[0])[fair].max(initial=0.0) < 0.02, name
        if name == "ordinary":
            assert less_error(boxes, ours, theirs) > 1e6


def test_the_filter_with_samples_is_the_same_filter():
    study, truth, trials = trial()
    noise = FilterNoise(study.imu.gyro, study.imu.accel, 0.0, 0.0)
    epsilon, shifts = 1.8 * study.noise_std, np.random.default_rng(6).random((200, 3))
    ends = []
    for samples in (0, 5000):
        mean, covariance = trials.means[0].copy(), trials.covariance.copy()
        data = truth.t, trials.gyro[0], trials.accel[0], trials.v_I[0]
        memory = velocity_memory()
        run_updates(*data, epsilon, mean, covariance, noise.packed(), memory, shifts, samples)
        ends.append(mean)
    whole = run_coverage(
        truth.t, trials.gyro[0], trials.accel[0], np.arange(1, 201), trials.v_I[0], epsilon,
        BENCH_GAMMA, NavState.unpack(trials.means[0]), trials.covariance, noise, 1,
    )  # fmt: skip
    assert np.abs(ends[0][3] - whole.v_GI[-1]).max() < 1e-12
    assert np.abs(ends[1][3] - ends[0][3]).max() < 1e-2


def test_gtsams_filter_is_given_the_same_problem():
    gtsam = pytest.importorskip("gtsam")
    assert np.abs(velocity_filter()() - gtsam_filter(gtsam)()).max() < 2e-3
