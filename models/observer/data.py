"""Training data of a network: scaled logs, validation rows, random windows."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np
import torch

from surefoot.models.observer.observer import (
    Observer,
    ObserverError,
    TrainingLog,
    check_robot,
    log_digest,
    observer_inputs,
)
from surefoot.models.observer.odometry import (
    Kinematics,
    LegGeometry,
    Mounted,
    leg_geometry,
    same_mounting,
)
from surefoot.models.observer.samples import RATE, body_velocity, observer_samples
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot

WINDOW = 200
"""Length of a window in steps of 10 ms. Four strides are enough to learn what the state must keep,
and take a fifth of the time of the paper's 1000.
"""
SHORTEST, SHORTEST_TO_TUNE = 1000, 500
"""Shortest walk to train on, and to tune an observer on, in steps of 10 ms."""
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
    about: tuple[TrainingLog, ...]
    x_mean: np.ndarray
    x_scale: np.ndarray
    y_scale: np.ndarray
    robot: Mounted
    joints: tuple[str, ...]
    causal_dq: bool
    legs: LegGeometry


def prepare(
    logs: Iterable[Log],
    robot: Mounted | None,
    inputs: tuple[str, ...],
    held_out: Sequence[Log] = (),
    start: Observer | None = None,
) -> Dataset:
    """Prepare logs for training, keeping one at a time in memory.

    Raises ObserverError where one is too short or lacks an input, or where they disagree on robot,
    mounting or joints, with each other or with `start`; LogError where one has no reference.

    Args:
        logs: to train on.
        robot: theirs, by default Robot.for_log.
        inputs: groups of surefoot.models.observer.observer.INPUTS.
        held_out: logs for validation; without any, parts of `logs` are (`validation_rows`).
        start: observer whose scales are kept; its IMU may be at another place.
    """
    first, parts, about = None, [], []
    least, what = (SHORTEST, "training") if start is None else (SHORTEST_TO_TUNE, "tuning")
    causal_dq, kinematics, legs = False, None, {}
    for log, held in chain(((log, False) for log in logs), ((log, True) for log in held_out)):
        declared = Robot.for_log(log) if robot is None else robot
        if first is None:
            first = declared, log.joints, log.name
            legs = leg_geometry(declared, log.joints) if "feet" in inputs else {}
            kinematics = Kinematics.of(legs, declared) if legs else None
            if start is not None:
                check_robot(start, declared, log.joints, f"{log.name}: ")
                if not np.allclose(start.R_BI, declared.R_BI, atol=1e-4):
                    raise ObserverError(f"{log.name}: its IMU is turned against the observer's")
        model, joints, name = first
        if declared.name != model.name:
            raise ObserverError(f"{log.name}: is of {declared.name}, {name} of {model.name}")
        if not same_mounting(declared, model):
            raise ObserverError(f"{log.name}: its IMU is mounted elsewhere than {name}'s")
        if log.joints != joints:
            raise ObserverError(f"{log.name}: its joints differ from {name}'s")
        seen = observer_samples(log, inputs)
        causal_dq |= seen.causal_dq
        v_I, measured = body_velocity(log, seen.rows)
        if len(measured) < least or measured.sum() < least // 2:
            raise ObserverError(
                f"{log.name}: {len(measured) / RATE:.1f} s of walk, {measured.sum() / RATE:.1f} s "
                f"of it with a reference; {what} takes {least / RATE:g} s at least"
            )
        apart = np.full(len(measured), held) if held_out else validation_rows(len(measured))
        x = observer_inputs(inputs, kinematics, seen.x)
        parts.append((x, v_I, measured & ~apart, measured & apart))
        about.append(TrainingLog(log.name, log_digest(log)))
    if first is None or not any(train.any() for _, _, train, _ in parts):
        raise ObserverError("train: no log given")
    if not any(validation.any() for _, _, _, validation in parts):
        raise ObserverError("train: the reference is missing in all validation blocks")
    if start is None:
        x_mean, x_scale = _scaling([x for x, _, _, _ in parts])
        _, y_scale = _scaling([v_I[train] for _, v_I, train, _ in parts])
    else:
        x_mean, x_scale, y_scale = start.input_mean, start.input_scale, start.output_scale
    scaled = tuple(
        ScaledLog(
            torch.from_numpy(((x - x_mean) / x_scale).astype(np.float32)),
            torch.from_numpy((v_I / y_scale).astype(np.float32)),
            torch.from_numpy(train),
            torch.from_numpy(validation),
        )
        for x, v_I, train, validation in parts
    )
    robot, joints, _ = first
    names = tuple(about)
    return Dataset(scaled, names, x_mean, x_scale, y_scale, robot, joints, causal_dq, legs)


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
