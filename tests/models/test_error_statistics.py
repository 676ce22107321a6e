"""Statistics of errors find what was put in, and at their stated level when nothing was."""

import numpy as np
import pytest
from scipy.stats import binom
from synthetic import gauss_markov

from surefoot.models.calibration.error_statistics import error_statistics
from surefoot.sim.common.errors import SurefootError


def test_thinned_tests_of_correlated_gaussians_keep_their_level():
    """Rejections at 5 % of 200 sequences lie in the binomial band; unthinned they do not."""
    errors = gauss_markov(np.random.default_rng(1), 4000, 0.9, axes=200)
    low, high = binom.ppf([5e-4, 1 - 5e-4], 200, 0.05)
    assert low <= np.sum(error_statistics(errors, K=40).normal_p < 0.05) <= high
    assert np.sum(error_statistics(errors, K=1).normal_p < 0.05) > 60


def test_the_mean_is_inside_its_interval_as_often_as_stated():
    found = error_statistics(
        0.3 + gauss_markov(np.random.default_rng(2), 3000, 0.9, axes=150), K=30
    )
    hits = np.sum(np.abs(found.mean - 0.3) < found.half_width)
    assert binom.cdf(hits, 150, 0.95) > 1e-4


def test_what_was_put_in_is_found():
    rng, n = np.random.default_rng(4), 4000
    columns = (
        rng.standard_normal(n),
        rng.gamma(4.0, size=n),
        rng.standard_t(4, size=n),
        0.1 + rng.standard_normal(n),
    )
    found = error_statistics(np.stack(columns, axis=1), K=1)
    assert found.independent == n
    assert found.normal_p[0] > 0.01
    assert found.beyond[0] == pytest.approx(0.0027, abs=0.003)
    assert found.skewness[1] == pytest.approx(1.0, abs=0.25)
    assert found.kurtosis[2] > 1
    assert found.normal_p[1:3].max() < 1e-6
    assert abs(found.mean[0]) < found.half_width[0] < found.mean[3]


def test_too_few_errors_are_refused():
    with pytest.raises(SurefootError, match="19 independent ones, 20 are needed"):
        error_statistics(np.zeros((199, 3)), K=10)
