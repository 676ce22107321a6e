"""Probability and moments of a three-dimensional Gaussian on a box: the checked front door."""

import numpy as np

from surefoot.estimator.core.checks import asymmetry, is_definite
from surefoot.estimator.moments.box import box_moments_kernel
from surefoot.sim.common.kernels import kernel

COVARIANCE_ASYMMETRY = 1e-10
"""Largest `asymmetry` of a covariance."""


def box_moments(
    mean: np.ndarray, cov: np.ndarray, lower: np.ndarray, upper: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray]:
    """Log probability, mean (3,) and covariance (3, 3) of N(mean, cov) truncated to a box.

    mean (3,), cov (3, 3), lower (3,) and upper (3,) are in any one unit; bounds may be infinite.
    The results are log pi, mu_C and Sigma_C of eqs. pi_def_error_state and
    trunc_moments_error_state. Deterministic, and finite for boxes many deviations away. Raises
    ValueError on wrong shapes, NaN, lower >= upper, or a covariance that is not symmetric positive
    definite.
    """
    mean, lower, upper = (np.array(x, dtype=float, order="C") for x in (mean, lower, upper))
    cov = np.array(cov, dtype=float, order="C")
    for name, array in (("mean", mean), ("cov", cov), ("lower", lower), ("upper", upper)):
        if array.shape != ((3, 3) if array is cov else (3,)):
            wanted = "(3, 3)" if array is cov else "(3,)"
            raise ValueError(f"box_moments: {name} has shape {array.shape}, not {wanted}")
    out_mean, out_cov = np.empty(3), np.empty((3, 3))
    log_prob = _checked(mean, cov, lower, upper, out_mean, out_cov)
    if log_prob > 0.0:
        raise ValueError(f"box_moments: {_FAULTS[int(log_prob) - 1]}")
    return log_prob, out_mean, out_cov


_FAULTS = (
    "mean has values that are not finite",
    "cov has values that are not finite",
    "lower has values that are not finite",
    "upper has values that are not finite",
    "lower must be below upper on every axis",
    "the box is empty, a bound is infinite on the wrong side",
    "cov is not symmetric",
    "cov is not positive definite",
)


@kernel
def _checked(mean, cov, lower, upper, out_mean, out_cov) -> float:
    """`box_moments_kernel` with checks of its inputs; returns the number of a fault where there is
    one, counted from one in the order of _FAULTS.

    Args:
        mean: (3,) of the Gaussian.
        cov: (3, 3) of the Gaussian.
        lower: (3,), the box's lower bounds.
        upper: (3,), the box's upper bounds.
        out_mean: (3,), receives the truncated mean.
        out_cov: (3, 3), receives the truncated covariance.
    """
    for i in range(3):
        if not np.isfinite(mean[i]):
            return 1.0
        if not (np.isfinite(cov[i, 0]) and np.isfinite(cov[i, 1]) and np.isfinite(cov[i, 2])):
            return 2.0
        if np.isnan(lower[i]):
            return 3.0
        if np.isnan(upper[i]):
            return 4.0
    for i in range(3):
        if not lower[i] < upper[i]:
            return 5.0
        if lower[i] == np.inf or upper[i] == -np.inf:
            return 6.0
    if asymmetry(cov) > COVARIANCE_ASYMMETRY:
        return 7.0
    if not is_definite(cov):
        return 8.0
    return box_moments_kernel(mean, cov, lower, upper, out_mean, out_cov)
