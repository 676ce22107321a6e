"""What is done where the calibration no longer speaks for the walk: the alarm and the weights."""

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import binom, norm

from surefoot.models.calibration.shift import (
    RIDGE,
    SETTLING_BLOCKS,
    UPDATES_OF_BLOCK,
    block_sizes,
    fortune,
    inflation,
    likelihood_ratios,
    shift_alarm,
    weighted_bounds,
    weighted_quantile,
)

TRIALS = 1000


def test_false_alarms_are_no_more_than_stated():
    rng = np.random.default_rng(0)
    for chance in (0.05, 0.2):
        raised = sum(
            shift_alarm(x[:40], x[40:], chance) is not None
            for x in rng.lognormal(size=(TRIALS, 120))
        )
        assert raised <= binom.ppf(0.999, TRIALS, chance)


def test_false_alarms_on_innovations_that_remember():
    """Blocks of a second are not quite exchangeable where a sample remembers the one before."""
    rng = np.random.default_rng(1)
    raised = 0
    for _ in range(300):
        noise = rng.standard_normal((100 * UPDATES_OF_BLOCK,))
        squared = np.square(np.asarray(lfilter([1.0], [1.0, -0.95], noise)))
        sizes = block_sizes(squared)
        raised += shift_alarm(sizes[:40], sizes[40:], 0.05) is not None
    assert raised <= binom.ppf(0.999, 300, 0.05)


def test_a_growth_by_half_is_found_within_twenty_seconds():
    rng = np.random.default_rng(2)
    delays = []
    for _ in range(200):
        calibration = block_sizes(rng.standard_normal(61 * UPDATES_OF_BLOCK) ** 2)
        walk = rng.standard_normal(81 * UPDATES_OF_BLOCK) ** 2
        walk[41 * UPDATES_OF_BLOCK :] *= 1.5**2
        at = shift_alarm(calibration, block_sizes(walk))
        assert at is not None
        delays.append(at - 41)
    assert min(delays) > 0
    assert np.median(delays) < 20


def test_smaller_innovations_raise_no_alarm():
    rng = np.random.default_rng(3)
    assert fortune(rng.uniform(1, 2, 50), rng.uniform(0, 1, 500)).max() < 2


def test_bounds_grow_after_the_alarm_as_innovations_have():
    squared = np.concatenate((np.ones(10 * UPDATES_OF_BLOCK), np.full(20 * UPDATES_OF_BLOCK, 9.0)))
    factor = inflation(np.ones(30), squared, 15.0)
    assert np.all(factor[: 15 * UPDATES_OF_BLOCK] == 1.0)
    assert factor[15 * UPDATES_OF_BLOCK :] == pytest.approx(np.full(15 * UPDATES_OF_BLOCK, 3.0))
    assert np.all(inflation(np.ones(30), squared, None) == 1.0)
    assert len(block_sizes(squared)) == 30 - SETTLING_BLOCKS


def shifted(rng, n, m):
    """Inputs of mean 0, then of mean 1; the error's size grows with the input."""
    x = np.concatenate((rng.standard_normal(n), 1.0 + rng.standard_normal(m)))
    return x, np.abs(rng.standard_normal(n + m)) * np.exp(0.5 * x)


def test_true_weights_keep_the_level_that_is_lost_without_them():
    rng, n, level = np.random.default_rng(4), 200, 0.8
    kept, lost = 0, 0
    for _ in range(TRIALS):
        x, score = shifted(rng, n, 1)
        w = norm.pdf(x, 1.0) / norm.pdf(x)
        bound = weighted_quantile(score[:n], w[:n], w[n], level)
        kept += bound is None or score[n] <= bound
        plain = weighted_quantile(score[:n], np.ones(n), 1.0, level)
        assert plain is not None
        lost += score[n] <= plain
    assert kept >= binom.ppf(0.001, TRIALS, level)
    assert kept <= binom.ppf(0.999, TRIALS, level + 0.03)
    assert lost < binom.ppf(0.001, TRIALS, level)


def test_equal_weights_are_split_conformal():
    from surefoot.models.calibration.regions import conformal_quantile

    scores = np.random.default_rng(5).standard_normal(77)
    for level in (0.5, 0.83, 0.97):
        ours = weighted_quantile(scores, np.ones(77), 1.0, level)
        assert ours == conformal_quantile(scores[:, None], level)[0]


def test_a_walk_like_the_calibration_counts_as_one_second_more():
    """All seconds alike: the level is that of split conformal on seconds, not on errors."""
    seconds = 20
    x = np.ones((seconds * UPDATES_OF_BLOCK, 1))
    errors = np.random.default_rng(5).standard_normal((len(x), 3))
    scale = np.sqrt((errors**2).mean(axis=0))
    scores = np.sort((np.abs(errors) / scale).max(axis=1))
    found = weighted_bounds(errors, x, x, 0.8)
    rank = np.ceil(0.8 * (seconds + 1) / seconds * len(x)).astype(int)
    assert found == pytest.approx(scores[rank - 1] * scale)


def test_ratios_are_those_of_the_densities():
    rng = np.random.default_rng(6)
    a, b = rng.standard_normal((2000, 1)), 1.0 + rng.standard_normal((2000, 1))
    ours, _ = likelihood_ratios(a, b)
    true = norm.pdf(a[:, 0], 1.0) / norm.pdf(a[:, 0])
    assert np.log(ours) == pytest.approx(np.log(true), abs=0.4)


def test_few_seconds_weigh_as_the_ridge_says():
    """Their log ratio is the regression's whose penalised gradient vanishes: by Newton's method."""
    rng = np.random.default_rng(7)
    a, b = rng.standard_normal((15, 6)), 0.8 + rng.standard_normal((20, 6))
    A = (np.vstack([a, b]) - a.mean(axis=0)) / a.std(axis=0)
    A, y = np.hstack([A, np.ones((35, 1))]), np.repeat([0.0, 1.0], [15, 20])
    ridge, w = np.diag([RIDGE] * 6 + [0.0]), np.zeros(7)
    for _ in range(20):
        p = 1.0 / (1.0 + np.exp(-A @ w))
        H = (A * (p * (1.0 - p))[:, None]).T @ A + ridge
        w -= np.linalg.solve(H, A.T @ (p - y) + ridge @ w)
    ours = np.log(np.concatenate(likelihood_ratios(a, b)))
    assert ours == pytest.approx(A @ w + np.log(15 / 20), abs=1e-3)


def inputs(rng, seconds, mean, depends=1.0):
    """A second's inputs have a level of their own, and its errors a size that grows with it."""
    level = mean + rng.standard_normal(seconds)
    x = np.repeat(level, UPDATES_OF_BLOCK)[:, None] + 0.1 * rng.standard_normal(
        (seconds * UPDATES_OF_BLOCK, 1)
    )
    size = np.exp(0.5 * depends * np.repeat(level, UPDATES_OF_BLOCK))
    return x, size[:, None] * rng.standard_normal((seconds * UPDATES_OF_BLOCK, 3))


def test_a_walk_of_other_inputs_is_covered_and_one_of_foreign_inputs_refused():
    rng, held, plain = np.random.default_rng(7), [], []
    for _ in range(30):
        x, errors = inputs(rng, 150, 0.0)
        new, new_errors = inputs(rng, 100, 0.8)
        bounds = weighted_bounds(errors, x, new, 0.8)
        same = weighted_bounds(errors, x, x, 0.8)
        assert bounds is not None
        assert same is not None
        held.append(np.all(np.abs(new_errors) <= bounds, axis=1).mean())
        plain.append(np.all(np.abs(new_errors) <= same, axis=1).mean())
    assert np.mean(plain) < 0.7
    assert np.mean(held) > 0.77
    x, errors = inputs(rng, 100, 0.0)
    assert weighted_bounds(errors, x, inputs(rng, 100, 9.0)[0], 0.8) is None
