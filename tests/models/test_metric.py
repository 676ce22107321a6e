"""Products under a model's covariance, against the same with the whole covariance written out."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from known_evidence import BINS, KEYS, NOISE, QUADRUPED, WIDTH, evidence
from numpy.testing import assert_allclose

from surefoot.models.attribution.metric import metric_of
from surefoot.models.attribution.model_error import ModelError

CASE: Any = SimpleNamespace(
    robot=SimpleNamespace(limbs=QUADRUPED.limbs),
    fixed=True,
    zeros=(),
    log=None,
    motion=SimpleNamespace(first=np.arange(BINS), count=np.ones(BINS)),
)
SOME = np.arange(BINS) % 40 == 7


def error_of(keys, mean, covariance):
    names = [name for name, at in QUADRUPED.channels.items() for _ in range(at.start, at.stop)]
    kinds = zip(names, (column.kind for column in QUADRUPED.columns), strict=True)
    noise = dict(zip(kinds, NOISE.tolist(), strict=True))
    return ModelError(4, tuple(keys), np.array(mean), np.array(covariance), noise, {})


ERROR = error_of(KEYS[:2], [2e-3, -1e-3], [[4e-6, 1e-6], [1e-6, 9e-6]])
NONE = error_of((), np.zeros(0), np.zeros((0, 0)))


def metric(one, error=ERROR, use=SOME, per_run=()):
    return metric_of([CASE], one, error, use, per_run)


def dense(one, error, of):
    """a^T V^-1 b of residual and candidates, from V itself."""
    rows, columns = np.nonzero(of.root)
    n = len(rows)
    X = np.zeros((n, len(one.keys)))
    Z = np.zeros((n, len(one.Z)))
    for into, regressors in ((X, one.X), (Z, one.Z)):
        for i, regressor in enumerate(regressors):
            whole = np.zeros((BINS, WIDTH))
            whole[:, regressor.columns] = regressor.values
            into[:, i] = whole[rows, columns]
    F = X[:, [one.keys.index(key) for key in error.keys]]
    V = np.diag(of.root[rows, columns] ** -2.0) + F @ error.covariance @ F.T
    V += (Z * one.deviations**2) @ Z.T
    y = one.table[rows, columns] - F @ error.mean
    A = np.column_stack([y, X])
    return A.T @ np.linalg.solve(V, A)


@pytest.mark.parametrize("error", [ERROR, NONE])
def test_products_are_those_with_the_inverse_of_the_covariance(error):
    one = evidence((0.01, -0.004, 0.02, 0.003), (1e-3, 0, 0, 0.1, 0, 0))
    known = metric(one, error)
    assert_allclose(known.S, dense(one, error, known), rtol=1e-6, atol=1e-4)


def test_another_residual_has_the_same_products_and_terms_may_be_left_out():
    one = evidence((0.01, -0.004, 0.02, 0.003))
    known = metric(one)
    assert_allclose(known.products(one.table, one.X), known.S, rtol=1e-6)
    without = known.products(one.table, one.X, KEYS[:1])
    less = error_of(KEYS[1:2], [-1e-3], [[9e-6 - 1e-12 / 4e-6]])
    # The mean stays; given that the first is not there, the second varies by its conditional share.
    conditional = replace(less, covariance=np.array([[9e-6 - 1e-6 * 1e-6 / 4e-6]]))
    other = metric(one, conditional)
    other = replace(other, expected=known.expected, robust=known.robust, root=known.root)
    assert_allclose(without, other.S, rtol=1e-6)
    bare = known.products(one.table, one.X, None)
    plain = replace(metric(one, NONE), expected=known.expected, root=known.root)
    assert_allclose(bare, plain.S, rtol=1e-6)


def test_an_entry_that_is_lost_counts_as_noise():
    one = evidence((0.01, 0, 0, 0))
    known = metric(one, NONE)
    row, column = np.argwhere(known.root > 0.0)[5]
    table = one.table.copy()
    table[row, column] = np.nan
    root = known.root.copy()
    root[row, column] = 0.0
    fewer = replace(known, root=root)
    assert known.products(table, ())[0, 0] == pytest.approx(
        fewer.products(one.table, ())[0, 0] + known.robust.weight[row, column], rel=1e-3
    )


def test_sizes_and_their_errors_are_honest():
    truth, pulls = np.array([0.01, -0.004, 0.02, 0.003]), []
    for seed in range(12):
        one = evidence(truth, (1e-3, -2e-3, 1e-3, 0.02, 0.01, -0.02), seed)
        S = metric(one, NONE, np.ones(BINS, bool)).S
        covariance = np.linalg.inv(S[1:, 1:])
        pulls.append((covariance @ S[1:, 0] - truth) / np.sqrt(np.diag(covariance)))
    assert np.abs(pulls).max() < 4.5
    assert 0.7 < np.std(pulls) < 1.4


def test_what_belongs_to_each_log_is_a_zero_of_it():
    """Two logs with different zeros: neither is an effect that they share."""
    one, other = evidence((0.01, 0, 0, 0), seed=1), evidence((-0.02, 0, 0, 0), seed=2)
    both = replace(
        one,
        t=np.append(one.t, other.t),
        log=np.repeat([0, 1], BINS),
        table=np.concatenate([one.table, other.table]),
        X=tuple(
            replace(a, values=np.concatenate([a.values, b.values]))
            for a, b in zip(one.X, other.X, strict=True)
        ),
        Z=tuple(
            replace(a, values=np.concatenate([a.values, b.values]))
            for a, b in zip(one.Z, other.Z, strict=True)
        ),
    )
    known = metric_of([CASE, CASE], both, NONE, np.ones(2 * BINS, bool), {"encoder_offset"})
    first, second = known.zeros(KEYS[:1])
    assert first[0][0] == pytest.approx(0.01, abs=5 * first[0][1])
    assert second[0][0] == pytest.approx(-0.02, abs=5 * second[0][1])
    assert max(first[0][1], second[0][1]) < 1e-3
