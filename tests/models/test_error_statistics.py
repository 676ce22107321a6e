"""Statistics of errors find what was put in, and at their stated level when nothing was."""

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import anderson, binom, kstest, normaltest

from surefoot.models.calibration.error_statistics import (
    anderson_darling,
    effective_samples,
    error_statistics,
)
from surefoot.sim.common.errors import SurefootError


def correlated(rng: np.random.Generator, n: int, phi: float) -> np.ndarray:
    """A Gaussian AR(1) sequence (n,) of unit variance."""
    start = rng.standard_normal()
    noise = np.sqrt(1 - phi**2) * rng.standard_normal(n)
    return lfilter([1.0], [1.0, -phi], noise, zi=[phi * start])[0]


@pytest.mark.filterwarnings("ignore::FutureWarning")
def test_the_tests_are_those_of_scipy():
    x = np.random.default_rng(0).gamma(4.0, size=300)
    (found,) = error_statistics(x[:, None], K=1)
    assert found.normal_p == pytest.approx(normaltest(x).pvalue, rel=1e-9)
    assert anderson_darling(x)[0] == pytest.approx(anderson(x, "norm").statistic, rel=1e-9)


def test_thinned_tests_of_correlated_gaussians_keep_their_level():
    """Rejections at 5 % of 200 sequences lie in the binomial band; unthinned they do not."""
    rng = np.random.default_rng(1)
    found = [error_statistics(correlated(rng, 4000, 0.9)[:, None], K=40)[0] for _ in range(200)]
    low, high = binom.ppf([5e-4, 1 - 5e-4], 200, 0.05)
    for name in ("skewness_p", "normal_p", "anderson_p"):
        assert low <= sum(getattr(f, name) < 0.05 for f in found) <= high, name
    raw = [error_statistics(correlated(rng, 4000, 0.9)[:, None], K=1)[0] for _ in range(40)]
    assert sum(f.anderson_p < 0.05 for f in raw) > 12


def test_the_mean_is_inside_its_interval_as_often_as_stated():
    rng = np.random.default_rng(2)
    hits = 0
    for _ in range(150):
        (found,) = error_statistics(0.3 + correlated(rng, 3000, 0.9)[:, None], K=30)
        hits += found.interval[0] < 0.3 < found.interval[1]
    assert binom.cdf(hits, 150, 0.95) > 1e-4


def test_effective_samples_of_a_known_process():
    """(1 - phi) / (1 + phi) of the samples count in an AR(1) sequence."""
    rng = np.random.default_rng(3)
    x = [effective_samples(correlated(rng, 50_000, 0.8)) for _ in range(10)]
    assert np.mean(x) == pytest.approx(50_000 * 0.2 / 1.8, rel=0.05)
    assert effective_samples(rng.standard_normal(20_000)) == pytest.approx(20_000, rel=0.1)


def test_what_was_put_in_is_found():
    rng = np.random.default_rng(4)
    n = 4000
    columns = (
        rng.standard_normal(n),
        rng.gamma(4.0, size=n),
        rng.standard_t(4, size=n),
        0.1 + rng.standard_normal(n),
    )
    plain, skewed, tailed, biased = error_statistics(np.stack(columns, axis=1), K=1)
    assert min(plain.normal_p, plain.anderson_p, plain.skewness_p, plain.kurtosis_p) > 0.01
    assert plain.beyond == pytest.approx(0.0027, abs=0.003)
    assert skewed.skewness == pytest.approx(1.0, abs=0.25)
    assert max(skewed.skewness_p, skewed.normal_p, skewed.anderson_p) < 1e-6
    assert tailed.kurtosis > 1
    assert max(tailed.kurtosis_p, tailed.normal_p, tailed.anderson_p) < 1e-6
    assert biased.interval[0] > 0
    assert plain.interval[0] < 0 < plain.interval[1]


def test_too_few_errors_are_refused():
    with pytest.raises(SurefootError, match="19 independent ones, 20 are needed"):
        error_statistics(np.zeros((199, 3)), K=10)


def test_the_p_value_of_anderson_and_darling_is_one():
    """Of Gaussians it is uniform on [0, 1], all four pieces of the fit together."""
    rng = np.random.default_rng(6)
    found = [anderson_darling(rng.standard_normal(60))[1] for _ in range(4000)]
    assert kstest(found, "uniform").statistic < 0.03
