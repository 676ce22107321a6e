"""Prediction with an observer, for a whole log or sample by sample."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from surefoot.models.observer.imu_mounting import Mounted, move_velocity, same_mounting
from surefoot.models.observer.inference import cholesky_factor
from surefoot.models.observer.observer import Observer, ObserverError, check_robot
from surefoot.models.observer.samples import body_velocity, observer_samples
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot

_LARGEST = 1e6
"""Largest velocity and covariance that an observer may predict [m/s, m^2/s^2]."""


@dataclass(frozen=True)
class Prediction:
    """Body velocities at the 100 Hz rows of a log.

    Attributes:
        rows: indices into the log (M,).
        t: (M,) [s].
        v_I: velocity of the log's IMU in its own frame (M, 3) [m/s].
        covariance: (M, 3, 3) [m^2/s^2] of a `gml` observer, None of an `mse` one.
    """

    rows: np.ndarray
    t: np.ndarray
    v_I: np.ndarray
    covariance: np.ndarray | None


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
        v_I, covariance = Loop(observer, whole=True).steps(seen.x)
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
    return Prediction(seen.rows, seen.t, v_I, covariance)


def prediction_errors(
    observer: Observer, log: Log, robot: Mounted | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Rows (M,) with a measured reference, and the errors v_I predicted - v_I (M, 3) [m/s]
    there.
    """
    prediction = predict(observer, log, robot)
    v_I, measured = body_velocity(log, prediction.rows)
    return prediction.rows[measured], (prediction.v_I - v_I)[measured]


class Loop:
    """An observer in a robot's own loop: one call every 10 ms, keeping its state between calls.

    A `gru` and an `mlp` step in compiled code.
    """

    def __init__(self, observer: Observer, whole: bool = False):
        """Start as at the beginning of a log.

        Raises ObserverError for a model that is not causal, unless the one call has the `whole`
        log.
        """
        self.observer = observer
        self._outputs = observer.running(whole)

    def step(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        """v_I (3,) [m/s], and covariance (3, 3) or None, from signals x (S,), filtered, unscaled.

        The signals are those of surefoot.models.observer.observer.signals, concatenated: q, dq,
        tau, gyro, contact where the inputs need them. The filter is that of
        surefoot.models.observer.decimate over the samples of the last 20 ms.
        """
        v_I, covariance = self.steps(x[None])
        return v_I[0], None if covariance is None else covariance[0]

    def steps(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        """The same for the next samples x (M, S): v_I (M, 3), and covariances (M, 3, 3) or None."""
        outputs = self._outputs(self.observer.scaled(x))
        scale = self.observer.output_scale
        v_I = self.observer.output_mean + scale * outputs[:, :3].astype(float)
        if self.observer.loss != "gml":
            return v_I, None
        L = scale[:, None] * cholesky_factor(outputs).astype(float)
        return v_I, L @ L.swapaxes(-1, -2)
