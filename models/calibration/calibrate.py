"""Bounds on an observer's errors from logs (paper, "Calibration and Coverage Statements").

Errors on logs that the observer has not seen, taken K steps apart so that they are nearly
independent, are converted to a region by one of the methods of
`surefoot.models.registry.CALIBRATORS`. The
paper's is `conformal`: the bound of each axis is the k-th smallest absolute error, k = ceil((N + 1)
gamma^(1/3)), and the joint level gamma follows if the axes are independent.

A `gml` observer predicts how uncertain it is. Its errors are ranked in these standard deviations,
so that bounds are narrow where legs show the velocity well and wide on stairs or slippery ground.
The level holds for any scale that is learnt from other walks (Lei et al., Distribution-Free
Predictive Inference for Regression, JASA 2018, section 5.2).

`surefoot.models.calibration.empirical_coverage` measures the coverage that results.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from surefoot.models.calibration.bias_model import estimate_bias_model, long_enough
from surefoot.models.calibration.bounds import Bounds
from surefoot.models.calibration.mixing import mixing
from surefoot.models.calibration.regions import (
    BoundsError,
    Calibrator,
    Region,
    calibrator,
    errors_needed,
)
from surefoot.models.calibration.settings import CALIBRATE_DEFAULT, CalibrateSettings
from surefoot.models.observer.observer import Observer, log_digest
from surefoot.models.observer.odometry import Mounted
from surefoot.models.observer.predict import judged, predict
from surefoot.models.observer.samples import RATE
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot


def calibrate(
    observer: Observer,
    logs: Log | Iterable[Log],
    settings: CalibrateSettings = CALIBRATE_DEFAULT,
    robot: Mounted | None = None,
) -> Bounds:
    """Bounds that hold jointly with probability gamma, in the frame of the logs' IMU.

    The errors of several walks are pooled: the statement is then about walks drawn like these, and
    on a single one the coverage may be smaller (`left_out_coverage`). Raises BoundsError for a
    gamma outside (0, 1), a log the observer was trained on, other mountings of the IMU, or too few
    errors; ObserverError and LogError where a log lacks what the observer or the errors need.

    Args:
        observer: whose errors are bounded.
        logs: one or several, not used in training, with a reference; each is read once.
        settings: level and method.
        robot: the logs', by default Robot.for_log.
    """
    unseen = unseen_errors(observer, [logs] if isinstance(logs, Log) else logs, robot)
    return bounds_on(observer, unseen, settings)


@dataclass(frozen=True)
class UnseenErrors:
    """Errors of an observer on logs that it was not trained on.

    Attributes:
        names: of the logs.
        errors: (n, 3) [m/s] on each.
        relative: the same, of a `gml` observer in its predicted standard deviations.
        R_BI: mounting of their IMU (3, 3).
    """

    names: list[str]
    errors: list[np.ndarray]
    relative: list[np.ndarray]
    R_BI: np.ndarray


def unseen_errors(
    observer: Observer, logs: Iterable[Log], robot: Mounted | None = None
) -> UnseenErrors:
    """Errors on each of the logs.

    Raises BoundsError for a log of the training, or one whose IMU is mounted at another angle.
    """
    seen = {part.sha256: part.name for part in observer.logs}
    names, errors, relative, mountings = [], [], [], []
    for log in logs:
        if (digest := log_digest(log)) in seen:
            raise BoundsError(
                f"{log.name}: the observer was trained on it (as {seen[digest]}); calibration "
                "takes a log that it has not seen"
            )
        declared = Robot.for_log(log) if robot is None else robot
        names.append(log.name)
        _, e, covariance = judged(predict(observer, log, declared), log)
        std = 1.0 if covariance is None else np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
        errors.append(e)
        relative.append(e / std)
        mountings.append(np.array(declared.R_BI, dtype=float))
        if not np.allclose(mountings[-1], mountings[0], atol=1e-4):
            raise BoundsError(f"{log.name}: its IMU is mounted at another angle than {names[0]}'s")
    return UnseenErrors(names, errors, relative, mountings[0])


def bounds_on(
    observer: Observer, unseen: UnseenErrors, settings: CalibrateSettings = CALIBRATE_DEFAULT
) -> Bounds:
    """`calibrate` from the errors of the observer on some logs. Raises BoundsError where they are
    too few, or for a gamma outside (0, 1).
    """
    how = calibrator(settings.method, settings.gamma, settings.confidence)
    errors = unseen.relative
    together, name = np.concatenate(errors), ", ".join(unseen.names)
    K, curve = settings.K, None
    require_samples(how, len(together), 1 if K is None else K, name)
    if K is None:
        walk = np.repeat(np.arange(len(errors)), [len(part) for part in errors])
        curve = mixing(together, walk=walk)
        K = curve.K
    require_samples(how, sum(len(part) // K * K for part in errors), K, name)
    shaping, chosen = samples_for(how, errors, K)
    lasting = long_enough(together, 1 / RATE)
    return Bounds(
        epsilon=region_of(how, shaping, chosen).epsilon,
        gamma=settings.gamma,
        level_per_axis=how.level,
        method=settings.method,
        K=K,
        n=len(chosen),
        observer=observer.hash,
        R_BI=unseen.R_BI,
        log=name,
        mixing=curve,
        confidence=how.confidence,
        persistent=estimate_bias_model(unseen.errors, 1 / RATE, how.gamma) if lasting else None,
        scaled=observer.loss == "gml",
    )


def left_out_coverage(
    errors: Sequence[np.ndarray], settings: CalibrateSettings, K: int
) -> list[float]:
    """Joint coverage of each walk's errors (n, 3) by bounds from all other walks.

    It shows how much bounds from some walks can be trusted on another. NaN where the others are
    too few.

    Args:
        errors: of several walks, as `relative` of `unseen_errors`.
        settings: level and method.
        K: spacing of the errors.
    """
    found = []
    for k, part in enumerate(errors):
        how = calibrator(settings.method, settings.gamma, settings.confidence)
        others = samples_for(how, [*errors[:k], *errors[k + 1 :]], K)
        enough = len(others[1]) >= how.samples_needed()
        region = region_of(how, *others) if enough else None
        found.append(float(region.contains(part).mean()) if region else np.nan)
    return found


def samples_for(
    how: Calibrator, errors: Sequence[np.ndarray], K: int
) -> tuple[np.ndarray, np.ndarray]:
    """Split errors (n, 3) of each walk into those for `fit` and those for `conformalize`.

    The first are the beginning of each walk, unchanged; the second are the rest, K apart.
    """
    splits = [K * int(how.fit_share * (len(part) // K)) for part in errors]
    shaping = [part[:split] for part, split in zip(errors, splits, strict=True)]
    chosen = [subsample(part[split:], K) for part, split in zip(errors, splits, strict=True)]
    return np.concatenate(shaping), np.concatenate(chosen)


def region_of(how: Calibrator, shaping: np.ndarray, chosen: np.ndarray) -> Region:
    """The region from errors (n, 3) to fit to and (N, 3) to rank, as from `samples_for`.

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
