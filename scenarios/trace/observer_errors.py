"""What the errors of an observer on a measured walk are made of, beside those in simulation."""

from dataclasses import dataclass

import numpy as np

from surefoot.models.calibration.bounds import Bounds
from surefoot.models.calibration.calibrate import calibrate
from surefoot.models.calibration.walking_conditions import QUARTERS, stride_phase
from surefoot.models.observer.decimate import RATE
from surefoot.models.observer.observer import Observer
from surefoot.models.observer.predict import prediction_errors
from surefoot.models.observer.samples import body_velocity
from surefoot.models.observer.training import Schedule, train
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot
from surefoot.sim.walking.imitation import moving

_SLOW, _FAST = 1.0, 0.2
"""s, of the running means whose output is the slow part, and what they leave the fast one: two
strides of a trot, and less than half of one."""
STRIDE_BINS = 5 * len(QUARTERS)
"""Bins of a stride."""
_STANDING = "standing"
ERROR_PARTS = {
    "constant": "the mean",
    "with the motion": "what goes with velocity and turn rate, by least squares",
    "slow": f"a running mean over {_SLOW:g} s of what is left then",
    "with the stride": "what is left then and repeats with the stride, by phase",
    "from stride to stride": f"a running mean over {_FAST:g} s of what is left then",
    "fast": "the rest",
}
"""Parts of the errors while the robot moves, each of what those before it leave."""


@dataclass(frozen=True)
class ErrorParts:
    """Root mean squares (3,) [m/s] of errors: `all`, while it stands, while it moves, and of the
    ERROR_PARTS of the latter."""

    rms: dict[str, list[float]]

    def table(self, other: "ErrorParts") -> list[dict[str, object]]:
        """Rows of both, this one simulated, the other measured."""
        rows = []
        for name, simulated in self.rms.items():
            row: dict[str, object] = {"part": name}
            for a, axis in enumerate(("forward", "lateral", "vertical")):
                row[f"{axis}, simulated"] = f"{simulated[a]:.3f}"
                row[f"{axis}, measured"] = f"{other.rms[name][a]:.3f}"
            rows.append(row)
        return rows

    def excess(self, measured: "ErrorParts") -> dict[str, float]:
        """Shares of ERROR_PARTS, the largest first, in the squares that measured errors have beyond
        these, all axes together; a part that is no larger has none."""
        beyond = {
            name: max(0.0, float(np.sum(np.square(measured.rms[name]) - np.square(self.rms[name]))))
            for name in ERROR_PARTS
        }
        total = sum(beyond.values())
        shares = {name: x / total for name, x in beyond.items()} if total else beyond
        return dict(sorted(shares.items(), key=lambda item: -item[1]))


def error_parts(observer: Observer, log: Log, robot: Robot | None = None) -> ErrorParts:
    """Parts of an observer's errors on a log, in the frame of its IMU.

    robot is the log's (Robot.for_log where left out).
    """
    rows, errors = prediction_errors(observer, log, robot)
    moves = moving(log)[rows]
    v, _ = body_velocity(log, rows)
    regressors = np.column_stack([v, log.gyro[rows][:, 2]])
    phase = stride_phase(log.t, log.contact[:, 0])[rows] if log.has("contact") else None
    found = {"all": errors, _STANDING: errors[~moves], "moving": errors[moves]}
    found |= split_errors(errors, regressors, phase, moves)
    return ErrorParts({name: root_mean_square(part) for name, part in found.items()})


def split_errors(
    errors: np.ndarray, motion: np.ndarray, phase: np.ndarray | None, moves: np.ndarray
) -> dict[str, np.ndarray]:
    """ERROR_PARTS (K, 3) of errors (M, 3) at 100 Hz, at the K rows that move; they add up to them.

    Args:
        errors: of the velocity [m/s].
        motion: regressors (M, R).
        phase: of the stride (M,), 0 to 1, NaN outside; None of a log without contacts.
        moves: rows (M,) to split.
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
        own = phase[moves]
        walks = np.isfinite(own)
        bins = np.floor(STRIDE_BINS * own[walks]).astype(int)
        means = [
            left[walks][bins == b].mean(axis=0) if (bins == b).any() else np.zeros(3)
            for b in range(STRIDE_BINS)
        ]
        parts["with the stride"][walks] = np.array(means)[bins]
    left = left - parts["with the stride"]
    parts["from stride to stride"] = _running_mean(left, _FAST)
    parts["fast"] = left - parts["from stride to stride"]
    return parts


def recalibrated(
    observer: Observer, bounds: Bounds, log: Log, robot: Robot
) -> tuple[np.ndarray, float]:
    """Bounds (3,) [m/s] from the first half of a measured log, and the share of the errors of its
    second half that they hold. Errors are taken as far apart as in the simulated calibration.

    Raises BoundsError where half of the log is too short.
    """
    half = len(log.t) // 2
    seen = log.rows(slice(0, half))
    again = calibrate(observer, seen, bounds.gamma, bounds.method, robot, bounds.K)
    rows, errors = prediction_errors(observer, log, robot)
    inside = np.abs(errors[rows >= half]) <= again.epsilon
    return again.epsilon, float(inside.all(axis=1).mean())


def learnt_from_measured(
    log: Log, robot: Robot, inputs: str, seed: int, schedule: Schedule
) -> list[float]:
    """Errors (3,) [m/s], root mean square while the robot moves, of observers each trained on one
    half of the measured log, on the other half: about what so much of a real walk can teach.

    Args:
        log: the measured log.
        robot: as declared.
        inputs: of the observers.
        seed: of their training.
        schedule: of it.

    Raises ObserverError where half of the log is too short.
    """
    half = len(log.t) // 2
    halves = log.rows(slice(0, half)), log.rows(slice(half, None))
    left = []
    for own, other in (halves, halves[::-1]):
        observer = train(own, robot, inputs, "mse", seed, schedule=schedule)
        rows, errors = prediction_errors(observer, other, robot)
        left.append(errors[moving(other)[rows]])
    return root_mean_square(np.concatenate(left))


def root_mean_square(errors: np.ndarray) -> list[float]:
    """Root mean square (3,) of errors (N, 3); zero of none."""
    return np.sqrt((errors**2).sum(axis=0) / max(len(errors), 1)).tolist()


def _running_mean(values: np.ndarray, span: float) -> np.ndarray:
    """Means (N, 3) over `span` [s] about each row; over what there is of it at the ends."""
    n = round(span * RATE)
    weight = np.ones(n)
    count = np.convolve(np.ones(len(values)), weight, "same")
    return np.column_stack([np.convolve(v, weight, "same") / count for v in values.T])
