"""Parts of an observer's velocity errors: a constant, a part linear in the motion, slow and fast
ones.

The loop reports the parts on a measured walk and in simulation.
"""

from contextlib import suppress
from dataclasses import dataclass

import numpy as np
import pandas as pd

from surefoot.models.calibration.bounds import Bounds
from surefoot.models.calibration.calibrate import calibrate
from surefoot.models.calibration.empirical_coverage import QUARTERS, bounded_errors, stride_phase
from surefoot.models.calibration.regions import BoundsError
from surefoot.models.calibration.settings import CalibrateSettings
from surefoot.models.observer.observer import Observer
from surefoot.models.observer.predict import predict, prediction_errors
from surefoot.models.observer.samples import RATE, body_velocity
from surefoot.models.observer.settings import TrainSettings
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot
from surefoot.sim.walking.imitation import moving

_SLOW, _FAST = 1.0, 0.2
"""Lengths of the running means [s] that give the slow part and the part from stride to stride: two
strides of a trot, and less than half of one.
"""
STRIDE_BINS = 5 * len(QUARTERS)
"""Number of bins of a stride's phase."""
ERROR_PARTS = {
    "constant": "the mean",
    "with the motion": "linear in velocity and turn rate, by least squares",
    "slow": f"a running mean over {_SLOW:g} s of what is left then",
    "with the stride": "of what is left then, the mean by phase of the stride",
    "from stride to stride": f"a running mean over {_FAST:g} s of what is left then",
    "fast": "the rest",
}
"""Parts of the errors while the robot moves, each fitted to the remainder of those before it."""


ErrorParts = dict[str, list[float]]
"""Root mean squares (3,) [m/s] of an observer's errors, forward, lateral and vertical: of "all"
errors, of those while the robot is "standing" and "moving", and of the ERROR_PARTS of the last.
"""


def parts_table(simulated: ErrorParts, measured: ErrorParts) -> list[dict[str, object]]:
    """One row for each part."""
    rows = []
    for name in simulated:
        row: dict[str, object] = {"part": name}
        for a, axis in enumerate(("forward", "lateral", "vertical")):
            row[f"{axis}, simulated"] = f"{simulated[name][a]:.3f}"
            row[f"{axis}, measured"] = f"{measured[name][a]:.3f}"
        rows.append(row)
    return rows


def excess(simulated: ErrorParts, measured: ErrorParts) -> dict[str, float]:
    """Share of each of ERROR_PARTS in the excess of the measured squared errors over the simulated.

    Over all axes, largest share first; a part that is not larger when measured has 0.
    """
    beyond = {
        name: max(0.0, float(np.sum(np.square(measured[name]) - np.square(simulated[name]))))
        for name in ERROR_PARTS
    }
    total = sum(beyond.values())
    shares = {name: x / total for name, x in beyond.items()} if total else beyond
    return dict(sorted(shares.items(), key=lambda item: -item[1]))


def error_parts(observer: Observer, log: Log, robot: Robot | None = None) -> ErrorParts:
    """Parts of an observer's errors on a log, in the frame of its IMU.

    robot: the model of the log's robot; by default Robot.for_log.
    """
    rows, errors = prediction_errors(observer, log, robot)
    moves = moving(log)[rows]
    v, _ = body_velocity(log, rows)
    regressors = np.column_stack([v, log.gyro[rows][:, 2]])
    phase = stride_phase(log.t, log.contact[:, 0])[rows] if log.has("contact") else None
    found = {"all": errors, "standing": errors[~moves], "moving": errors[moves]}
    found |= split_errors(errors, regressors, phase, moves)
    return {name: root_mean_square(part) for name, part in found.items()}


def split_errors(
    errors: np.ndarray, motion: np.ndarray, phase: np.ndarray | None, moves: np.ndarray
) -> dict[str, np.ndarray]:
    """ERROR_PARTS, each (K, 3) [m/s], at the K rows in which the robot moves; sum: `errors`.

    Args:
        errors: of the velocity (M, 3) [m/s], at 100 Hz.
        motion: regressors (M, R): velocity and turn rate.
        phase: of the stride (M,), 0 to 1, NaN outside strides; None for a log without contacts.
        moves: (M,) bool, whether the robot moves.
    """
    left, parts = errors[moves], {}
    parts["constant"] = np.broadcast_to(left.mean(axis=0), left.shape)
    left = left - parts["constant"]
    centred = motion[moves] - motion[moves].mean(axis=0)
    parts["with the motion"] = centred @ np.linalg.lstsq(centred, left, rcond=None)[0]
    left = left - parts["with the motion"]
    parts["slow"] = _running_mean(left, _SLOW)
    left = left - parts["slow"]
    parts["with the stride"] = np.zeros_like(left)
    if phase is not None:
        # Rows outside strides are in no bin: their mean is missing.
        means = pd.DataFrame(left).groupby(np.floor(STRIDE_BINS * phase[moves])).transform("mean")
        parts["with the stride"] = means.fillna(0.0).to_numpy()
    left = left - parts["with the stride"]
    parts["from stride to stride"] = _running_mean(left, _FAST)
    parts["fast"] = left - parts["from stride to stride"]
    return parts


def recalibrated(
    observer: Observer, bounds: Bounds, log: Log, robot: Robot
) -> tuple[np.ndarray, float]:
    """Bounds (3,) [m/s] from the first half of a measured log, and their coverage of the second.

    The coverage is the share of samples with all three errors within the bounds. Method, level and
    spacing K of the errors are those of `bounds`. Raises BoundsError where half of the log is too
    short.
    """
    half = len(log.t) // 2
    first = log.rows(slice(0, half))
    how = CalibrateSettings(gamma=bounds.gamma, method=bounds.method, K=bounds.K)
    new = calibrate(observer, first, how, robot)
    rows, errors = bounded_errors(predict(observer, log, robot), new, log, robot.R_BI)
    inside = np.abs(errors[rows >= half]) <= new.epsilon
    return new.epsilon, float(inside.all(axis=1).mean())


@dataclass(frozen=True)
class TunedErrors:
    """Observers tuned on each half of a measured walk, judged on the other.

    Attributes:
        rmse: root mean square errors on the other half while the robot moves (3,) [m/s].
        epsilon: half widths of bounds from a quarter that is not tuned on, mean of both (3,) [m/s];
            None where a quarter is too short for them.
        held: share of the last quarter's errors within them, jointly, mean of both; likewise.
    """

    rmse: list[float]
    epsilon: list[float] | None
    held: float | None


def tuned_on_measured(
    observer: Observer, bounds: Bounds, log: Log, robot: Robot, settings: TrainSettings
) -> TunedErrors:
    """Tune an observer on each half of a measured walk and evaluate it on the other.

    Raises ObserverError where half of the log is too short.

    Args:
        observer: to be tuned, from simulated walks.
        bounds: whose method, level and spacing K the new ones have.
        log: the measured walk.
        robot: the model of its robot.
        settings: of the training.
    """
    from surefoot.models.observer.training import train

    half = len(log.t) // 2
    halves = log.rows(slice(0, half)), log.rows(slice(half, None))
    moved, judged = [], []
    for seen, unseen in (halves, halves[::-1]):
        tuned = train(seen, robot, settings, start=observer)
        rows, errors = prediction_errors(tuned, unseen, robot)
        moved.append(errors[moving(unseen)[rows]])
        with suppress(BoundsError):
            judged.append(recalibrated(tuned, bounds, unseen, robot))
    rmse = root_mean_square(np.concatenate(moved))
    if len(judged) < len(halves):
        return TunedErrors(rmse, None, None)
    epsilons, held = zip(*judged, strict=True)
    return TunedErrors(rmse, np.mean(epsilons, axis=0).tolist(), float(np.mean(held)))


def root_mean_square(errors: np.ndarray) -> list[float]:
    """Root mean square (3,) over rows of errors (N, 3); zero where there are none."""
    return np.sqrt((errors**2).sum(axis=0) / max(len(errors), 1)).tolist()


def _running_mean(values: np.ndarray, span: float) -> np.ndarray:
    """Centred running mean (N, 3) over `span` [s] at 100 Hz; over fewer rows near the ends."""
    window = round(span * RATE)
    return pd.DataFrame(values).rolling(window, min_periods=1, center=True).mean().to_numpy()
