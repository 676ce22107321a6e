"""The posterior of Theorem 1 with its results returned, and a truncated Gaussian in many digits."""

import mpmath as mp
import numpy as np

from surefoot.estimator.updates.coverage import posterior_moments


def posterior(mean, cov, lower, upper, gamma):
    """pi, mean (3,) and covariance (3, 3) of `posterior_moments`."""
    out_mean, out_cov = np.empty(3), np.empty((3, 3))
    mean, cov, lower, upper = (np.array(x, dtype=float) for x in (mean, cov, lower, upper))
    pi = posterior_moments(mean, cov, lower, upper, gamma, out_mean, out_cov)
    return pi, out_mean, out_cov


def truncated(m, s, low, high):
    """Mass, mean and second moment of N(m, s^2) on (low, high), all times the mass."""
    a, b = (low - m) / s, (high - m) / s
    # Through the complementary tail where both bounds lie above the mean.
    mass = mp.ncdf(-a) - mp.ncdf(-b) if a > 0 else mp.ncdf(b) - mp.ncdf(a)
    da = mp.npdf(a) if mp.isfinite(a) else mp.mpf(0)
    db = mp.npdf(b) if mp.isfinite(b) else mp.mpf(0)
    ea = a * da if mp.isfinite(a) else mp.mpf(0)
    eb = b * db if mp.isfinite(b) else mp.mpf(0)
    z1, z2 = da - db, mass + ea - eb
    return mass, m * mass + s * z1, m * m * mass + 2 * m * s * z1 + s * s * z2
