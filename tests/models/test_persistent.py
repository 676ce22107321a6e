"""The persistent part is recovered where the truth is known, and is nothing where there is none."""

import json
from dataclasses import replace

import numpy as np
import pytest
from altered_bounds import write_bounds
from scipy.linalg import cho_factor, cho_solve, toeplitz
from synthetic import gauss_markov

from surefoot.models.calibration.bias_model import (
    BiasModel,
    _correlation,
    _innovations,
    _mixing,
    _smoothed,
    estimate_bias_model,
)
from surefoot.models.calibration.bounds import Bounds, BoundsError
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.files import plain_json

DT = 0.02
STD = np.array([0.05, 0.03, 0.02])
MIXING = np.array([0.08, 0.06, 0.05])


def errors(rng, duration, tau, std=STD, forgets=0.05):
    n = round(duration / DT)
    lasting = std * gauss_markov(rng, n, np.exp(-DT / tau))
    return lasting + MIXING * gauss_markov(rng, n, np.exp(-DT / forgets))


@pytest.mark.parametrize("sign", [np.array([1.0, -1.0, 1.0]), np.ones(3)])
def test_axes_that_are_one_keep_a_twentieth_of_their_variance_apart(sign):
    """Eigenvalues 3, 0 and 0 become 3, 0.05 and 0.05, of unit diagonal again."""
    y = np.random.default_rng(5).standard_normal((50, 1)) * sign
    found = _correlation(y, np.arange(50) == 0, 0.9, 1e9)
    both = np.where(np.eye(3), 1.0, (3.0 - 0.05) / (3.0 + 0.10))
    assert found == pytest.approx(np.outer(sign, sign) * both, abs=1e-6)


@pytest.mark.parametrize("confidence", [None, 0.9, 0.999, 0.0, 1.0])
def test_a_confidence_is_a_probability_that_is_neither_nothing_nor_certain(tmp_path, confidence):
    path = tmp_path / "bounds.json"
    said = Bounds(STD, 0.8, 0.8, "scenario", 20, 300, "a1b2", np.eye(3), "walk", None, 0.5)
    said.save(path)
    write_bounds(path, json.loads(path.read_text()) | {"confidence": confidence})
    if confidence in (0.0, 1.0):
        with pytest.raises(ValueError, match="confidence must lie between 0 and 1"):
            replace(said, confidence=confidence)
        with pytest.raises(BoundsError, match="confidence must lie between 0 and 1"):
            Bounds.load(path)
    else:
        assert Bounds.load(path).confidence == confidence


def test_sequences_that_each_keep_their_own():
    rng = np.random.default_rng(0)
    found = estimate_bias_model([errors(rng, 40.0, np.inf) for _ in range(30)], DT, 0.8)
    assert found.time_constant == np.inf
    assert found.nu == 30.0
    assert np.sqrt(found.variance) == pytest.approx(STD, rel=0.3)
    for i in range(3):
        assert found.covariance[i, i] == pytest.approx(found.variance[i] * 30 / 28)


def test_sizes_and_time_constant_are_about_those_of_the_truth():
    """Of 24 single logs of 300 s: medians, within what so many logs leave open."""
    rng = np.random.default_rng(1)
    found = [estimate_bias_model(errors(rng, 300.0, 15.0), DT, 0.8) for _ in range(24)]
    std = np.median([np.sqrt(one.variance) for one in found], axis=0)
    assert std == pytest.approx(STD, rel=0.25)
    assert 15.0 / 2.0 < np.median([one.time_constant for one in found]) < 15.0 * 2.0


def test_nothing_that_lasts_is_about_nothing():
    rng = np.random.default_rng(2)
    found = [estimate_bias_model(errors(rng, 200.0, np.inf, 0 * STD), DT, 0.8) for _ in range(8)]
    assert np.median([np.sqrt(f.variance) for f in found]) < 0.05 * MIXING.max()
    for f in found:
        np.linalg.cholesky(f.covariance)


def test_bounds_hold_the_mean_of_a_window_of_the_mixing_part():
    rng = np.random.default_rng(3)
    found = estimate_bias_model([errors(rng, 60.0, np.inf) for _ in range(20)], DT, 0.8)
    rest = errors(rng, 2000.0, np.inf, 0 * STD)
    count = len(rest) // found.window
    means = rest[: count * found.window].reshape(count, found.window, 3).mean(axis=1)
    assert np.all(np.abs(means) <= found.epsilon, axis=1).mean() == pytest.approx(0.8, abs=0.03)
    assert np.diag(found.within) / found.window == pytest.approx(means.var(axis=0), rel=0.06)
    assert np.all(found.max_error > 3 * MIXING)


def test_the_likelihood_is_the_dense_gaussian_one():
    rng = np.random.default_rng(4)
    n, ratio, phi = 40, 1.7, 0.8
    y = rng.standard_normal(n)
    fresh = np.arange(n) == 0
    C = ratio * toeplitz(phi ** np.arange(n))
    V = cho_factor(C + np.eye(n))
    s, value = _innovations(y, fresh, ratio, phi)
    assert s == pytest.approx(y @ cho_solve(V, y) / n)
    assert value == pytest.approx(-0.5 * n * np.log(s) - np.log(np.diag(V[0])).sum())
    assert _smoothed(y, ratio, phi) == pytest.approx(C @ cho_solve(V, y))


def test_a_sequence_shorter_than_a_block_has_only_its_mean_taken_off():
    errors = 1.0 + np.random.default_rng(6).standard_normal((7, 3))
    found = _mixing(errors, np.empty((0, 3)), 10, np.ones(3), 0.9)
    assert found == pytest.approx(errors - errors.mean(axis=0))
    one = _mixing(errors, errors.mean(axis=0)[None], 7, np.ones(3), 0.9)
    assert one == pytest.approx(errors - 0.5 * errors.mean(axis=0))  # a prior as large as its noise


def test_one_sequence_says_little_of_a_part_that_never_changes():
    found = estimate_bias_model(errors(np.random.default_rng(6), 60.0, np.inf), DT, 0.8)
    assert found.nu < 20


@pytest.mark.parametrize("count", [0, 10, 499])
def test_too_little_is_one_line(count):
    with pytest.raises(SurefootError, match=r"blocks of 0.5 s; the persistent part needs 20"):
        estimate_bias_model(np.zeros((count, 3)), DT, 0.8)


def test_bounds_come_back_whole_with_their_persistent_part(bounds, mse_observer, tmp_path):
    assert bounds.observer == mse_observer.hash
    assert bounds.mixing is not None
    assert bounds.persistent is not None
    constant = replace(bounds.persistent, time_constant=np.inf)
    for part in (bounds.persistent, constant):
        path = tmp_path / f"{part.time_constant}.json"
        whole = replace(bounds, persistent=part)
        whole.save(path)
        json.loads(path.read_text(), parse_constant=pytest.fail)
        assert plain_json(Bounds.load(path)) == plain_json(whole)


def test_files_from_before_it_are_read_and_say_what_is_missing(bounds, tmp_path):
    path = tmp_path / "old.json"
    bounds.save(path)
    values = json.loads(path.read_text())
    for name in ("digest", "persistent", "warnings"):
        del values[name]
    path.write_text(json.dumps(values | {"schema": 1}))
    old = Bounds.load(path)
    assert old.persistent is None
    with pytest.raises(BoundsError, match="have no persistent part; calibrate again"):
        old.persistent_at(np.eye(3))


@pytest.mark.parametrize(
    "change",
    [{"covariance": [[1, 0, 0]] * 3}, {"epsilon": [1, 2]}, {"window": 0}, {"time_constant": -1.0},
     {"within": None}, {"reach": [0, 1, 1]}, {"more": 1}],
)  # fmt: skip
def test_a_part_that_is_none_is_refused(change, bounds, tmp_path):
    path = tmp_path / "bad.json"
    bounds.save(path)
    values = json.loads(path.read_text())
    values["persistent"] |= change
    write_bounds(path, values)
    with pytest.raises(BoundsError, match="not whole surefoot bounds"):
        Bounds.load(path)


def test_another_mounting_turns_it(bounds):
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    part = bounds.persistent
    assert isinstance(part, BiasModel)
    found = bounds.persistent_at(quarter)
    assert found.epsilon == pytest.approx(part.epsilon[[1, 0, 2]])
    assert np.diag(found.covariance) == pytest.approx(np.diag(part.covariance)[[1, 0, 2]])


def test_courses_that_each_have_a_mean_of_their_own():
    """Seconds of wandering about a constant by course: both variances are found from 30 courses."""
    rng = np.random.default_rng(8)
    parts = [
        errors(rng, 120.0, 4.0) + np.array([0.04, 0.02, 0.0]) * rng.normal(size=3)
        for _ in range(30)
    ]
    found = estimate_bias_model(parts, DT, 0.8)
    of_course = np.sqrt(np.diag(found.course))
    assert of_course[:2] == pytest.approx([0.04, 0.02], rel=0.5)
    assert of_course[2] < 0.015


def test_one_course_alone_grants_others_a_mean_as_large_as_its_own_wandering():
    rng = np.random.default_rng(9)
    found = estimate_bias_model(errors(rng, 300.0, 4.0), DT, 0.8)
    ratio = np.sqrt(np.diag(found.course) / found.variance)
    assert np.all((ratio > 0.8) & (ratio < 1.5))


def test_a_constant_part_leaves_nothing_to_the_courses():
    rng = np.random.default_rng(10)
    found = estimate_bias_model([errors(rng, 40.0, np.inf) for _ in range(30)], DT, 0.8)
    assert np.all(np.diag(found.course) < 0.5 * np.diag(found.covariance))


def test_axes_that_move_apart_are_correlated_below_zero():
    """Pairs of block means: two axes opposed, a third on its own."""
    rng = np.random.default_rng(0)
    own = gauss_markov(rng, 4000, 0.95)
    y = np.stack([own[:, 0], 0.2 * own[:, 1] - own[:, 0], own[:, 2]], axis=1)
    found = _correlation(y, np.arange(4000) == 0, 0.95, 200.0)
    assert np.diag(found) == pytest.approx(1.0)
    assert found == pytest.approx(found.T)
    assert found[0, 1] == pytest.approx(-1.0 / np.hypot(1.0, 0.2), abs=0.05)
    assert np.abs(found[2, :2]).max() < 0.3
