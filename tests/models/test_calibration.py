"""Bounds hold as often as they say, and are those of an independent implementation."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from scipy.stats import binomtest
from synthetic import Body, synthetic_walk

from surefoot.models.calibration.calibrate import (
    calibrate,
    left_out_coverage,
    region_of,
    require_samples,
    subsample,
    unseen_errors,
)
from surefoot.models.calibration.empirical_coverage import (
    SLIPPERY,
    binomial_interval,
    bounded_errors,
    coverage,
    coverage_by,
    stride_phase,
    walking_conditions,
)
from surefoot.models.calibration.mixing import LONGEST_LAG, beta_coefficient, discretise
from surefoot.models.calibration.regions import (
    ERROR_STEP,
    BoundsError,
    calibrator,
    conformal_quantile,
    errors_needed,
    level_per_axis,
    rank,
    walk_enough,
)
from surefoot.models.calibration.settings import CalibrateSettings
from surefoot.models.observer.predict import judged, predict, prediction_errors
from surefoot.models.observer.samples import RATE
from surefoot.sim.log import LEGS, Log


def test_what_is_said_to_suffice_does_however_slowly_errors_forget():
    """At the longest lag that the mixing curve looks at, and with no error less."""
    for gamma, method in ((0.8, "conformal"), (0.8, "maxnorm"), (0.95, "outer")):
        how = calibrator(method, gamma)
        enough = errors_needed(how) * LONGEST_LAG
        require_samples(how, enough, LONGEST_LAG)
        with pytest.raises(BoundsError, match="independent samples"):
            require_samples(how, enough - 1, LONGEST_LAG)
    assert ERROR_STEP == 1.0 / RATE
    enough = errors_needed(calibrator("conformal", 0.8)) * LONGEST_LAG
    assert walk_enough(0.8) == pytest.approx(enough / RATE)


def test_the_counts_of_the_paper():
    """RoomScan: 66.97 s at 100 Hz with K = 20 gives N = 334 and k = 311 at gamma = 0.8."""
    chosen = subsample(np.zeros((6697, 3)), 20)
    assert len(chosen) == 334
    assert level_per_axis(0.8) == pytest.approx(0.9283, abs=5e-5)
    assert rank(len(chosen), level_per_axis(0.8)) == 311


@given(n=st.integers(1, 500), tenths=st.integers(1, 9))
def test_rank_is_exact_where_the_product_is_whole(n, tenths):
    assert rank(n, tenths / 10) == -(-(n + 1) * tenths // 10)


def test_calibration_covers_a_walk_not_seen(mse_observer, walks):
    bounds = calibrate(mse_observer, walks["calibrate"], CalibrateSettings(gamma=0.8, K=20), Body())
    assert (bounds.K, bounds.n, bounds.mixing) == (20, 300, None)
    _, errors = prediction_errors(mse_observer, walks["test"], Body())
    found = coverage(errors, bounds)
    # Axes that err together are covered together more often than gamma.
    assert found.joint_interval[1] > 0.8
    per_axis = (np.abs(errors) <= bounds.epsilon).mean(axis=0)
    highest = [binomial_interval(share, found.n)[1] for share in per_axis]
    assert min(highest) > bounds.level_per_axis - 0.05


def test_the_spacing_comes_from_the_mixing_curve(bounds):
    assert bounds.mixing is not None
    assert bounds.K == bounds.mixing.K
    assert bounds.n == 6000 // bounds.K
    assert bounds.mixing.beta.shape == (len(bounds.mixing.lags), 3)


def test_what_the_observer_has_seen_cannot_calibrate_it(mse_observer, walks):
    renamed = replace(walks["fit"], name="other")
    with pytest.raises(BoundsError, match=r"other: the observer was trained on it \(as fit\)"):
        calibrate(mse_observer, renamed, robot=Body())


def test_errors_of_several_walks_are_pooled(mse_observer, walks):
    """As many as in all of them, ranked together; what is said of a walk left out is measured."""
    several, how = [walks["calibrate"], walks["test"]], CalibrateSettings(K=20)
    bounds = calibrate(mse_observer, several, how, Body())
    unseen = unseen_errors(mse_observer, several, Body())
    errors = unseen.relative
    assert unseen.names == [log.name for log in several]
    chosen = np.concatenate([subsample(part, 20) for part in errors])
    assert bounds.n == len(chosen)
    ranked = conformal_quantile(np.abs(chosen), bounds.level_per_axis)
    assert np.array_equal(bounds.epsilon, ranked)
    alone = calibrate(mse_observer, walks["calibrate"], how, Body())
    shares = left_out_coverage(errors, how, 20)
    assert shares[1] == coverage(errors[1], alone).joint
    assert bounds.persistent is not None
    assert bounds.persistent.nu >= 2.0
    with pytest.raises(BoundsError, match="trained on it"):
        calibrate(mse_observer, [walks["test"], walks["fit"]], how, Body())


def test_errors_of_different_walks_are_not_compared():
    """The second walk begins as the first ends: that is no dependence within either."""
    rng, lag = np.random.default_rng(0), 1000
    first = rng.standard_normal(2000)
    states = discretise(np.concatenate([first, first[1000:], rng.standard_normal(1000)]))
    apart = beta_coefficient(states, lag, np.repeat([0, 1], 2000))
    assert apart < 0.12 < 0.25 < beta_coefficient(states, lag)


def test_a_short_log_is_refused(mse_observer):
    with pytest.raises(BoundsError, match="needs 13"):
        calibrate(mse_observer, synthetic_walk(8, 2.0), CalibrateSettings(K=20), Body())
    with pytest.raises(BoundsError, match="needs 13"):
        calibrate(mse_observer, synthetic_walk(8, 0.1), robot=Body())


@pytest.mark.parametrize("K", [0, -5])
def test_errors_are_at_least_a_step_apart(mse_observer, walks, K):
    with pytest.raises(BoundsError, match=f"K = {K}: must be 1 at least"):
        calibrate(mse_observer, walks["calibrate"], CalibrateSettings(K=K), Body())


def test_a_turned_box_still_holds_all_it_held(bounds):
    corners = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, 8).T * bounds.epsilon
    R = Rotation.from_euler("xyz", [0.4, 0.2, -1.0]).as_matrix()
    # A corner touches each side: no smaller box along the new axes would do.
    assert np.abs(corners @ R).max(axis=0) == pytest.approx(bounds.epsilon_at(R))
    quarter = Rotation.from_euler("z", 90, degrees=True).as_matrix()
    assert bounds.epsilon_at(quarter) == pytest.approx(bounds.epsilon[[1, 0, 2]])


def test_bounds_of_a_gml_observer_follow_what_it_predicts(gml_observer, walks):
    """A multiple of the predicted standard deviation, the same in every frame of the IMU."""
    bounds = calibrate(gml_observer, walks["calibrate"], CalibrateSettings(K=20), Body())
    assert bounds.scaled
    log = walks["test"]
    prediction = predict(gml_observer, log, Body())
    rows, errors, covariance = judged(prediction, log)
    assert covariance is not None
    epsilon = bounds.epsilon_at(np.eye(3), covariance)
    std = np.sqrt(np.einsum("mii->mi", covariance))
    assert epsilon == pytest.approx(bounds.epsilon * std)
    inside = (np.abs(errors) <= epsilon).all(axis=1)
    at, relative = bounded_errors(prediction, bounds, log, Body().R_BI)
    assert np.array_equal(at, rows)
    assert coverage(relative, bounds).joint == inside.mean()
    # In another frame: the same errors and statements, and a box around the same box.
    R = Rotation.from_euler("xyz", [0.4, 0.2, -1.0]).as_matrix()
    turned = np.einsum("ji,mjk,kl->mil", R, covariance, R)
    assert bounds.relative(errors @ R, R, turned) == pytest.approx(relative)
    corners = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, 8).T
    around = np.abs((corners * epsilon[:, None]) @ R).max(axis=1)
    assert bounds.epsilon_at(R, turned) == pytest.approx(around)
    with pytest.raises(BoundsError, match="none are predicted"):
        bounds.epsilon_at(np.eye(3))


def test_a_learnt_scale_keeps_the_level_and_knows_the_situation():
    """Exchangeable errors, ten times as large in a tenth of the time: bounds in standard deviations
    have the level in both cases, those in m/s in all together alone, since axes err together.
    """
    rng, gamma = np.random.default_rng(0), 0.8
    held: dict[bool, list[tuple[float, float]]] = {True: [], False: []}
    for _ in range(200):
        std = np.where(rng.random(1200) < 0.1, 1.0, 0.1)
        guess = std * rng.uniform(0.8, 1.25, 1200)  # predicted: right but for a fifth
        errors = std[:, None] * rng.standard_normal((1200, 3))
        for scaled, found in held.items():
            used = errors / guess[:, None] if scaled else errors
            region = region_of(calibrator("conformal", gamma), used[:0], used[:200])
            inside, large = region.contains(used[200:]), std[200:] == 1.0
            found.append((inside.mean(), inside[large].mean()))
    share, of_large = np.mean(held[True], axis=0)
    assert gamma - 0.01 < share < gamma + 0.02
    assert gamma - 0.05 < of_large < gamma + 0.05
    share, of_large = np.mean(held[False], axis=0)
    assert share > gamma - 0.01
    assert of_large < 0.1


@given(hits=st.integers(0, 40), n=st.integers(40, 60))
def test_intervals_are_those_of_scipy(hits, n):
    theirs = binomtest(hits, n).proportion_ci(0.95, method="exact")
    assert binomial_interval(hits / n, n) == pytest.approx([theirs.low, theirs.high], abs=1e-9)


def test_coverage_is_split_by_what_the_log_tells(bounds, walks):
    """Errors that leave the bounds in one known case alone are laid to that case."""
    log = walks["test"]
    frame = log.frame.copy()
    n, t = len(frame), log.t
    for i, leg in enumerate(LEGS):
        frame[f"slip_{leg}"] = np.where((t > 20) & (t < 30) & (i == 1), 0.3, 0.01)
        frame[f"mu_{leg}"] = 0.8
        frame[f"contact_{leg}"] = (np.floor(4 * t) % 2 == i % 2).astype(float)
    height = np.interp(t, [0, 40, 50, 54, 56, 60], [0, 0, 5, 5, 4, 4])
    frame["ref_p_z"], frame["ref_p_x"], frame["ref_p_y"] = height, t, 0.0
    marked = replace(log, frame=frame)
    rows = np.arange(0, n, 5)
    bounds = replace(bounds, K=20)
    errors = np.zeros((len(rows), 3))
    slips = (t[rows] > 20) & (t[rows] < 30)
    errors[slips, 0] = 2 * bounds.epsilon[0]
    found = {(c.split, c.case): c for c in coverage_by(marked, rows, errors, bounds)}
    assert found["slip", "a foot slips"].joint == 0.0
    assert found["slip", "no foot slips"].joint == 1.0
    assert found["slip", "a foot slips"].time == pytest.approx(1 / 6, abs=0.002)
    assert found["slip", "a foot slips"].n == pytest.approx(50, abs=1)
    assert found["terrain", "climbing"].time == pytest.approx(1 / 6, abs=0.04)
    assert found["terrain", "climbing"].joint == 1.0
    assert found["terrain", "descending"].time == pytest.approx(2 / 60, abs=0.04)
    assert ("ground", "friction below 0.4") not in found
    quarters = [c for (split, _), c in found.items() if split == "stride"]
    assert [c.time for c in quarters] == pytest.approx([0.25] * 4, abs=0.02)
    bare = Log(log.frame[["t"]], log.meta, "bare")
    assert coverage_by(bare, rows, errors, bounds) == []


def test_phase_runs_from_touchdown_to_touchdown():
    t = np.arange(400) / 100
    contact = (t % 0.5) < 0.3
    contact[(t > 0.62) & (t < 0.64)] = False  # a bounce
    phase = stride_phase(t, contact)
    assert np.isnan(phase[:50]).all()
    assert phase[50:350] == pytest.approx((t[50:350] / 0.5) % 1.0, abs=0.05)


def test_friction_is_that_under_the_foot_that_bears_least():
    """Feet that slip not at all are in the air, or stand as a rock does: they say nothing."""
    log = synthetic_walk(0, 1.0)
    n = len(log.t)
    slip, mu = np.zeros((n, 4)), np.full((n, 4), 0.8)
    slip[100:300, 1], slip[200:400, 2] = 1e-3, 0.5
    mu[100:200, 1], mu[150:160, 3] = 0.3, 0.05
    columns = {f"slip_{leg}": slip[:, i] for i, leg in enumerate(LEGS)}
    columns |= {f"mu_{leg}": mu[:, i] for i, leg in enumerate(LEGS)}
    simulated, rows = replace(log, frame=log.frame.assign(**columns)), np.arange(0, n, 5)
    found = {case: rows[where] for split, case, where in walking_conditions(simulated, rows)}
    assert found[f"friction below {SLIPPERY:g}"].tolist() == list(range(100, 200, 5))
    assert found["dry"].tolist() == list(range(200, 400, 5))
    assert found["a foot slips"].tolist() == list(range(200, 400, 5))
