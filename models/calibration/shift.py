"""Walks unlike the calibration's: an alarm, and bounds for them, without a reference.

The alarm is by the filter's innovations. Those of each second have a size. If the walk is like the
calibration's, the rank of a new size among all before it is uniform, and a gambler who bets on
large ones cannot win: the probability that his wealth ever reaches 1 / alpha is at most alpha
(Ville). The bets are those of the "simple jumper" (Vovk, Gammerman and Shafer, Algorithmic Learning
in a Random World, 2nd edition, 2022, section 8.2), on large sizes only.

The bounds are by the observer's inputs, weighted split conformal prediction. Calibration errors
have more weight if their inputs resemble those of the new walk (Tibshirani, Foygel Barber, Candes
and Ramdas, Conformal prediction under covariate shift, NeurIPS 2019). That preserves coverage where
the inputs have changed, but not the errors given the inputs. The weights are the odds of a ridge
logistic regression that separates the seconds of the two walks.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import minimize

from surefoot.models.calibration.regions import least_rank, level_per_axis

UPDATES_OF_BLOCK = 100
"""Updates in a block: 1 s, about two strides, since errors repeat with the stride."""
SETTLING_BLOCKS = 1
"""Blocks at a walk's beginning that are skipped while the filter converges."""
FALSE_ALARM = 0.01
"""Probability of a false alarm in a walk like the calibration's."""
STAKES = np.array([0.0, 1.0, 2.0])
RESTART = 0.01
RIDGE = 1.0
"""Prior precision of a regression weight on standardised features: few seconds, many inputs."""


def block_sizes(squared: np.ndarray) -> np.ndarray:
    """Root mean square (m,) of normalised innovations over whole blocks of `squared` (M,)."""
    m = len(squared) // UPDATES_OF_BLOCK
    blocks = squared[: m * UPDATES_OF_BLOCK].reshape(m, UPDATES_OF_BLOCK)
    return np.sqrt(blocks.mean(axis=1))[SETTLING_BLOCKS:]


def shift_alarm(
    calibration: np.ndarray, seen: np.ndarray, chance: float = FALSE_ALARM
) -> float | None:
    """Monitor block sizes `seen` (m,) as they come, against those of the calibration (n,).

    Returns the time into the walk at which the alarm is raised [s]; None if never. `chance`: that
    of a false alarm in a whole walk; it is exact for exchangeable blocks, which last a second each.
    It is a test of similarity, so a walk may raise it on which the bounds still hold.
    """
    raised = np.flatnonzero(fortune(calibration, seen) >= 1 / chance)
    return float(raised[0] + SETTLING_BLOCKS + 1) if len(raised) else None


def fortune(calibration: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """The gambler's wealth (m,): a third each holds, bets a little and bets all, with exchange."""
    n = len(calibration)
    everything = np.concatenate((calibration, seen))
    purse = np.full(STAKES.size, 1 / STAKES.size)
    wealth = np.empty(len(seen))
    for k in range(len(seen)):
        size = everything[n + k]
        p = (np.sum(everything[: n + k] >= size) + 1) / (n + k + 1)
        purse = (1 - RESTART) * purse + RESTART * purse.mean()
        purse = purse * (1 + STAKES * (0.5 - p))
        wealth[k] = purse.sum()
    return wealth


def inflation(calibration: np.ndarray, squared: np.ndarray, alarm_at: float | None) -> np.ndarray:
    """Factor (M,) on epsilon at each update: 1 until the alarm, then the growth of the innovations.

    The last second's size over the calibration's median, at least 1. It widens the bounds where
    errors scatter; a constant error is absorbed by the filter's velocity.
    """
    if alarm_at is None:
        return np.ones(len(squared))
    total = np.concatenate(([0.0], np.cumsum(squared)))
    last = np.arange(1, len(squared) + 1)
    first = np.maximum(last - UPDATES_OF_BLOCK, 0)
    size = np.sqrt((total[last] - total[first]) / (last - first))
    grown = np.maximum(size / np.median(calibration), 1.0)
    return np.where(last > alarm_at * UPDATES_OF_BLOCK, grown, 1.0)


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
    scores: np.ndarray, weights: np.ndarray, new_weight: float, level: float
) -> float | None:
    """Weighted conformal quantile of scores (n,); `new_weight` is the weight of the point to come.

    None if it is infinite: the existing scores do not make up `level` of the weight.
    """
    order = np.argsort(scores)
    share = np.cumsum(weights[order]) / (weights.sum() + new_weight)
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
