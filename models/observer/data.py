"""Training data of a network: scaled logs, validation rows, random windows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from surefoot.models.observer.decimate import RATE
from surefoot.models.observer.imu_mounting import Mounted, same_mounting
from surefoot.models.observer.observer import ObserverError, observer_inputs
from surefoot.models.observer.odometry import Kinematics, LegGeometry, leg_geometry
from surefoot.models.observer.samples import body_velocity, observer_samples
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot

WINDOW = 1000
"""Length of a window in steps of 10 ms, as in the paper."""
BEGINNINGS = 1 / 8
"""Share of windows that begin where their log does. There an observer starts from the zero state,
mostly at rest; of random windows only one in thousands would contain it, and its first predictions
would be off by 0.5 m/s.
"""


@dataclass(frozen=True)
class ScaledLog:
    """One scaled log: x (M, C), y (M, 3), and masks of the training and validation rows (M,)."""

    x: torch.Tensor
    y: torch.Tensor
    train: torch.Tensor
    validation: torch.Tensor

    def to(self, device: torch.device) -> ScaledLog:
        """The same log on another device."""
        parts = (self.x, self.y, self.train, self.validation)
        return ScaledLog(*(part.to(device) for part in parts))


@dataclass(frozen=True)
class Dataset:
    """Logs of one robot, with the offset and scale of x (C,) and the scale of y (3,) in m/s.

    y is not centred, so that the zero state predicts about zero, as a log starts at rest.
    """

    logs: tuple[ScaledLog, ...]
    x_mean: np.ndarray
    x_scale: np.ndarray
    y_scale: np.ndarray
    robot: Mounted
    causal_dq: bool
    legs: LegGeometry


def prepare(logs: Sequence[Log], robot: Mounted | None, inputs: tuple[str, ...]) -> Dataset:
    """Prepare logs for training.

    Raises ObserverError where one is too short or lacks an input, or where they disagree on robot,
    mounting or joints; LogError where one has no reference.
    """
    robot = _common_robot(logs, robot)
    seen = [observer_samples(log, inputs) for log in logs]
    labels = [body_velocity(log, sample.rows) for log, sample in zip(logs, seen, strict=True)]
    for log, (_, measured) in zip(logs, labels, strict=True):
        if len(measured) < WINDOW or measured.sum() < WINDOW // 2:
            raise ObserverError(
                f"{log.name}: {len(measured) / RATE:.1f} s of walk, {measured.sum() / RATE:.1f} s "
                f"of it with a reference; training takes {WINDOW / RATE:g} s at least"
            )
    legs = leg_geometry(robot, logs[0].joints) if "feet" in inputs else {}
    kinematics = Kinematics.of(legs, robot) if legs else None
    unscaled = [observer_inputs(inputs, kinematics, sample.x) for sample in seen]
    x_mean, x_scale = _scaling(unscaled)
    _, y_scale = _scaling([v_I[ok & ~validation_rows(len(ok))] for v_I, ok in labels])
    scaled = []
    for x, (v_I, measured) in zip(unscaled, labels, strict=True):
        validation = validation_rows(len(measured)) & measured
        scaled.append(
            ScaledLog(
                torch.from_numpy(((x - x_mean) / x_scale).astype(np.float32)),
                torch.from_numpy((v_I / y_scale).astype(np.float32)),
                torch.from_numpy(measured & ~validation),
                torch.from_numpy(validation),
            )
        )
    if not any(log.validation.any() for log in scaled):
        raise ObserverError("train: the reference is missing in all validation blocks")
    return Dataset(tuple(scaled), x_mean, x_scale, y_scale, robot, seen[0].causal_dq, legs)


def validation_rows(steps: int) -> np.ndarray:
    """Mask of a log's validation steps (M,): one second in each ten, from the fifth on.

    Short blocks throughout the log withhold no manoeuvre entirely (two seconds in sixteen cost half
    of the forward accuracy elsewhere). A second is two strides, longer than errors are correlated,
    and the score on it agreed with that on unseen walks.
    """
    return np.arange(steps) % 1000 // 100 == 5


def draw(
    logs: Sequence[ScaledLog], batch: int, unsettled: int, rng: np.random.Generator
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Random windows: x (WINDOW, B, C), y (WINDOW, B, 3), and a mask of the training rows (WINDOW,
    B).

    A window that begins inside a log starts from a zero state that does not occur in use; its first
    `unsettled` rows are not trained on.
    """
    starts = np.array([len(log.x) - WINDOW + 1 for log in logs])
    chosen = rng.choice(len(logs), size=batch, p=starts / starts.sum())
    windows = []
    for i in chosen:
        first = 0 if rng.random() < BEGINNINGS else int(rng.integers(starts[i]))
        windows.append((logs[i], slice(first, first + WINDOW)))
    x = torch.stack([log.x[window] for log, window in windows], 1)
    y = torch.stack([log.y[window] for log, window in windows], 1)
    train = torch.stack([log.train[window] for log, window in windows], 1)
    inside = torch.tensor([window.start > 0 for _, window in windows], device=train.device)
    train[:unsettled, inside] = False
    return x, y, train


def _scaling(parts: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard deviation of each channel; a constant channel keeps unit scale."""
    values = np.concatenate(parts)
    spread = values.std(axis=0)
    return values.mean(axis=0), np.where(spread > 1e-6, spread, 1.0)


def _common_robot(logs: Sequence[Log], robot: Mounted | None) -> Mounted:
    robots = [Robot.for_log(log) if robot is None else robot for log in logs]
    for log, other in zip(logs, robots, strict=True):
        if other.name != robots[0].name:
            raise ObserverError(
                f"{log.name}: is of {other.name}, {logs[0].name} of {robots[0].name}"
            )
        if not same_mounting(other, robots[0]):
            raise ObserverError(f"{log.name}: its IMU is mounted elsewhere than {logs[0].name}'s")
        if log.joints != logs[0].joints:
            raise ObserverError(f"{log.name}: its joints differ from {logs[0].name}'s")
    return robots[0]
