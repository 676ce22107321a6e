"""Bounds for a walk unlike the calibration's, from its inputs only: weighted split conformal.

Calibration errors have more weight if their inputs resemble those of the new walk (Tibshirani,
Foygel Barber, Candes and Ramdas, Conformal prediction under covariate shift, NeurIPS 2019). That
preserves coverage where the inputs have changed, but not the errors given the inputs. The weights
are the odds of a ridge logistic regression that separates the seconds of the two walks.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import minimize

from surefoot.models.calibration.conformal import least_rank, level_per_axis
from surefoot.models.calibration.shift import UPDATES_OF_BLOCK

RIDGE = 1.0
"""Prior precision of a regression weight on standardised features: few seconds, many inputs."""


def features(x: np.ndarray) -> np.ndarray:
    """Features of each second of inputs: means and log deviations (m, 2 C) of scaled x (M, C)."""
    m = len(x) // UPDATES_OF_BLOCK
    blocks = x[: m * UPDATES_OF_BLOCK].reshape(m, UPDATES_OF_BLOCK, -1)
    return np.hstack([blocks.mean(axis=1), np.log(blocks.std(axis=1) + 1e-3)])


def likelihood_ratios(calibration: np.ndarray, new: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Density of features under the new walk over that under the calibration: (n,) and (m,).

    calibration (n, F), new (m, F).
    """
    center, scale = calibration.mean(axis=0), calibration.std(axis=0) + 1e-6
    A = (np.vstack([calibration, new]) - center) / scale
    A = np.hstack([A, np.ones((len(A), 1))])
    sign = np.repeat([-1.0, 1.0], [len(calibration), len(new)])
    ridge = np.append(np.full(A.shape[1] - 1, RIDGE), 0.0)

    def loss(w):
        margin = sign * (A @ w)
        pull = -sign / (1 + np.exp(np.minimum(margin, 500)))
        return np.logaddexp(0, -margin).sum() + 0.5 * ridge @ w**2, A.T @ pull + ridge * w

    w = minimize(loss, np.zeros(A.shape[1]), jac=True, method="L-BFGS-B").x
    # Ratios beyond e^50 mean practically no overlap.
    ratio = np.exp(np.clip(A @ w, -50, 50)) * len(calibration) / len(new)
    return ratio[: len(calibration)], ratio[len(calibration) :]


def weighted_quantile(
    scores: np.ndarray, weights: np.ndarray, own: float, level: float
) -> float | None:
    """Weighted conformal quantile of scores (n,); `own` is the weight of the point to come.

    None if it is infinite: the existing scores do not make up `level` of the weight.
    """
    order = np.argsort(scores)
    share = np.cumsum(weights[order]) / (weights.sum() + own)
    k = int(np.searchsorted(share, level))
    return float(scores[order[k]]) if k < len(scores) else None


def weighted_bounds(
    errors: np.ndarray, calibration: np.ndarray, new: np.ndarray, gamma: float
) -> np.ndarray | None:
    """epsilon (3,) for a walk of inputs `new`, or None where the calibration has too few like it.

    errors (M, 3) of the calibration, one for each row of its inputs; calibration (M, C) and new
    (M', C) are scaled inputs at 100 Hz. The score is the largest axis, each scaled by its root mean
    square; each error of a second has that second's weight.
    """
    level_per_axis(gamma)
    ours, theirs = likelihood_ratios(features(calibration), features(new))
    # Effective number of equally weighted seconds (Kish).
    if ours.sum() ** 2 / (ours**2).sum() < least_rank(gamma):
        return None
    errors = errors[: len(ours) * UPDATES_OF_BLOCK]
    scale = np.sqrt((errors**2).mean(axis=0))
    scores = (np.abs(errors) / scale).max(axis=1)
    weights = np.repeat(ours / UPDATES_OF_BLOCK, UPDATES_OF_BLOCK)
    radius = weighted_quantile(scores, weights, float(np.median(theirs)), gamma)
    return None if radius is None else radius * scale
