"""The Monte-Carlo study: trials that are what they claim, and the batch that runs them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import ndtri

from surefoot.estimator.core.state import FilterNoise, NavState
from surefoot.estimator.evaluation.trajectory import Trajectory
from surefoot.estimator.filter import run_coverage, run_imu, run_velocity
from surefoot.estimator.metrics import nees
from surefoot.scenarios.cli.main import main
from surefoot.scenarios.studies.montecarlo.batch import Scores, Setting, run_batch
from surefoot.scenarios.studies.montecarlo.qmc import (
    _phi_inverse,
    qmc_moments,
    runtime_accuracy,
    tensor_moments,
)
from surefoot.scenarios.studies.montecarlo.report import beyond_table, montecarlo, write_study
from surefoot.scenarios.studies.montecarlo.settings import (
    BIASED,
    BUNDLED,
    MIXINGS,
    UNBIASED,
    ErrorLaw,
    Study,
    load_study,
)
from surefoot.scenarios.studies.montecarlo.spread import on_cluster, on_workers
from surefoot.scenarios.studies.montecarlo.study import (
    READINGS,
    Found,
    Row,
    bounds,
    paper_settings,
    run_study,
)
from surefoot.scenarios.studies.montecarlo.trials import (
    make_trials,
    population,
    true_motion,
    velocity_errors,
)
from surefoot.scenarios.studies.montecarlo.update_figures import (
    gap_on_one_axis,
    gap_on_three_axes,
    remark_figure,
    update_illustration,
)
from surefoot.scenarios.studies.montecarlo.update_report import remark_table, remark_words
from surefoot.scenarios.studies.montecarlo.update_study import (
    study_iterations,
    study_remark,
    update,
)
from surefoot.sim.common.errors import SurefootError


@pytest.fixture(scope="module")
def study() -> Study:
    """The bundled study, but a few short trials."""
    whole = load_study()
    return replace(
        whole, trials=2, duration=4.0,  gammas=(0.8,), population=4000, beyond_trials=2,
        beyond=whole.beyond[2:5],
    )  # fmt: skip


@pytest.fixture(scope="module")
def found(study) -> Found:
    return run_study(study)


def seeds(count: int) -> list[np.random.SeedSequence]:
    return np.random.SeedSequence(7).spawn(count)


def test_perfect_samples_lead_along_the_true_motion(study):
    truth = true_motion(study)
    found = run_imu(
        truth.t, truth.gyro, truth.accel, truth.state(), 1e-6 * np.eye(15), FilterNoise(), 1
    )
    assert np.abs(found.p_GI - truth.p_GI).max() < 1e-10
    assert np.abs(found.v_GI - truth.v_GI).max() < 1e-10
    assert np.abs(found.R_GI - truth.R_GI).max() < 1e-10


def test_the_motion_is_that_of_a_walking_base():
    truth = true_motion(load_study())
    speed = np.linalg.norm(truth.v_GI[:, :2], axis=1)
    assert 0.3 < speed.mean() < 1.2
    assert np.abs(np.diff(truth.p_GI, axis=0) * 200.0 - truth.v_GI[1:]).max() < 0.1
    assert np.abs(truth.p_GI[:, 2]).max() < 0.05


def test_a_trial_depends_on_its_own_seed_alone(study):
    truth = true_motion(study)
    two = make_trials(study, truth, BIASED.test, seeds(2))
    three = make_trials(study, truth, BIASED.test, seeds(3))
    for name in ("gyro", "accel", "v_I", "means"):
        assert np.array_equal(getattr(two, name), getattr(three, name)[:2])


def test_starts_are_drawn_from_the_covariance_that_filters_are_given(study):
    short = replace(study, duration=0.2)
    trials = make_trials(short, true_motion(short), UNBIASED.test, seeds(2000))
    b_a = trials.means[:, 5] - study.imu.bias_accel
    # At rest at the origin's height the plain velocity error is xi_v - [v]x xi_R, of `velocity`.
    v = trials.means[:, 3] - true_motion(short).v_GI[0]
    assert b_a.std(axis=0) == pytest.approx([study.prior.b_a] * 3, rel=0.08)
    assert v.std(axis=0) == pytest.approx([study.prior.velocity] * 3, rel=0.08)


@pytest.mark.parametrize("regime", [UNBIASED, BIASED], ids=lambda r: r.name)
def test_the_batch_gives_the_numbers_of_one_filter_at_a_time(study, regime):
    truth = true_motion(study)
    trials = make_trials(study, truth, regime.test, seeds(2))
    noise = FilterNoise(study.imu.gyro, study.imu.accel, 0.0, 0.0)
    rows = np.arange(1, study.updates + 1) * study.per_update
    for name, gamma, _, setting in paper_settings(study, regime, np.random.SeedSequence(1)):
        scores = run_batch(study, truth, trials, setting)
        for k in range(2):
            log = truth.t, trials.gyro[k], trials.accel[k], rows, trials.v_I[k]
            start = NavState.unpack(trials.means[k]), trials.covariance, noise, study.per_score
            if setting.epsilon is not None:
                found = run_coverage(
                    *log, setting.epsilon, gamma, *start, persistent=setting.persistent
                )
                assert found.updates is not None
                assert scores.active[k] == pytest.approx(found.updates.active.mean())
            else:
                found = run_velocity(*log, setting.R, *start, setting.persistent)
            at = slice(None, None, study.per_score)
            zeros = np.zeros((len(found.t), 3))
            reference = Trajectory(
                found.t, truth.R_GI[at], truth.v_GI[at], truth.p_GI[at], zeros, zeros
            )
            distance = np.linalg.norm(found.p_GI - reference.p_GI, axis=1)[1:]
            assert np.abs(scores.distance[k] - distance).max() < 1e-9, name
            position = nees(reference, found).position[1:]
            assert np.abs(scores.nees[k] / position - 1.0).max() < 1e-9, name


def test_the_study_is_the_same_from_the_same_seed_and_is_written_whole(study, found, tmp_path):
    first, second = found, run_study(study)
    for a, b in zip((*first.rows, *first.extras), (*second.rows, *second.extras), strict=True):
        assert np.array_equal(a.scores.nees, b.scores.nees)
        assert np.isfinite(a.scores.distance).all()
    rng = np.random.default_rng(0)
    remarks, iterated = study_remark(rng, (0.8,), 0.8, 40), study_iterations(study, (1, 3))
    write_study(first, runtime_accuracy(rng, 2, 2, 1), remarks, iterated, tmp_path)
    text = (tmp_path / "table.md").read_text()
    assert "coverage_persistent" in text
    assert all(reading in text for reading in READINGS)
    assert "(paper)" in text
    assert "<img" in (tmp_path / "report.html").read_text()
    assert {p.name for p in tmp_path.glob("*.csv")} == {
        "table.csv", "beyond.csv", "runtime.csv", "remark.csv", "iterations.csv",
    }  # fmt: skip


def test_paired_trials_say_where_coverage_pays():
    rng = np.random.default_rng(0)
    hardness = rng.lognormal(0.0, 1.0, 40)  # common to both filters: pairing takes it out

    def verdict(rmse: float, nees: float) -> str:
        rows = [
            Row("some", name, None, None, None, _constant_scores(scale[0] * hardness, scale[1]))
            for name, scale in {
                "velocity_persistent": (1.0, 6.0), "coverage_persistent": (rmse, nees),
            }.items()
        ]  # fmt: skip
        return beyond_table(rows)["coverage beside velocity"].iloc[0]

    def _constant_scores(rmse: np.ndarray, nees: float) -> Scores:
        distance = (rmse * rng.normal(1.0, 0.01, 40))[:, None]
        return Scores(distance, nees * rng.normal(1.0, 0.01, (40, 1)), np.ones(40))

    assert verdict(0.9, 3.0) == "more accurate, more consistent"
    assert verdict(1.1, 12.0) == "less accurate, less consistent"
    # Twice too sure and twice too cautious are equally far from 3.
    assert verdict(1.1, 0.5) == "less accurate, less consistent"
    assert verdict(0.9, 2.0) == "more accurate, more consistent"


@pytest.mark.parametrize("where", ["workers", "cluster"])
def test_other_processes_give_the_same_numbers(study, where):
    small = replace(study, duration=3.0, extras=())
    near = run_study(small)
    if where == "workers":
        far = run_study(small, spread=lambda jobs: on_workers(jobs, 2))
    else:
        distributed = pytest.importorskip("distributed")
        with distributed.LocalCluster(
            n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None,
            protocol="tcp://", host="127.0.0.1",
        ) as cluster:  # fmt: skip
            far = run_study(small, spread=lambda jobs: on_cluster(cluster.scheduler_address, jobs))
    for a, b in zip(near.rows, far.rows, strict=True):
        assert (a.filter, a.gamma, a.reading) == (b.filter, b.gamma, b.reading)
        assert np.array_equal(a.scores.nees, b.scores.nees)
        assert np.array_equal(a.scores.distance, b.scores.distance)


def test_a_cluster_that_is_not_there_is_one_line(study, monkeypatch):
    monkeypatch.setattr("surefoot.scenarios.datasets.cluster.PATIENCE", 0.5)
    pytest.importorskip("distributed")
    with pytest.raises(SurefootError, match=r"--cluster tcp://127\.0\.0\.1:9: ") as error:
        run_study(study, spread=lambda jobs: on_cluster("tcp://127.0.0.1:9", jobs))
    assert "\n" not in str(error.value)


def test_the_ekf_is_consistent_where_its_model_is_right(study):
    long = replace(study, duration=20.0)
    truth = true_motion(long)
    trials = make_trials(long, truth, UNBIASED.test, seeds(100))
    nees = run_batch(long, truth, trials, Setting(R=np.diag(long.noise**2))).nees
    # The mean of 100 independent chi-square numbers of 3 degrees has deviation 0.245.
    assert nees[:, -1].mean() == pytest.approx(3.0, abs=0.8)
    assert nees.mean() == pytest.approx(3.0, abs=0.6)


def test_bounds_hold_what_their_reading_says(study):
    errors = population(replace(study, population=200000), ErrorLaw(), np.random.default_rng(0))
    for reading, share in zip(READINGS, (0.8**3, 0.8), strict=True):
        inside = (np.abs(errors) <= bounds(errors, 0.8, reading)).all(axis=1)
        assert inside.mean() == pytest.approx(share, abs=5e-3)


@pytest.mark.parametrize("mixing", MIXINGS)
def test_mixing_parts_have_zero_mean_and_the_stated_covariance(study, mixing):
    rng = np.random.default_rng(0)
    errors = velocity_errors(study, ErrorLaw(mixing=mixing), 400000, rng) / study.noise
    assert np.abs(errors.mean(axis=0)).max() < 0.02
    if mixing == "outliers":
        assert np.var(errors, axis=0) == pytest.approx([0.95 + 0.05 * 100] * 3, rel=0.05)
    elif mixing == "student":
        # Its fourth moment is infinite, so the variance is slow to show; the median is not.
        assert np.median(np.abs(errors)) == pytest.approx(0.7649 / np.sqrt(3), rel=0.02)
    else:
        assert np.var(errors, axis=0) == pytest.approx([1.0] * 3, rel=0.03)


def test_qmc_is_a_fair_peer():
    p = np.array([1e-200, 1e-10, 0.01, 0.3, 0.5, 0.7, 0.999])
    assert [_phi_inverse(x) for x in p] == pytest.approx(ndtri(p), abs=1e-13)
    rng = np.random.default_rng(3)
    cov = np.array([[1.0, 0.5, -0.2], [0.5, 1.0, 0.3], [-0.2, 0.3, 1.0]])
    box = np.array([0.1, 0.0, -0.2]), cov, np.array([-0.5, -1.0, 0.2]), np.array([1.0, 0.8, 2.0])
    mean, spread = np.empty(3), np.empty((3, 3))
    probability = qmc_moments(*box, 200000, rng.random(3), mean, spread)
    exact = tensor_moments(*box)
    assert probability == pytest.approx(exact[0], rel=1e-4)
    assert mean == pytest.approx(exact[1], abs=1e-4)
    assert spread == pytest.approx(exact[2], abs=1e-4)


def test_sampling_errors_decay_as_the_papers_and_ours_are_a_million_times_less():
    rows = {row.samples: row for row in runtime_accuracy(np.random.default_rng(0), rounds=1)}
    ours = rows[None]
    for name in ("probability", "mean", "covariance"):
        few, many = getattr(rows[100], name), getattr(rows[10000], name)
        assert many < few / 15
        assert getattr(ours, name) < 1e-6 * getattr(rows[1000], name)


def test_the_remark_is_studied_where_it_is_proved_and_where_it_is_not():
    exact, *others = study_remark(np.random.default_rng(1), (0.8,), 0.8, 400)
    assert exact.active > 200
    assert (exact.raised, exact.within, exact.breach) == (1.0, 1.0, None)
    assert 0.3 < exact.closed < exact.after_five < 1.0
    assert [row.way for row in others] == [
        "moments from 1000 samples", "moments from 100 samples",
        "in the filter, attitude known to 0.1 rad", "in the filter, attitude known to 2 rad",
    ]  # fmt: skip
    assert min(row.within for row in others) > 0.98
    assert len(remark_table([exact, *others])) == 5
    assert f"all {exact.active} random boxes" in remark_words([exact, *others])


def test_the_map_of_the_remark_is_empty_where_nothing_is_to_be_done():
    share = gap_on_one_axis(np.array([0.0, 4.0]), np.array([0.5, 3.0]), 0.8)
    assert np.isnan(share[1, 0])
    assert np.all((share[0] > 0) & (share[0] < 1))
    cubes = gap_on_three_axes(np.array([0.0, 3.0]), np.array([-0.4, 0.0, 0.9]), 1.0, 0.8)
    assert np.all((cubes > 0) & (cubes < 1))
    assert len(update_illustration().axes) == 6
    assert len(remark_figure().axes) == 4


def test_an_inactive_box_is_left_alone():
    wide = np.full(3, 6.0)
    pi, mean, cov = update(np.zeros(3), np.eye(3), -wide, wide, 0.8)
    assert pi > 0.8
    assert np.array_equal(mean, np.zeros(3))
    assert np.array_equal(cov, np.eye(3))


def test_iterations_start_from_the_row_of_the_papers_table(study, found):
    first, third, *_ = study_iterations(study, (1, 3))
    rows = {(r.regime, r.filter, r.reading): r for r in found.rows}
    paper = rows["unbiased", "coverage", READINGS[1]]
    assert np.array_equal(first.scores.nees, paper.scores.nees)
    assert not np.array_equal(third.scores.nees, paper.scores.nees)


@pytest.mark.parametrize(
    ("before", "after", "says"),
    [
        ("trials = 100", "trails = 100", "unknown key 'trails'"),
        ("turn = 0.15", "turns = 0.15", "unknown key 'motion.turns'"),
        ('mixing = "student"', 'mixing = "cauchy"', "mixing 'cauchy' is unknown"),
        ("update_rate = 20.0", "update_rate = 30.0", "update_rate must divide imu_rate"),
        ("calibration_trials = 24", "calibration_trials = 3", "calibration_trials"),
        ("gammas = [0.70,", "gammas = [1.70,", "gammas must be inside (0, 1)"),
        ("seed = 2026", "", "'seed' is missing"),
        ("std = [0.08, 0.06, 0.05]", "std = [0.08, 0.06]", "'noise.std' must be three"),
    ],
)
def test_a_bad_study_file_is_one_line_that_names_the_key(tmp_path, before, after, says):
    text = BUNDLED.read_text()
    assert before in text
    path = tmp_path / "study.toml"
    path.write_text(text.replace(before, after))
    with pytest.raises(SurefootError) as caught:
        load_study(path)
    assert says in str(caught.value)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_command_refuses_bad_options(tmp_path):
    for option in (
        ["--trials", "1"], ["--seed", "-1"], ["--workers", "0"],
        ["--cluster", "tcp://x:1", "--workers", "2"],
    ):  # fmt: skip
        with pytest.raises(SystemExit) as caught:
            main(["montecarlo", "-o", str(tmp_path / "out"), *option])
        assert option[0] in str(caught.value)
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "a").write_text("")
    with pytest.raises(SurefootError, match="not empty"):
        montecarlo(tmp_path / "full", trials=2)
