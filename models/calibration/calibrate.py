"""Bounds on an observer's errors from a log (paper, "Calibration and Coverage Statements").

Errors on a log the observer has not seen, taken K steps apart so that they are nearly independent,
are converted to a region by one of the methods of `surefoot.models.registry.CALIBRATORS`. The
paper's is `conformal`: the bound of each axis is the k-th smallest absolute error, k = ceil((N + 1)
gamma^(1/3)), and the joint level gamma follows if the axes are independent.
`surefoot.models.calibration.empirical_coverage` measures the coverage that results.
"""

from __future__ import annotations

import numpy as np

from surefoot.models.calibration.bias_model import estimate_bias_model, long_enough
from surefoot.models.calibration.bounds import Bounds
from surefoot.models.calibration.conformal import BoundsError
from surefoot.models.calibration.mixing import mixing
from surefoot.models.calibration.regions import Calibrator, Region, calibrator
from surefoot.models.calibration.settings import CALIBRATE_DEFAULT, CalibrateSettings
from surefoot.models.calibration.walk_length import errors_needed
from surefoot.models.observer.decimate import RATE
from surefoot.models.observer.imu_mounting import Mounted
from surefoot.models.observer.observer import Observer, log_digest
from surefoot.models.observer.predict import prediction_errors
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot


def calibrate(
    observer: Observer,
    log: Log,
    settings: CalibrateSettings = CALIBRATE_DEFAULT,
    robot: Mounted | None = None,
) -> Bounds:
    """Bounds that hold jointly with probability gamma, in the frame of the log's IMU.

    Raises BoundsError for a gamma outside (0, 1), a log the observer was trained on, or one too
    short; ObserverError and LogError where the log lacks what the observer or the errors need.

    Args:
        observer: whose errors are bounded.
        log: not used in training, with a reference.
        settings: level and method.
        robot: the log's, by default Robot.for_log.
    """
    gamma, method, K = settings.gamma, settings.method, settings.K
    how = calibrator(method, gamma, settings.confidence)
    seen = {part.sha256: part.name for part in observer.logs}
    digest = log_digest(log)
    if digest in seen:
        raise BoundsError(
            f"{log.name}: the observer was trained on it (as {seen[digest]}); calibration takes a "
            "log that it has not seen"
        )
    robot = Robot.for_log(log) if robot is None else robot
    _, errors = prediction_errors(observer, log, robot)
    require_samples(how, len(errors), 1 if K is None else K, log.name)
    curve = mixing(errors) if K is None else None
    K = curve.K if curve is not None else K
    assert K is not None
    require_samples(how, len(errors), K, log.name)
    shaping, chosen = samples_for(how, errors, K)
    region = region_of(how, shaping, chosen)
    return Bounds(
        epsilon=region.epsilon,
        gamma=gamma,
        level_per_axis=how.level,
        method=method,
        K=K,
        n=len(chosen),
        observer=observer.hash,
        R_BI=np.array(robot.R_BI, dtype=float),
        log=log.name,
        mixing=curve,
        confidence=how.confidence,
        persistent=estimate_bias_model(errors, 1 / RATE, gamma)
        if long_enough(errors, 1 / RATE)
        else None,
    )


def samples_for(how: Calibrator, errors: np.ndarray, K: int) -> tuple[np.ndarray, np.ndarray]:
    """Split errors (n, 3) into those for `fit` and those for `conformalize`.

    The first are the beginning of the log, unchanged; the second are the rest, K apart.
    """
    split = K * int(how.fit_share * (len(errors) // K))
    return errors[:split], subsample(errors[split:], K)


def region_of(how: Calibrator, shaping: np.ndarray, chosen: np.ndarray) -> Region:
    """The region from errors (n, 3) to fit to and (N, 3) to rank [m/s], as from `samples_for`.

    Raises BoundsError where they are too few.
    """
    how.fit(shaping)
    how.conformalize(chosen)
    return how.bounds()


def subsample(errors: np.ndarray, K: int) -> np.ndarray:
    """The last of each complete block of K samples: N = floor(n / K) of them, as in the paper."""
    return errors[K - 1 :: K]


def require_samples(how: Calibrator, n: int, K: int, name: str = "log") -> None:
    """Raise BoundsError if n errors of the log `name`, K apart, are too few for this method."""
    if K < 1:
        raise BoundsError(f"K = {K}: must be 1 at least")
    needed = errors_needed(how)
    if n // K < needed:
        raise BoundsError(
            f"{name}: {n // K} independent samples ({n} at K = {K}), gamma {how.gamma:g} needs "
            f"{needed}: {needed * K / RATE:.1f} s of walk with a reference"
        )
