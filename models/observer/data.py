"""What a network is shown in training: scaled walks, which of their rows teach, random windows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from surefoot.models.observer.decimate import RATE
from surefoot.models.observer.imu_mounting import Mounted, same_mounting
from surefoot.models.observer.observer import ObserverError, observer_inputs
from surefoot.models.observer.odometry import Kinematics, LegGeometry, leg_geometry
from surefoot.models.observer.samples import body_velocity, samples
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot

WINDOW = 1000
"""Steps of 10 ms, as in the paper."""
BEGINNINGS = 1 / 8
"""Share of windows that begin where their log does. An observer starts there, from the zero state
and mostly at rest; left to chance, one window in thousands would show it, and its first predictions
are off by half a metre a second."""


@dataclass(frozen=True)
class Walk:
    """One log, scaled: x (M, C), y (M, 3), and which rows teach, or are held out (M,)."""

    x: torch.Tensor
    y: torch.Tensor
    learn: torch.Tensor
    held: torch.Tensor


@dataclass(frozen=True)
class Dataset:
    """Walks of one robot, and the scales they were brought to: (C,) of x, (3,) in m/s of y."""

    walks: tuple[Walk, ...]
    x_mean: np.ndarray
    x_scale: np.ndarray
    y_mean: np.ndarray
    y_scale: np.ndarray
    robot: Mounted
    causal_dq: bool
    legs: LegGeometry


def prepare(logs: Sequence[Log], robot: Mounted | None, inputs: tuple[str, ...]) -> Dataset:
    """The logs as training takes them.

    Raises ObserverError where one is too short, lacks an input, or where they disagree on robot,
    mounting or joints; LogError where one has no reference.
    """
    robot = _common_robot(logs, robot)
    seen = [samples(log, inputs) for log in logs]
    labels = [body_velocity(log, sample.rows) for log, sample in zip(logs, seen, strict=True)]
    for log, (_, measured) in zip(logs, labels, strict=True):
        if len(measured) < WINDOW or measured.sum() < WINDOW // 2:
            raise ObserverError(
                f"{log.name}: {len(measured) / RATE:.1f} s of walk, {measured.sum() / RATE:.1f} s "
                f"of it with a reference; training takes {WINDOW / RATE:g} s at least"
            )
    legs = leg_geometry(robot, logs[0].joints) if "feet" in inputs else {}
    known = Kinematics.of(legs, robot) if legs else None
    shown = [observer_inputs(inputs, known, sample.x) for sample in seen]
    x_mean, x_scale = _scaling(shown)
    _, y_scale = _scaling([v_I[ok & ~held_out(len(ok))] for v_I, ok in labels])
    # Not centred: the zero state then answers about zero, and a log starts at rest.
    y_mean = np.zeros(3)
    walks = []
    for x, (v_I, measured) in zip(shown, labels, strict=True):
        held = held_out(len(measured)) & measured
        walks.append(
            Walk(
                torch.from_numpy(((x - x_mean) / x_scale).astype(np.float32)),
                torch.from_numpy(((v_I - y_mean) / y_scale).astype(np.float32)),
                torch.from_numpy(measured & ~held),
                torch.from_numpy(held),
            )
        )
    if not any(walk.held.any() for walk in walks):
        raise ObserverError("train: the reference is missing wherever the score would be taken")
    return Dataset(tuple(walks), x_mean, x_scale, y_mean, y_scale, robot, seen[0].causal_dq, legs)


def held_out(steps: int) -> np.ndarray:
    """Which of a log's steps (M,) are held out: one second in each ten, from the fifth on.

    Short blocks all along the log withhold no manoeuvre whole (two seconds in sixteen cost half of
    the forward accuracy elsewhere); a second is two strides, more than the neighbours of what was
    learnt, and the score on it came out as that on walks not seen.
    """
    return np.arange(steps) % 1000 // 100 == 5


def draw(
    walks: Sequence[Walk], batch: int, unsettled: int, rng: np.random.Generator
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Random windows: x (WINDOW, B, C), y (WINDOW, B, 3), learn (WINDOW, B).

    Cut out of a walk, a window starts from a past that no observer in use ever has: its first
    `unsettled` rows do not teach.
    """
    starts = np.array([len(walk.x) - WINDOW + 1 for walk in walks])
    chosen = rng.choice(len(walks), size=batch, p=starts / starts.sum())
    windows = []
    for i in chosen:
        first = 0 if rng.random() < BEGINNINGS else int(rng.integers(starts[i]))
        windows.append((walks[i], slice(first, first + WINDOW)))
    x = torch.stack([walk.x[window] for walk, window in windows], 1)
    y = torch.stack([walk.y[window] for walk, window in windows], 1)
    learn = torch.stack([walk.learn[window] for walk, window in windows], 1)
    cut = torch.tensor([window.start > 0 for _, window in windows])
    learn[:unsettled, cut] = False
    return x, y, learn


def _scaling(parts: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard deviation of each channel; a channel that never moves keeps unit scale."""
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
