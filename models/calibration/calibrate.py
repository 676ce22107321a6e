"""Bounds on an observer's errors from a log (paper, "Calibration and Coverage Statements").

Errors on a log the observer has not seen, taken K steps apart so that they are nearly independent,
become a region by one of the methods of `models.calibration.regions`. The paper's is `conformal`:
each axis has
the k-th smallest absolute error as its bound, k = ceil((N + 1) gamma^(1/3)), and the joint level
gamma follows if the axes are independent. `models.calibration.empirical_coverage` measures what it
came to.
"""

from __future__ import annotations

from itertools import count

import numpy as np

from surefoot.models.calibration.bias_model import estimate_bias_model, long_enough
from surefoot.models.calibration.bounds import Bounds, BoundsError
from surefoot.models.calibration.mixing import mixing
from surefoot.models.calibration.regions import (
    SHAPED,
    check_method,
    conformalize,
    fit,
    level_of,
    samples_needed,
)
from surefoot.models.observer.decimate import RATE
from surefoot.models.observer.imu_mounting import Mounted
from surefoot.models.observer.observer import Observer, log_digest
from surefoot.models.observer.predict import prediction_errors
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot

CONFIDENCE = 0.95
"""Of `scenario` bounds, over the calibrations that might have been."""
SHAPING = 0.25
"""Share of the log that fixes the shape of a score that has one."""


def calibrate(
    observer: Observer,
    log: Log,
    gamma: float = 0.8,
    method: str = "conformal",
    robot: Mounted | None = None,
    K: int | None = None,
    confidence: float = CONFIDENCE,
) -> Bounds:
    """Bounds holding jointly with probability gamma, in the frame of the log's IMU.

    `method` is one of `models.calibration.regions.METHODS`, `confidence` that of `scenario`. K, in
    steps of
    10 ms, comes from the mixing curve of the errors unless it is given. Raises BoundsError for a
    gamma outside (0, 1), a log the observer was trained on, or one too short; ObserverError and
    LogError where the log lacks what the observer or the errors need.
    """
    check_method(method)
    level = level_of(method, gamma)
    seen = {part.sha256: part.name for part in observer.logs}
    digest = log_digest(log)
    if digest in seen:
        raise BoundsError(
            f"{log.name}: the observer was trained on it (as {seen[digest]}); calibration takes a "
            "log that it has not seen"
        )
    robot = Robot.for_log(log) if robot is None else robot
    _, errors = prediction_errors(observer, log, robot)
    require_samples(len(errors), 1 if K is None else K, gamma, log.name, method, confidence)
    curve = mixing(errors) if K is None else None
    K = curve.K if curve is not None else K
    assert K is not None
    require_samples(len(errors), K, gamma, log.name, method, confidence)
    shaping, chosen = samples_for(method, errors, K)
    region = conformalize(method, fit(method, shaping), chosen, gamma, confidence)
    return Bounds(
        epsilon=region.epsilon,
        gamma=gamma,
        level_per_axis=level,
        method=method,
        K=K,
        n=len(chosen),
        observer=observer.hash,
        R_BI=np.array(robot.R_BI, dtype=float),
        log=log.name,
        mixing=curve,
        confidence=confidence if method == "scenario" else None,
        persistent=estimate_bias_model(errors, 1 / RATE, gamma)
        if long_enough(errors, 1 / RATE)
        else None,
    )


def subsample(errors: np.ndarray, K: int) -> np.ndarray:
    """The last of each whole block of K samples: N = floor(n / K) of them, as the paper counts."""
    return errors[K - 1 :: K]


def samples_for(method: str, errors: np.ndarray, K: int) -> tuple[np.ndarray, np.ndarray]:
    """What `fit` and what `conformalize` are given of errors (n, 3): the first quarter, the rest.

    Where the method's score has no shape, all errors go to the second. The first are as they come,
    the second K apart.
    """
    split = K * int(SHAPING * (len(errors) // K)) if method in SHAPED else 0
    return errors[:split], subsample(errors[split:], K)


def require_samples(
    n: int,
    K: int,
    gamma: float,
    name: str = "log",
    method: str = "conformal",
    confidence: float = CONFIDENCE,
) -> None:
    """Raise BoundsError where n errors, K apart, are too few for a finite bound."""
    if K < 1:
        raise BoundsError(f"K = {K}: must be 1 at least")
    needed = samples_needed(method, gamma, confidence)
    if method in SHAPED:
        needed = next(m for m in count(needed) if m - int(SHAPING * m) >= needed)
    if n // K < needed:
        raise BoundsError(
            f"{name}: {n // K} independent samples ({n} at K = {K}), gamma {gamma:g} needs "
            f"{needed}: {needed * K / RATE:.1f} s of walk with a reference"
        )
