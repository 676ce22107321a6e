"""Prediction with an observer: for a whole log, in a robot's own loop, or for a log in pieces."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from surefoot.models.observer.observer import Observer, ObserverError, check_robot, signals
from surefoot.models.observer.odometry import Mounted, move_velocity, same_mounting
from surefoot.models.observer.samples import (
    ANTI_ALIAS_SPAN,
    DQ_ZERO_PHASE,
    RATE,
    body_velocity,
    check_rate,
    decimate,
    observer_samples,
)
from surefoot.sim.log import Log
from surefoot.sim.log.derived import CausalDerivative
from surefoot.sim.robot import Robot

_LARGEST = 1e6
"""Largest velocity and covariance that an observer may predict [m/s, m^2/s^2]."""


@dataclass(frozen=True)
class Prediction:
    """Body velocities at the 100 Hz rows of a log.

    Attributes:
        rows: indices into the log (M,).
        v_I: velocity of the log's IMU in its own frame (M, 3) [m/s].
        covariance: (M, 3, 3) [m^2/s^2] of a `gml` observer, None of an `mse` one.
        unlike: distance (M,) of the walk so far from the training walks, 1 being the farthest of
            these; NaN where it is not known (`surefoot.models.observer.novelty`).
    """

    rows: np.ndarray
    v_I: np.ndarray
    covariance: np.ndarray | None
    unlike: np.ndarray


def predict(observer: Observer, log: Log, robot: Mounted | None = None) -> Prediction:
    """Predict velocities along a whole log; a hidden state starts at zero.

    `robot` is the log's, by default Robot.for_log; its mounting may differ from the one the
    observer learnt, in which case the log's gyro is used for the conversion. Raises ObserverError
    where the log lacks an input or is of another robot.
    """
    robot = Robot.for_log(log) if robot is None else robot
    check_robot(observer, robot, log.joints, f"{log.name}: ")
    seen = observer_samples(log, observer.inputs)
    with np.errstate(over="ignore", invalid="ignore"):  # of extreme weights, refused below
        v_I, covariance, unlike = observer.running(whole=True)(seen.x)
    parts = v_I if covariance is None else np.hstack([v_I, covariance.reshape(len(v_I), 9)])
    sound = (np.abs(parts) < _LARGEST).all()  # not of nan
    if not sound or (covariance is not None and np.linalg.eigvalsh(covariance).min() <= 0.0):
        raise ObserverError(
            f"{log.name}: the observer predicts velocities that no robot has, or a "
            "covariance that is not positive: its weights are damaged, or extreme; train it again"
        )
    if not same_mounting(observer, robot):
        if not log.has("imu"):
            raise ObserverError(
                f"{log.name}: its IMU is mounted elsewhere than the observer's, to convert takes "
                "the gyro that the log lacks"
            )
        gyro = log.gyro[seen.rows]
        v_I, covariance = move_velocity(v_I, covariance, gyro, observer, robot)
    return Prediction(seen.rows, v_I, covariance, unlike)


def prediction_errors(
    observer: Observer, log: Log, robot: Mounted | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Rows (M,) with a measured reference, and the errors v_I predicted - v_I (M, 3) [m/s]
    there.
    """
    rows, errors, _ = judged(predict(observer, log, robot), log)
    return rows, errors


def judged(prediction: Prediction, log: Log) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Rows (M,) of a log with a measured reference, the errors v_I predicted - v_I (M, 3) [m/s]
    there, and the predicted covariances (M, 3, 3) [m^2/s^2], None of an `mse` observer.
    """
    v_I, measured = body_velocity(log, prediction.rows)
    covariance = None if prediction.covariance is None else prediction.covariance[measured]
    return prediction.rows[measured], (prediction.v_I - v_I)[measured], covariance


class ObserverStream:
    """`predict` for a log that comes in pieces, keeping the state of decimation, network and
    mounting.

    A row is an update if it is nearest to a point of the 100 Hz grid that starts at the first row,
    assuming that the next stamp, not yet known, comes one period later. With even stamps, the rows
    are those of `predict`, and velocities are equal up to float32 rounding.
    """

    def __init__(
        self,
        observer: Observer,
        robot: Mounted,
        rate: float,
        joints: tuple[str, ...],
        derived: tuple[str, ...] = (),
    ):
        """Start as at the beginning of a log.

        Raises ObserverError or DecimationError where the observer does not fit.

        Args:
            observer: causal; others are refused.
            robot: of the log; its mounting may differ from the one that the observer learnt.
            rate: of the samples [Hz].
            joints: their names in the order of q.
            derived: the log's derived columns; zero-phase joint velocities look into the future and
                are derived again, as are those that samples lack.
        """
        check_robot(observer, robot, joints)
        check_rate(rate)
        self._observer, self._robot = observer, robot
        self._moved = not same_mounting(observer, robot)
        self._running = observer.running()
        self._period = 1.0 / rate
        self._signals = signals(observer.inputs)
        self._rates, self._derives = CausalDerivative(), DQ_ZERO_PHASE in derived
        self._t, self._x = np.zeros(0), np.zeros((0, 0))
        self._start, self._last = np.nan, -1

    def advance(self, t: np.ndarray, readings: Mapping[str, np.ndarray | None]) -> Prediction:
        """Process the next rows; returns the prediction at those of them that are updates. Raises
        ObserverError where an input is missing.

        Args:
            t: stamps (N,) [s].
            readings: SIGNALS by name, q, dq and tau (N, J), gyro and accel (N, 3) in I and contact
                (N, L), None or left out where not measured.
        """
        x = self._inputs(t, readings)
        if np.isnan(self._start):
            self._start, self._x = t[0], x[:0]
        before = len(self._t)
        times, x = np.concatenate([self._t, t]), np.concatenate([self._x, x])
        rows = self._updates(t)
        seen = decimate(times, x, rows + before)
        kept = int(np.searchsorted(times, times[-1] - ANTI_ALIAS_SPAN - 1e-6))
        self._t, self._x = times[kept:], x[kept:]
        v_I, covariance, unlike = self._running(seen)
        if self._moved:
            if (gyro := readings.get("gyro")) is None:
                raise ObserverError("the gyro is missing, by which velocities are converted")
            mountings = self._observer, self._robot
            v_I, covariance = move_velocity(v_I, covariance, gyro[rows], *mountings)
        return Prediction(rows, v_I, covariance, unlike)

    def _inputs(self, t: np.ndarray, readings: Mapping[str, np.ndarray | None]) -> np.ndarray:
        values, q = [], readings.get("q")
        for name in self._signals:
            value = readings.get(name)
            if name == "dq" and (self._derives or value is None) and q is not None:
                value = self._rates(t, q)
            if value is None:
                raise ObserverError(
                    f"the observer reads {','.join(self._signals)}, {name} is missing"
                )
            values.append(value)
        return np.concatenate(values, axis=1)

    def _updates(self, t: np.ndarray) -> np.ndarray:
        """Rows (M,) of t that are nearest to their grid point, one for each."""
        step = 1.0 / RATE
        number = np.rint((t - self._start) / step).astype(np.int64)
        grid = self._start + step * number
        near = np.abs(t - grid) <= min(self._period, 0.5 * step) + 1e-7
        # Ties, within the nanosecond accuracy of stamps, go to the later row, as in
        # `observer_rows`.
        later = (t < grid) & (grid - t >= t + self._period - grid - 1e-7)
        candidates = np.flatnonzero(near & ~later & (number > self._last))
        rows = candidates[np.unique(number[candidates], return_index=True)[1]]
        if len(rows):
            self._last = int(number[rows[-1]])
        return rows
