"""Empirical coverage of an observer's errors by their bounds, overall and by condition."""

from dataclasses import dataclass

import numpy as np
from scipy.stats import beta

from surefoot.models.calibration.bounds import Bounds, BoundsError
from surefoot.models.calibration.walking_conditions import walking_conditions
from surefoot.sim.log import Log


@dataclass(frozen=True)
class EmpiricalCoverage:
    """Share of errors within their bounds: per_axis (3,), and joint with its 95 % Clopper-Pearson
    interval (2,) for `n` independent errors.
    """

    per_axis: np.ndarray
    joint: float
    joint_interval: np.ndarray
    n: int


def coverage(errors: np.ndarray, bounds: Bounds) -> EmpiricalCoverage:
    """Share of errors (M, 3), at 100 Hz, within their bounds.

    Successive errors are not independent: the interval assumes M / K independent ones, with the K
    of the bounds' calibration. Raises BoundsError where there is none.
    """
    n = len(errors) // bounds.K
    if n < 1:
        raise BoundsError(f"{len(errors)} errors are not one independent trial at K = {bounds.K}")
    inside = np.abs(errors) <= bounds.epsilon
    joint = float(inside.all(axis=1).mean())
    return EmpiricalCoverage(inside.mean(axis=0), joint, binomial_interval(joint, n), n)


@dataclass(frozen=True)
class CaseCoverage:
    """Joint coverage of the errors in one case of one condition.

    time: share of all errors; interval (2,) assumes `n` independent ones, the blocks of K samples
    that contain an error of the case.
    """

    split: str
    case: str
    time: float
    joint: float
    interval: np.ndarray
    n: int


def coverage_by(
    log: Log, rows: np.ndarray, errors: np.ndarray, bounds: Bounds
) -> list[CaseCoverage]:
    """Coverage by terrain, slip, motion and gait phase, where the log has the columns.

    errors (M, 3) at `rows` (M,) of the log, as surefoot.models.observer.predict.prediction_errors
    returns them. Returns a CaseCoverage for each case that occurs.
    """
    inside = np.all(np.abs(errors) <= bounds.epsilon, axis=1)
    block = np.arange(len(errors)) // bounds.K
    found = []
    for split, case, where in walking_conditions(log, rows):
        if where.any():
            n, joint = len(np.unique(block[where])), float(inside[where].mean())
            interval = binomial_interval(joint, n)
            found.append(CaseCoverage(split, case, float(where.mean()), joint, interval, n))
    return found


def worst_case(cases: list[CaseCoverage], least: int = 5) -> CaseCoverage | None:
    """The case covered least, of those with `least` independent errors; None where none has."""
    counted = [case for case in cases if case.n >= least]
    return min(counted, key=lambda case: case.joint, default=None)


def binomial_interval(share: float, n: int, confidence: float = 0.95) -> np.ndarray:
    """Clopper-Pearson interval (2,) of a probability, from a share of n trials.

    (Biometrika 26, 1934); share * n need not be an integer, as the bounds are beta quantiles.
    """
    tail, hits = 0.5 * (1 - confidence), share * n
    lower = beta.ppf(tail, hits, n - hits + 1) if hits > 0 else 0.0
    upper = beta.ppf(1 - tail, hits + 1, n - hits) if hits < n else 1.0
    return np.array([lower, upper])
