"""How much less than white noise a residual tells: known noise has known answers."""

import numpy as np
import pytest
from known_evidence import BINS, NOISE, WIDTH, evidence, made_of

from surefoot.models.attribution.fit import design
from surefoot.models.attribution.robust_weights import robust_weights
from surefoot.models.attribution.whiteness import variance_inflation


def _excess(noise, seed):
    one = evidence(seed=seed)
    X = np.zeros((BINS, WIDTH, 4))
    rng = np.random.default_rng(100 + seed)
    # Slow regressors, as effects on a leg's lengths are: constant over a step.
    X[:, 6:18] = np.repeat(rng.normal(size=(BINS // 25, 12, 4)), 25, axis=0)
    table = np.where(np.isfinite(one.table), noise, np.nan)
    data = design(made_of(one.t, table, X, np.zeros((BINS, WIDTH, 6))))
    return variance_inflation(data, robust_weights(data, np.full(WIDTH, 1e-12)))[6:18].mean()


@pytest.mark.parametrize("rows", [1, 25])
def test_noise_that_holds_for_some_bins_tells_as_little_as_its_independent_values(rows):
    """Standing half the time, 12 or 13 of every 25 bins share one value: 12.5 bins tell as one."""
    ratios = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        held = np.repeat(rng.normal(size=(BINS // rows, WIDTH)), rows, axis=0) * NOISE
        ratios.append(_excess(held, seed))
    expected = 1.0 if rows == 1 else 12.5
    assert np.mean(ratios) == pytest.approx(expected, rel=0.35)
