"""Empirical coverage of an observer's errors by their bounds, overall and by condition."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.stats import beta

from surefoot.models.calibration.bounds import Bounds, BoundsError
from surefoot.models.observer.predict import Prediction, judged
from surefoot.sim.log import Log
from surefoot.sim.physics.foot_truth import SLIPPING

SLIPPERY = 0.4
"""Friction coefficient under a loaded foot."""
STEEP = 0.05
"""Slope of the reference path, over a second before and after."""
TURNING = 0.3
"""Rate about the vertical from which a robot turns [rad/s]."""
STILL = 0.05
"""Mean speed below which a robot stands [m/s], over the two seconds of STEEP."""
SHORTEST_STRIDE = 0.2
"""Least time from a touchdown of a foot to its next [s]."""
QUARTERS = ("first", "second", "third", "last")

ConditionRows = tuple[str, str, np.ndarray]


def walking_conditions(log: Log, rows: np.ndarray) -> Iterator[ConditionRows]:
    """Yield (split, case, mask of `rows` (M,)) for every split whose columns the log has.

    terrain: level, climbing, descending, by the reference path. motion: standing, straight,
    turning. slip and ground: by the truth columns of a simulation. stride: quarters of the time
    between touchdowns of the first leg, by its contact.
    """
    if log.has("reference"):
        yield from _path(log, rows)
    if log.has("truth"):
        slipping = log.slip[rows].max(axis=1) > SLIPPING
        yield "slip", "a foot slips", slipping
        yield "slip", "no foot slips", ~slipping
        under = np.where(log.slip[rows] > 0, log.mu[rows], np.inf)
        least = under.min(axis=1)  # no foot loaded: neither
        yield "ground", f"friction below {SLIPPERY:g}", least < SLIPPERY
        yield "ground", "dry", (least >= SLIPPERY) & np.isfinite(least)
    if log.has("contact"):
        phase = stride_phase(log.t, log.contact[:, 0])[rows]
        for k, name in enumerate(QUARTERS):
            yield "stride", f"{name} quarter", np.floor(4 * phase) == k


def _path(log: Log, rows: np.ndarray) -> Iterator[ConditionRows]:
    second = max(1, round(log.rate))
    ahead, behind = np.minimum(rows + second, len(log.t) - 1), np.maximum(rows - second, 0)
    step = log.ref_p[ahead] - log.ref_p[behind]
    run, time = np.linalg.norm(step[:, :2], axis=1), log.t[ahead] - log.t[behind]
    still = run < STILL * time
    slope = np.where(still, 0.0, step[:, 2] / np.where(still, 1.0, run))
    yield "terrain", "level", np.abs(slope) <= STEEP
    yield "terrain", "climbing", slope > STEEP
    yield "terrain", "descending", slope < -STEEP
    yaw = np.unwrap(np.arctan2(log.ref_R_GI[:, 1, 0], log.ref_R_GI[:, 0, 0]))
    turning = np.abs(yaw[ahead] - yaw[behind]) > TURNING * time
    yield "motion", "standing", still & ~turning
    yield "motion", "straight", ~still & ~turning
    yield "motion", "turning", turning


def stride_phase(t: np.ndarray, contact: np.ndarray) -> np.ndarray:
    """Phase (N,) in [0, 1) from one touchdown of a foot to its next; NaN where there is none.

    contact (N,) bool. A touchdown within SHORTEST_STRIDE of the last is a bounce; strides of more
    than two seconds are rests.
    """
    touchdowns = np.flatnonzero(contact[1:] & ~contact[:-1]) + 1
    kept: list[int] = []
    for row in touchdowns.tolist():
        if not kept or t[row] - t[kept[-1]] >= SHORTEST_STRIDE:
            kept.append(row)
    phase = np.full(len(t), np.nan)
    for begin, end in pairwise(kept):
        if t[end] - t[begin] <= 2.0:
            phase[begin:end] = (t[begin:end] - t[begin]) / (t[end] - t[begin])
    return phase


@dataclass(frozen=True)
class EmpiricalCoverage:
    """Share of errors within their bounds on all axes, with its 95 % Clopper-Pearson interval (2,)
    for `n` independent errors.
    """

    joint: float
    joint_interval: np.ndarray
    n: int


def bounded_errors(
    prediction: Prediction, bounds: Bounds, log: Log, R_BI: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Rows (M,) of a log with a measured reference, and the errors (M, 3) of a prediction there,
    along the axes of the bounds and in their unit (`Bounds.relative`).

    R_BI (3, 3) is the mounting of the log's IMU.
    """
    rows, errors, covariance = judged(prediction, log)
    return rows, bounds.relative(errors, R_BI, covariance)


def coverage(errors: np.ndarray, bounds: Bounds) -> EmpiricalCoverage:
    """Share of errors (M, 3), at 100 Hz, as from `bounded_errors`, within their bounds.

    Successive errors are not independent: the interval assumes M / K independent ones, with the K
    of the bounds' calibration. Raises BoundsError where there is none.
    """
    n = len(errors) // bounds.K
    if n < 1:
        raise BoundsError(f"{len(errors)} errors are not one independent trial at K = {bounds.K}")
    joint = float((np.abs(errors) <= bounds.epsilon).all(axis=1).mean())
    return EmpiricalCoverage(joint, binomial_interval(joint, n), n)


@dataclass(frozen=True)
class CaseCoverage:
    """Joint coverage of the errors in one case of one condition.

    time: share of all errors; n: independent ones, the blocks of K samples that contain an error of
    the case.
    """

    split: str
    case: str
    time: float
    joint: float
    n: int


def coverage_by(
    log: Log, rows: np.ndarray, errors: np.ndarray, bounds: Bounds
) -> list[CaseCoverage]:
    """Coverage by terrain, slip, motion and gait phase, where the log has the columns.

    errors (M, 3) at `rows` (M,) of the log, as from `bounded_errors`. Returns a CaseCoverage for
    each case that occurs.
    """
    inside = np.all(np.abs(errors) <= bounds.epsilon, axis=1)
    block = np.arange(len(errors)) // bounds.K
    found = []
    for split, case, where in walking_conditions(log, rows):
        if where.any():
            n, joint = len(np.unique(block[where])), float(inside[where].mean())
            found.append(CaseCoverage(split, case, float(where.mean()), joint, n))
    return found


def binomial_interval(share: float, n: int) -> np.ndarray:
    """95 % Clopper-Pearson interval (2,) of a probability, from a share of n trials.

    (Biometrika 26, 1934); share * n need not be an integer, as the bounds are beta quantiles.
    """
    tail, hits = 0.025, share * n
    lower = beta.ppf(tail, hits, n - hits + 1) if hits > 0 else 0.0
    upper = beta.ppf(1 - tail, hits + 1, n - hits) if hits < n else 1.0
    return np.array([lower, upper])
