"""Statistics of an observer's errors: bias, spread, skewness, tails, and a test of normality.

Errors 10 ms apart are correlated, and a test that assumes independence finds everything
significant. Shape, test and the interval of the mean therefore use every K-th error, with K from
the mixing curve.
"""

from dataclasses import dataclass

import numpy as np
from scipy.stats import kurtosis, norm, normaltest, skew

from surefoot.models.calibration.mixing import mixing
from surefoot.sim.common.errors import SurefootError

FEWEST_ERRORS = 20
"""Independent errors needed for the test: D'Agostino's approximations are accurate from there."""


@dataclass(frozen=True)
class ErrorStatistics:
    """Statistics of errors on D axes, each an array (D,).

    Attributes:
        independent: number of errors K apart.
        mean: of all errors [m/s].
        half_width: of the mean's 95 % interval [m/s].
        std: of all errors [m/s].
        skewness: of the errors K apart.
        kurtosis: of these, in excess of a Gaussian's.
        normal_p: p-value of a Gaussian, by the test of D'Agostino and Pearson.
        beyond: share of all errors farther from the mean than three std (0.0027 of a Gaussian).
    """

    independent: int
    mean: np.ndarray
    half_width: np.ndarray
    std: np.ndarray
    skewness: np.ndarray
    kurtosis: np.ndarray
    normal_p: np.ndarray
    beyond: np.ndarray


def error_statistics(errors: np.ndarray, K: int | None = None) -> ErrorStatistics:
    """Statistics of each axis of errors (n, D) [m/s]; K is from their mixing curve by default.

    Raises SurefootError where fewer than FEWEST_ERRORS independent errors are left.
    """
    K = mixing(errors).K if K is None else K
    thin = errors[K - 1 :: K]
    if len(thin) < FEWEST_ERRORS:
        raise SurefootError(
            f"{len(errors)} errors, of which every {K}th is independent, are too few for "
            f"statistics: {len(thin)} independent ones, {FEWEST_ERRORS} are needed"
        )
    mean, std = errors.mean(axis=0), errors.std(axis=0)
    return ErrorStatistics(
        independent=len(thin),
        mean=mean,
        half_width=norm.ppf(0.975) * std / np.sqrt(len(thin)),
        std=std,
        skewness=skew(thin),
        kurtosis=kurtosis(thin),
        normal_p=normaltest(thin).pvalue,
        beyond=(np.abs(errors - mean) > 3 * std).mean(axis=0),
    )
