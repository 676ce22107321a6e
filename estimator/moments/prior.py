"""Enforce that the covariance of a truncated Gaussian does not exceed that of the Gaussian.

This holds for every convex set, but only up to rounding in the computed moments.
"""

import math

import numpy as np

from surefoot.sim.common.kernels import kernel

_ROUNDING = 5e-10
"""Tolerance above the prior's covariance, in units of the prior's variances."""


@kernel(error_model="numpy")
def below_prior(C, cov) -> bool:
    """Whether C - cov (3, 3) is positive semidefinite but for rounding; C a correlation matrix."""
    a = C[0, 0] - cov[0, 0] + _ROUNDING
    b = C[1, 0] - cov[1, 0]
    c = C[2, 0] - cov[2, 0]
    d = C[1, 1] - cov[1, 1] + _ROUNDING - b * b / a
    e = C[2, 1] - cov[2, 1] - b * c / a
    f = C[2, 2] - cov[2, 2] + _ROUNDING - c * c / a - e * e / d
    return a > 0.0 and d > 0.0 and f > 0.0


@kernel(error_model="numpy")
def clip_to_prior(C, cov):
    """Reduce cov (3, 3), in place, to the correlation matrix C along the directions that exceed it.

    With C = L L^T, no eigenvalue of L^-1 cov L^-T is above one afterwards.
    """
    L = np.zeros((3, 3))
    for i in range(3):
        for j in range(i + 1):
            rest = C[i, j]
            for k in range(j):
                rest -= L[i, k] * L[j, k]
            L[i, j] = math.sqrt(rest) if i == j else rest / L[j, j]
    if not L[1, 1] * L[2, 2] > 0.0:
        return
    whitening = np.linalg.inv(L)
    values, vectors = np.linalg.eigh(whitening @ cov @ whitening.T)
    for k in range(3):
        if values[k] > 1.0:
            direction = L @ np.ascontiguousarray(vectors[:, k])
            for i in range(3):
                for j in range(3):
                    cov[i, j] -= (values[k] - 1.0) * direction[i] * direction[j]
