"""The Monte-Carlo study: trials that are what they claim, and the batch that runs them."""

from dataclasses import replace

import numpy as np
import pytest
from refusals import refusal, refused
from scipy.special import ndtri
from whole_runs import run_imu

from studies.command import run_study
from studies.montecarlo.numpy_reference import numpy_moments, numpy_trial
from studies.montecarlo.qmc import (
    _phi_inverse,
    qmc_moments,
    runtime_accuracy,
    tensor_moments,
)
from studies.montecarlo.report import MonteCarlo, montecarlo, write_study
from studies.montecarlo.settings import (
    BIASED,
    MIXING_LAWS,
    MONTECARLO_PLAN,
    UNBIASED,
    ErrorLaw,
    MonteCarloStudy,
    load_study,
)
from studies.montecarlo.study import (
    ITERATIONS,
    PER_AXIS,
    READINGS,
    Results,
    Scores,
    Setting,
    bounds,
    compared,
    paper_settings,
    run_batch,
    run_montecarlo,
    run_trials,
)
from studies.montecarlo.trials import make_trials, population, true_motion, velocity_errors
from studies.montecarlo.update import update_illustration
from surefoot.estimator.box import box_moments
from surefoot.estimator.core.lie import hat
from surefoot.estimator.core.state import FilterNoise, NavState
from surefoot.estimator.filter import InvariantFilter
from surefoot.scenarios.reporting.pages import read_origin


@pytest.fixture(scope="module")
def study() -> MonteCarloStudy:
    """The bundled study, but a few short trials."""
    whole = load_study()
    beyond = replace(whole.beyond, trials=2, regime=whole.beyond.regime[2:5])
    short = {"trials": 2, "duration": 4.0, "gammas": (0.8,), "population": 4000}
    return replace(whole, **short, beyond=beyond)


@pytest.fixture(scope="module")
def found(study) -> Results:
    return run_montecarlo(study)


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
def test_scores_are_those_of_the_filters_one_sample_at_a_time(study, regime):
    truth = true_motion(study)
    trials = make_trials(study, truth, regime.test, seeds(2))
    noise = FilterNoise(study.imu.gyro, study.imu.accel, 0.0, 0.0)
    for setting in paper_settings(study, regime, np.random.SeedSequence(1)):
        scores = run_trials(study, truth, trials, setting)
        for k in range(2):
            start = NavState.unpack(trials.means[k]), trials.covariance
            f = InvariantFilter(*start, noise, setting.persistent)
            distance, nees = [], []
            for n in range(1, len(truth.t)):
                f.predict(trials.gyro[k, n], trials.accel[k, n], truth.t[n] - truth.t[n - 1])
                if n % study.per_update == 0:
                    v_I = trials.v_I[k, n // study.per_update - 1]
                    if setting.R is not None:
                        f.update_velocity(v_I, setting.R)
                    else:
                        assert setting.epsilon is not None
                        assert setting.gamma is not None
                        f.update_coverage(v_I, setting.epsilon, setting.gamma)
                if n % study.per_score == 0:
                    p = f.state.p_GI
                    error = p - truth.p_GI[n]
                    J = np.hstack([-hat(p), np.zeros((3, 3)), np.eye(3)])
                    S = J @ f.covariance[:9, :9] @ J.T
                    distance.append(np.linalg.norm(error))
                    nees.append(error @ np.linalg.solve(S, error))
            assert np.abs(scores.distance[k] - distance).max() < 1e-9, setting.filter
            assert np.abs(scores.nees[k] / nees - 1.0).max() < 1e-9, setting.filter
        assert np.all((scores.active > 0) & (scores.active <= 1)), setting.filter


@pytest.mark.long
def test_the_study_is_the_same_from_the_same_seed_and_is_written_whole(study, found, tmp_path):
    first, second = found, run_montecarlo(study)
    assert first == second
    assert all(np.isfinite([*row.rmse, *row.nees]).all() for row in (*first.paper, *first.beyond))
    rng, page = np.random.default_rng(0), tmp_path / "page.md"
    write_study(first, runtime_accuracy(rng, 2, 2, 1), tmp_path, page=page)
    text = (tmp_path / "table.md").read_text()
    assert "coverage_persistent" in text
    assert all(reading in text for reading in READINGS)
    assert "(paper)" in text
    assert "<img" in (tmp_path / "report.html").read_text()
    tables = {"table", "beyond", "runtime", "paper", "regimes", "iterations"}
    assert {p.stem for p in tmp_path.glob("*.csv")} == tables
    figures = {p.stem for p in (tmp_path / "figures").glob("*.png")}
    assert figures == {"runtime", "nees_by_gamma", "over_time", "update"}
    assert not read_origin(page).stale
    assert "Nearest to the paper's NEES" in page.read_text()


def test_paired_trials_say_where_coverage_pays():
    rng = np.random.default_rng(0)
    hardness = rng.lognormal(0.0, 1.0, 40)  # common to both filters: pairing takes it out

    def scores(rmse: np.ndarray, nees: float) -> Scores:
        distance = (rmse * rng.normal(1.0, 0.01, 40))[:, None]
        return Scores(distance, nees * rng.normal(1.0, 0.01, (40, 1)), np.ones(40))

    def verdict(rmse: float, nees: float) -> str:
        return compared(scores(rmse * hardness, nees), scores(hardness, 6.0))

    assert verdict(0.9, 3.0) == "more accurate, more consistent"
    assert verdict(1.1, 12.0) == "less accurate, less consistent"
    # Twice too sure and twice too cautious are equally far from 3.
    assert verdict(1.1, 0.5) == "less accurate, less consistent"
    assert verdict(0.9, 2.0) == "more accurate, more consistent"


@pytest.mark.parametrize("where", ["workers", "cluster"])
def test_other_processes_give_the_same_numbers(study, where):
    small = replace(study, duration=3.0, beyond=replace(study.beyond, regime=()))
    near = run_montecarlo(small)
    if where == "workers":
        far = run_montecarlo(small, workers=2)
    else:
        distributed = pytest.importorskip("distributed")
        plain = {"processes": False, "dashboard_address": None, "protocol": "tcp://"}
        with distributed.LocalCluster(
            n_workers=1, threads_per_worker=1, host="127.0.0.1", **plain
        ) as cluster:
            far = run_montecarlo(small, cluster=cluster.scheduler_address)
    assert near == far


def test_a_study_that_was_stopped_goes_on_where_it_was(study, monkeypatch, tmp_path):
    small = replace(study, duration=2.0, beyond=replace(study.beyond, regime=()))
    whole = run_montecarlo(small, data=tmp_path)
    cases = sorted(path.name for path in tmp_path.iterdir())
    assert cases == [f"{t}_{r}.json" for t in ("iterated", "paper") for r in ("biased", "unbiased")]
    (tmp_path / "paper_biased.json").unlink()
    ran = []
    monkeypatch.setattr(
        "studies.montecarlo.study.run_batch",
        lambda study, batch, *_: ran.append(batch.regime.name) or run_batch(study, batch),
    )
    assert run_montecarlo(small, data=tmp_path) == whole
    assert ran == ["biased"]
    run_montecarlo(replace(small, seed=1), data=tmp_path)
    assert len(ran) == 5


def test_the_ekf_is_consistent_where_its_model_is_right(study):
    long = replace(study, duration=20.0)
    truth = true_motion(long)
    trials = make_trials(long, truth, UNBIASED.test, seeds(100))
    nees = run_trials(long, truth, trials, Setting("velocity", R=np.diag(long.noise_std**2))).nees
    # The mean of 100 independent chi-square numbers of 3 degrees has deviation 0.245.
    assert nees[:, -1].mean() == pytest.approx(3.0, abs=0.8)
    assert nees.mean() == pytest.approx(3.0, abs=0.6)


def test_bounds_hold_what_their_reading_says(study):
    errors = population(replace(study, population=200000), ErrorLaw(), np.random.default_rng(0))
    for reading, share in zip(READINGS, (0.8**3, 0.8, 0.99**3, 0.999**3), strict=True):
        inside = (np.abs(errors) <= bounds(errors, 0.8, reading)).all(axis=1)
        assert inside.mean() == pytest.approx(share, abs=5e-3)


@pytest.mark.parametrize("mixing", MIXING_LAWS)
def test_mixing_parts_have_zero_mean_and_the_stated_covariance(study, mixing):
    rng = np.random.default_rng(0)
    errors = velocity_errors(study, ErrorLaw(mixing=mixing), 400000, rng) / study.noise_std
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


def test_iterations_start_from_the_row_of_the_papers_table(found):
    first, second, third, *_ = found.iterated
    assert (first.iterations, second.iterations, third.iterations) == ITERATIONS
    rows = {(r.regime, r.filter, r.reading): r for r in found.paper}
    paper = rows["unbiased", "coverage", PER_AXIS]
    assert first.nees == paper.nees
    assert third.nees != paper.nees


@pytest.mark.parametrize(
    ("before", "after", "says"),
    [
        ("trials = 100", "trails = 100", "unknown key 'trails'"),
        ("update_rate = 20.0", "update_rate = 30.0", "update_rate must divide imu_rate"),
        ("calibration_trials = 24", "calibration_trials = 3", "calibration_trials"),
    ],
)
def test_a_bad_study_file_is_one_line_that_names_the_key(tmp_path, before, after, says):
    text = MONTECARLO_PLAN.read_text()
    assert before in text
    path = tmp_path / "study.toml"
    path.write_text(text.replace(before, after))
    caught = refusal(load_study, path)
    assert says in caught
    assert str(path) in caught


def test_the_command_refuses_bad_options(tmp_path):
    for option in (
        ["--trials", "1"],
        ["--trials", "1000000000000"],
        ["--seed", "-1"],
        ["--workers", "0"],
        ["--cluster", "tcp://x:1", "--workers", "2"],
    ):
        with pytest.raises(SystemExit) as caught:
            run_study(MonteCarlo, ["-o", str(tmp_path / "out"), *option])
        assert option[0] in str(caught.value)
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "a").write_text("")
    refused("not empty", montecarlo, MonteCarlo(tmp_path / "full", trials=2))


@pytest.mark.parametrize("gamma", [0.6, 0.8])
def test_the_illustration_draws_the_densities_of_the_theorem(gamma):
    """Each integrates to one; the posterior has gamma inside the set, the prior less."""
    axis = update_illustration(gamma).axes[2]
    (z, p), (_, q), (_, matched) = (np.asarray(c.get_xydata()).T for c in axis.get_lines()[:3])
    inside, step = (z >= 0.5) & (z <= 1.6), z[1] - z[0]
    for density in (p, q, matched):
        assert np.sum(density) * step == pytest.approx(1.0, abs=5e-3)
    assert np.sum(q[inside]) * step == pytest.approx(gamma, abs=5e-3)
    assert np.sum(p[inside]) * step < gamma
    assert q @ z * step == pytest.approx(matched @ z * step, abs=0.02)


@pytest.mark.parametrize("kind", ["gaussian", "coverage"])
def test_the_filters_are_the_textbooks(kind):
    study = replace(load_study(), duration=4.0)
    truth = true_motion(study)
    seeds = np.random.SeedSequence(11).spawn(2)
    trials = make_trials(study, truth, BIASED.test, seeds)
    setting = Setting("velocity", R=np.diag(study.noise_std**2))
    if kind == "coverage":
        setting = Setting("coverage", epsilon=1.5 * study.noise_std, gamma=0.8)
    found = run_trials(study, truth, trials, setting).distance
    for k in range(2):
        plain = numpy_trial(study, truth, trials, k, setting)
        # The integrators differ by what second order leaves of a step: far below a millimetre.
        assert np.abs(found[k] - plain).max() < 5e-4


def test_the_moments_in_numpy_are_those_of_the_filter():
    rng = np.random.default_rng(0)
    for _ in range(20):
        A = np.eye(3) + 0.3 * rng.standard_normal((3, 3))
        cov, centre, half = A @ A.T, rng.uniform(-1, 1, 3), rng.uniform(0.5, 2, 3)
        pi, mean, spread = numpy_moments(cov, centre - half, centre + half)
        log_prob, m, C = box_moments(np.zeros(3), cov, centre - half, centre + half)
        assert abs(np.log(pi) - log_prob) < 1e-8
        assert np.abs(mean - m).max() < 1e-8
        assert np.abs(spread - C).max() < 1e-8
