"""Statistics of an observer's errors: bias, spread, skewness, tails, and tests of normality.

Errors 10 ms apart are correlated, and a test that assumes independence finds everything
significant. The tests of shape therefore take every K-th error, with K from the mixing curve, and
the interval of the mean uses the effective number of samples by the autocorrelation.
"""

from dataclasses import dataclass

import numpy as np
from scipy.stats import kurtosis, kurtosistest, norm, normaltest, skew, skewtest

from surefoot.models.calibration.mixing import mixing
from surefoot.sim.common.errors import SurefootError

FEWEST_ERRORS = 20
"""Independent errors needed for the tests: D'Agostino's approximations are accurate from there
on.
"""


@dataclass(frozen=True)
class AxisErrors:
    """Statistics of one axis of errors; p-values of normality are from `thinned` errors K apart.

    mean with its 95 % interval, and std, in m/s, are of all errors. skewness and kurtosis (excess
    over a Gaussian's) have the tests of D'Agostino and of Anscombe and Glynn; the combined test of
    D'Agostino and Pearson is `normal_p`; `anderson_p` is that of Anderson and Darling with
    estimated mean and variance. beyond: share of all farther from the mean than three std (0.0027
    for a Gaussian).
    """

    thinned: int
    mean: float
    interval: tuple[float, float]
    std: float
    skewness: float
    skewness_p: float
    kurtosis: float
    kurtosis_p: float
    normal_p: float
    anderson_p: float
    beyond: float


def error_statistics(errors: np.ndarray, K: int | None = None) -> tuple[AxisErrors, ...]:
    """Statistics of each axis of errors (n, D) [m/s]; K is from their mixing curve by default.

    Raises SurefootError where fewer than FEWEST_ERRORS independent errors are left.
    """
    K = mixing(errors).K if K is None else K
    if len(errors) // K < FEWEST_ERRORS:
        raise SurefootError(
            f"{len(errors)} errors, of which every {K}th is independent, are too few for "
            f"statistics: {len(errors) // K} independent ones, {FEWEST_ERRORS} are needed"
        )
    return tuple(_axis(e, K) for e in errors.T)


def _axis(e: np.ndarray, K: int) -> AxisErrors:
    thin = e[K - 1 :: K]
    mean, std = float(e.mean()), float(e.std())
    half = float(norm.ppf(0.975)) * std / np.sqrt(effective_samples(e))
    return AxisErrors(
        thinned=len(thin),
        mean=mean,
        interval=(mean - half, mean + half),
        std=std,
        skewness=float(skew(thin)),
        skewness_p=float(skewtest(thin).pvalue),
        kurtosis=float(kurtosis(thin)),
        kurtosis_p=float(kurtosistest(thin).pvalue),
        normal_p=float(normaltest(thin).pvalue),
        anderson_p=anderson_darling(thin)[1],
        beyond=float((np.abs(e - mean) > 3 * std).mean()),
    )


def effective_samples(x: np.ndarray) -> float:
    """Effective sample size of x (n,): independent samples whose mean has the same variance.

    n / (1 + 2 sum rho_k), the sum by Geyer's initial positive sequence (Practical Markov Chain
    Monte Carlo, Statistical Science 7, 1992): pairs of autocorrelations until one is negative.
    """
    n = len(x)
    spectrum = np.abs(np.fft.rfft(x - x.mean(), 2 * n)) ** 2
    rho = np.fft.irfft(spectrum)[:n]
    rho = rho / rho[0]
    pairs = rho[: n - n % 2].reshape(-1, 2).sum(axis=1)
    negative = np.flatnonzero(pairs <= 0)
    tau = 2 * pairs[: negative[0] if len(negative) else len(pairs)].sum() - 1
    return float(min(n, n / max(tau, 1.0 / n)))


def anderson_darling(x: np.ndarray) -> tuple[float, float]:
    """A^2 of x (n,) against a Gaussian with its mean and variance, and its p-value.

    The p-value is D'Agostino and Stephens' (Goodness-of-Fit Techniques, 1986, table 4.9).
    """
    n = len(x)
    z = np.sort((x - x.mean()) / x.std(ddof=1))
    weight = (2 * np.arange(1, n + 1) - 1) / n
    statistic = float(-n - (weight * (norm.logcdf(z) + norm.logsf(z[::-1]))).sum())
    a = statistic * (1 + 0.75 / n + 2.25 / n**2)
    if a < 0.2:
        p = 1 - np.exp(-13.436 + 101.14 * a - 223.73 * a**2)
    elif a < 0.34:
        p = 1 - np.exp(-8.318 + 42.796 * a - 59.938 * a**2)
    elif a < 0.6:
        p = np.exp(0.9177 - 4.279 * a - 1.38 * a**2)
    else:
        # Beyond 10 the fitted parabola would rise again.
        p = np.exp(1.2937 - 5.709 * min(a, 10.0) + 0.0186 * min(a, 10.0) ** 2)
    return statistic, float(p)
