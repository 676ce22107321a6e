"""Each method's region holds as often as it says: on exchangeable errors, on errors that remember,
and on axes that err together; and its quantile is that of an independent implementation."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mapie_quantile import mapie_quantile
from refusals import refused
from scipy.optimize import linprog
from scipy.stats import binom
from synthetic import gauss_markov

from surefoot.models.calibration.calibrate import region_of
from surefoot.models.calibration.mixing import mixing
from surefoot.models.calibration.regions import BoundsError, Region, calibrator, rank
from surefoot.models.calibration.scenario_box import (
    _discarded_box,
    discards,
    log_failure,
    scenario_box,
)
from surefoot.models.registry import CALIBRATORS

TRIALS = 1000
PER_AXIS = ("conformal", "outer")
SPLIT = [m for m in CALIBRATORS.bundled if m != "scenario"]


def region(method, pilot, errors, gamma=0.8):
    """Fitted to errors (n, 3), ranked on others (N, 3)."""
    return region_of(calibrator(method, gamma), pilot, errors)


def level_of(method, gamma):
    return calibrator(method, gamma).level


@pytest.mark.parametrize("method", SPLIT)
def test_quantiles_are_those_of_mapie(method):
    rng = np.random.default_rng(0)
    pilot, errors = rng.standard_t(4, (100, 3)), rng.standard_t(4, (150, 3)) * [1.0, 0.5, 2.0]
    found, level = region(method, pilot, errors), level_of(method, 0.8)
    if method in PER_AXIS:
        theirs = [mapie_quantile(np.abs(axis), level) for axis in errors.T]
        assert found.epsilon == pytest.approx(theirs, rel=1e-12)
    else:
        scale = np.sqrt((pilot**2).mean(axis=0))
        theirs = scale * mapie_quantile(np.abs(errors / scale).max(axis=1), level)
        assert found.epsilon == pytest.approx(theirs, rel=1e-12)


def hits(method, draw, n, rng, gamma=0.8, pilot=60):
    """Over TRIALS calibrations: whether the region held the next error of its own record."""
    found = 0
    for _ in range(TRIALS):
        errors = draw(rng, pilot + n + 1)
        found += region(method, errors[:pilot], errors[pilot:-1], gamma).contains(errors[-1:])[0]
    return found


def heavy(rng, n):
    return rng.standard_t(3, (n, 3)) * [1.0, 0.3, 0.1]


@pytest.mark.parametrize("method", SPLIT)
def test_exchangeable_errors_are_held_as_promised(method):
    n, gamma = 150, 0.8
    exact = rank(n, level_of(method, gamma)) / (n + 1)
    if method in PER_AXIS:
        exact = exact**3  # the axes are independent here
    found = hits(method, heavy, n, np.random.default_rng(1), gamma)
    low, high = binom.interval(0.999, TRIALS, exact)
    assert low <= found <= high
    assert exact >= gamma - 1e-12


def test_a_scenario_box_keeps_its_confidence():
    """At most 5 % of calibrations may give a box that holds less than gamma; here most of it."""
    rng, gamma, n = np.random.default_rng(2), 0.8, 200
    held = np.empty(TRIALS)
    for i in range(TRIALS):
        box = scenario_box(rng.uniform(-1, 1, (n, 3)), gamma, 0.95)
        held[i] = np.prod(box)  # of a uniform law, exactly
    failed = int((held < gamma).sum())
    assert failed <= binom.ppf(0.999, TRIALS, 0.05)
    assert held.mean() < gamma + 0.12


def autoregression(rng, n):
    return gauss_markov(rng, n, 0.9)


def regimes(rng, n):
    """Quiet and loud stretches of 40 samples on average, by a hidden two-state chain."""
    stays = rng.geometric(1 / 40, n // 10 + 20)
    loud = np.repeat(np.arange(len(stays)) + rng.integers(2), stays)[:n] % 2 == 1
    return rng.standard_normal((n, 3)) * np.where(loud, 1.5, 0.3)[:, None]


@pytest.mark.parametrize("process", [autoregression, regimes])
@pytest.mark.parametrize("method", CALIBRATORS.bundled)
def test_errors_that_remember_are_held_as_promised(method, process):
    """Errors K apart, K from the curve of one long record; judged far beyond each record's end."""
    rng, gamma = np.random.default_rng(3), 0.8
    n = max(60, calibrator(method, gamma).samples_needed())
    K = mixing(process(rng, 20_000)).K
    gap, found = 10, 0
    for _ in range(TRIALS):
        errors = process(rng, K * (20 + n + gap))[K - 1 :: K]
        found += region(method, errors[:20], errors[20 : 20 + n]).contains(errors[-1:])[0]
    if method == "scenario":
        assert found >= binom.ppf(0.001, TRIALS, gamma)
        return
    level = rank(n, level_of(method, gamma)) / (n + 1)
    split_axes = method in PER_AXIS
    # Axes that turn loud together are held together more often than independent ones.
    lowest = level**3 if split_axes else level
    highest = level if split_axes and process is regimes else lowest
    assert binom.ppf(0.0005, TRIALS, lowest) <= found <= binom.ppf(0.9995, TRIALS, highest)


def test_which_way_the_product_of_levels_errs():
    """gamma^(1/3) an axis: exact for independent axes, too much for axes that err together, and
    too little for axes of which one errs just when the others do not."""
    rng, n, gamma = np.random.default_rng(5), 200_000, 0.8
    u = rng.uniform(size=n)

    def spread(shift):
        return np.abs((u + shift) % 1.0)[:, None]

    laws = {
        "independent": rng.uniform(size=(n, 3)),
        "together": np.hstack([spread(0.0)] * 3),
        "in turn": np.hstack([spread(k / 3) for k in range(3)]),
    }
    held = {}
    for name, errors in laws.items():
        for method in ("conformal", "maxnorm"):
            found = region(method, errors, errors[:5000])
            held[name, method] = found.contains(errors[5000:]).mean()
    assert held["independent", "conformal"] == pytest.approx(gamma, abs=0.02)
    assert held["together", "conformal"] == pytest.approx(gamma ** (1 / 3), abs=0.02)
    assert held["in turn", "conformal"] == pytest.approx(3 * gamma ** (1 / 3) - 2, abs=0.02)
    assert held["in turn", "conformal"] < gamma - 0.01
    assert all(abs(held[name, "maxnorm"] - gamma) < 0.02 for name in laws)


@given(seed=st.integers(0, 50), n=st.integers(60, 120))
def test_the_scenario_box_is_the_linear_program_of_what_is_kept(seed, n):
    errors = np.random.default_rng(seed).standard_t(3, (n, 3))
    box = scenario_box(errors, 0.8, 0.95)
    outside = ~Region(box).contains(errors)
    assert outside.sum() == discards(n, 0.8, 0.95)  # each discarded constraint is violated
    kept = np.log(np.abs(errors[~outside]))
    rows = np.vstack([-np.eye(3)] * len(kept))
    solved = linprog(np.ones(3), rows, -kept.ravel(), bounds=(None, None))
    assert np.exp(solved.x) == pytest.approx(box, rel=1e-7)


@pytest.mark.parametrize("turn", range(3))
def test_what_frees_most_is_discarded_first(turn):
    """A sample that is the largest of two axes, before one that is larger on a third."""
    sizes = np.array([[2.0, 2.0, 1.0], [1.0, 1.0, 3.0], [1.0, 1.0, 1.0]])
    turned = np.ascontiguousarray(np.roll(sizes, turn, axis=1))
    assert _discarded_box(turned, 1).tolist() == np.roll([1.0, 1.0, 3.0], turn).tolist()


def test_a_volume_is_that_of_the_box_or_of_the_ellipsoid():
    axes = np.array([0.1, 0.2, 0.4])
    turned = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    assert Region(axes).volume == pytest.approx(8.0 * 0.1 * 0.2 * 0.4)
    ellipsoid = Region(axes, turned @ np.diag(axes**2) @ turned.T)
    assert ellipsoid.volume == pytest.approx(4.0 / 3.0 * np.pi * 0.1 * 0.2 * 0.4)
    drawn = np.random.default_rng(1).uniform(-0.4, 0.4, (200_000, 3))
    share = np.mean(ellipsoid.contains(drawn))
    assert ellipsoid.volume == pytest.approx(share * 0.8**3, rel=0.03)


def test_the_discarding_bound_by_hand():
    """Nothing discarded, d = 3: (1-v)^N + N v (1-v)^(N-1) + N(N-1)/2 v^2 (1-v)^(N-2)."""
    n, v = 30, 0.2
    sum_ = (1 - v) ** n + n * v * (1 - v) ** (n - 1) + n * (n - 1) / 2 * v**2 * (1 - v) ** (n - 2)
    assert np.exp(log_failure(n, 0, 1 - v)) == pytest.approx(sum_)


@given(
    method=st.sampled_from(sorted(CALIBRATORS.bundled)),
    gamma=st.floats(0.05, 0.995),
    confidence=st.floats(0.5, 0.999),
)
def test_one_sample_less_than_needed_is_refused(method, gamma, confidence):
    how = calibrator(method, gamma, confidence)
    needed = how.samples_needed()
    errors = np.random.default_rng(0).standard_normal((needed, 3))
    assert np.all(region_of(how, np.eye(3), errors).epsilon > 0)
    refused(f"needs {needed}", how.conformalize, errors[1:], error=BoundsError)


def test_what_is_no_method_level_or_confidence_is_refused():
    errors = np.ones((100, 3))
    refused("unknown method 'magic'; known: conformal", calibrator, "magic", 0.8, error=BoundsError)
    refused("gamma 1", calibrator, "maxnorm", 1.0, error=BoundsError)
    with pytest.raises(BoundsError, match="confidence 0"):
        calibrator("scenario", 0.8, 0.0).conformalize(errors)
