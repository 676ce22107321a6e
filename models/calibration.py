"""Split-conformal bounds on an observer's errors (paper, "Calibration and Coverage Statements").

Errors on a log the observer has not seen, taken K steps apart so that they are nearly independent,
give each axis the k-th smallest absolute error as its bound, k = ceil((N + 1) gamma^(1/3)). The
joint level gamma follows if the axes are independent; `models.coverage` measures what it came to.
"""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np

from models.bounds import Bounds, BoundsError
from models.decimate import RATE
from models.mixing import mixing
from models.mounting import Mounted
from models.observer import Observer, log_digest
from models.predict import prediction_errors
from sim.log import Log
from sim.robot import Robot

METHODS = ("conformal",)


def calibrate(
    observer: Observer,
    log: Log,
    gamma: float = 0.8,
    method: str = "conformal",
    robot: Mounted | None = None,
    K: int | None = None,
) -> Bounds:
    """Bounds holding jointly with probability gamma, in the frame of the log's IMU.

    K, in steps of 10 ms, comes from the mixing curve of the errors unless it is given. Raises
    BoundsError for a gamma outside (0, 1), a log the observer was trained on, or one too short;
    ObserverError and LogError where the log lacks what the observer or the errors need.
    """
    if method not in METHODS:
        raise BoundsError(f"--method {method}: choose {' | '.join(METHODS)}")
    level = level_per_axis(gamma)
    seen = {part.sha256: part.name for part in observer.logs}
    digest = log_digest(log)
    if digest in seen:
        raise BoundsError(
            f"{log.name}: the observer was trained on it (as {seen[digest]}); calibration takes a "
            "log that it has not seen"
        )
    robot = Robot.for_log(log) if robot is None else robot
    _, errors = prediction_errors(observer, log, robot)
    require_samples(len(errors), 1 if K is None else K, gamma, log.name)
    curve = mixing(errors) if K is None else None
    K = curve.K if curve is not None else K
    assert K is not None
    chosen = subsample(errors, K)
    require_samples(len(errors), K, gamma, log.name)
    return Bounds(
        epsilon=conformal_bounds(np.abs(chosen), level),
        gamma=gamma,
        level_per_axis=level,
        method=method,
        K=K,
        n=len(chosen),
        observer=observer.hash,
        R_BI=np.array(robot.R_BI, dtype=float),
        log=log.name,
        mixing=curve,
    )


def level_per_axis(gamma: float) -> float:
    """gamma^(1/3), the level of each axis. Raises BoundsError unless 0 < gamma < 1."""
    if not 0 < gamma < 1:
        raise BoundsError(f"--gamma {gamma:g}: must lie between 0 and 1")
    return gamma ** (1 / 3)


def rank(n: int, level: float) -> int:
    """k = ceil((n + 1) level): which of n sorted scores is the bound; more than n means none is.

    In exact arithmetic on the level's shortest decimal form, so that 0.9 of 10 is 9 and not 10.
    """
    return math.ceil((n + 1) * Fraction(repr(float(level))))


def conformal_bounds(scores: np.ndarray, level: float) -> np.ndarray:
    """The k-th smallest of scores (N, D) by axis, (D,), k = rank(N, level) <= N."""
    k = rank(len(scores), level)
    return np.sort(scores, axis=0)[k - 1]


def subsample(errors: np.ndarray, K: int) -> np.ndarray:
    """The last of each whole block of K samples: N = floor(n / K) of them, as the paper counts."""
    return errors[K - 1 :: K]


def require_samples(n: int, K: int, gamma: float, name: str = "log") -> None:
    """Raise BoundsError where n errors, K apart, are too few for a finite bound."""
    if K < 1:
        raise BoundsError(f"K = {K}: must be 1 at least")
    level = level_per_axis(gamma)
    needed = math.ceil(level / (1 - level))
    if rank(n // K, level) > n // K:
        raise BoundsError(
            f"{name}: {n // K} independent samples ({n} at K = {K}), gamma {gamma:g} needs "
            f"{needed}: {needed * K / RATE:.1f} s of walk with a reference"
        )
