"""Training the velocity observer (paper, "Supervised Training").

Windows of 1 000 steps at 10 ms, drawn at random and overlapping, each from the zero state. The
labels of held-out blocks take no part in the loss; on them the network is scored as it will be
used, its state running through the whole log, and the best weights so scored are kept.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import torch
from tqdm import tqdm

from models.decimate import RATE
from models.mounting import Mounted, same_mounting
from models.network import OUTPUTS, Network, loss_of
from models.observer import (
    Observer,
    ObserverError,
    TrainingLog,
    check_inputs,
    check_loss,
    log_digest,
)
from models.samples import body_velocity, samples
from sim.errors import check_seed
from sim.log import Log
from sim.robot import Robot

HIDDEN = 64
WINDOW = 1000
"""Steps of 10 ms, as in the paper."""
BEGINNINGS = 1 / 8
"""Share of windows that begin where their log does. An observer starts there, from the zero state
and mostly at rest; left to chance, one window in thousands would show it, and its first predictions
are off by half a metre a second."""
WARM_UP = 25
"""Steps of other windows that are not learnt from."""
MEAN_FIRST = 0.4
"""Share of the steps in which a Gaussian's mean is fitted alone, by mse. A likelihood from the
start explains the smaller motions as noise: the vertical error came out twice as large."""


@dataclass(frozen=True)
class Schedule:
    """How long and how fast to train: see DEFAULT for what was found to do.

    steps of Adam, each on `batch` windows, its rate rising over the first twentieth to `rate` and
    falling to zero along a cosine; validation every `every` steps, and an end after `patience`
    of them without a better one.
    """

    steps: int = 1200
    batch: int = 4
    rate: float = 1e-2
    every: int = 25
    patience: int = 20


DEFAULT = Schedule()


@dataclass(frozen=True)
class _Walk:
    """One log, scaled: x (M, C), y (M, 3), and which rows are learnt from or held out (M,)."""

    x: torch.Tensor
    y: torch.Tensor
    learn: torch.Tensor
    held: torch.Tensor


def train(
    logs: Log | Sequence[Log],
    robot: Mounted | None = None,
    inputs: tuple[str, ...] | str = ("q", "dq", "tau"),
    loss: str = "mse",
    seed: int = 0,
    progress: bool | Callable[[int, int, np.ndarray], None] = False,
    schedule: Schedule = DEFAULT,
) -> Observer:
    """An observer of `logs`' robot from `inputs`; the same seed and logs give the same one.

    `progress` True draws a bar with the held-out RMSE; a function is called with (step, steps,
    rmse (3,) in m/s) after each validation. One thread is used, whatever the machine has: more
    would sum in another order. Raises ObserverError where a log is too short, lacks an input, or
    where the logs disagree on robot, mounting or joints; LogError where one has no reference.
    """
    logs = [logs] if isinstance(logs, Log) else list(logs)
    check_seed(seed)
    inputs, loss = check_inputs(inputs), check_loss(loss)
    if not logs:
        raise ObserverError("train: no log given")
    robot = _common_robot(logs, robot)
    seen = [samples(log, inputs) for log in logs]
    labels = [body_velocity(log, sample.rows) for log, sample in zip(logs, seen, strict=True)]
    for log, (_, measured) in zip(logs, labels, strict=True):
        if len(measured) < WINDOW or measured.sum() < WINDOW // 2:
            raise ObserverError(
                f"{log.name}: {len(measured) / RATE:.1f} s of walk, {measured.sum() / RATE:.1f} s "
                f"of it with a reference; training takes {WINDOW / RATE:g} s at least"
            )
    x_mean, x_scale = _scaling([sample.x for sample in seen])
    _, y_scale = _scaling([v_I[ok & ~held_out(len(ok))] for v_I, ok in labels])
    # Not centred: the zero state then answers about zero, and a log starts at rest.
    y_mean = np.zeros(3)
    walks = []
    for sample, (v_I, measured) in zip(seen, labels, strict=True):
        held = held_out(len(measured)) & measured
        walks.append(
            _Walk(
                torch.from_numpy(((sample.x - x_mean) / x_scale).astype(np.float32)),
                torch.from_numpy(((v_I - y_mean) / y_scale).astype(np.float32)),
                torch.from_numpy(measured & ~held),
                torch.from_numpy(held),
            )
        )
    if not any(walk.held.any() for walk in walks):
        raise ObserverError("train: the reference is missing wherever the score would be taken")
    with _one_thread():
        weights, rmse = _fit(walks, loss, y_scale, seed, schedule, progress)
    return Observer(
        weights=weights,
        inputs=inputs,
        joints=logs[0].joints,
        input_mean=x_mean,
        input_scale=x_scale,
        output_mean=y_mean,
        output_scale=y_scale,
        robot=robot.name,
        p_BI=np.array(robot.p_BI, dtype=float),
        R_BI=np.array(robot.R_BI, dtype=float),
        loss=loss,
        logs=tuple(TrainingLog(log.name, log_digest(log)) for log in logs),
        seed=seed,
        rate=RATE,
        hidden=HIDDEN,
        rmse=rmse,
        causal_dq=seen[0].causal_dq,
    )


def held_out(steps: int) -> np.ndarray:
    """Which of a log's steps (M,) are held out: one second in each ten, from the fifth on.

    Short blocks all along the log withhold no manoeuvre whole (two seconds in sixteen cost half of
    the forward accuracy elsewhere); a second is two strides, more than the neighbours of what was
    learnt, and the score on it came out as that on walks not seen.
    """
    return np.arange(steps) % 1000 // 100 == 5


def _fit(
    walks: list[_Walk],
    loss: str,
    y_scale: np.ndarray,
    seed: int,
    schedule: Schedule,
    progress: bool | Callable[[int, int, np.ndarray], None],
) -> tuple[dict[str, torch.Tensor], np.ndarray]:
    rng = np.random.default_rng(seed)
    network = Network(walks[0].x.shape[1], OUTPUTS[loss], HIDDEN)
    network.initialise(torch.Generator().manual_seed(int(rng.integers(2**63))))
    optimiser = torch.optim.Adam(network.parameters(), lr=schedule.rate)
    best, best_score, best_rmse, since = network.state_dict(), np.inf, np.full(3, np.nan), 0
    stage = "mse"
    bar = tqdm(
        total=schedule.steps, desc=f"train {loss}", unit="step", disable=progress is not True
    )
    with bar:
        for step in range(1, schedule.steps + 1):
            if stage != loss and step > MEAN_FIRST * schedule.steps:
                stage, best_score, since = loss, np.inf, 0
            for group in optimiser.param_groups:
                group["lr"] = schedule.rate * _warm_cosine(step / schedule.steps)
            x, y, learn = _draw(walks, schedule.batch, rng)
            optimiser.zero_grad()
            outputs, _ = network(x)
            # A sum, not a mean over nothing, where a batch has no measured reference at all.
            (loss_of(stage, outputs, y)[learn].sum() / max(int(learn.sum()), 1)).backward()
            torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
            optimiser.step()
            bar.update()
            if step % schedule.every and step != schedule.steps:
                continue
            score, rmse = _score(network, walks, stage, y_scale)
            since += 1
            if score < best_score:
                best, best_score, best_rmse = copy.deepcopy(network.state_dict()), score, rmse
                since = 0
            bar.set_postfix_str("held-out RMSE " + " ".join(f"{e:.3f}" for e in rmse) + " m/s")
            if callable(progress):
                progress(step, schedule.steps, rmse)
            if since >= schedule.patience and stage == loss:
                break
    if not np.isfinite(best_score):
        raise ObserverError("train: the loss did not stay finite; are the inputs of one unit?")
    return best, best_rmse


def _draw(
    walks: list[_Walk], batch: int, rng: np.random.Generator
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Random windows: x (WINDOW, B, C), y (WINDOW, B, 3), learn (WINDOW, B)."""
    starts = np.array([len(walk.x) - WINDOW + 1 for walk in walks])
    chosen = rng.choice(len(walks), size=batch, p=starts / starts.sum())
    windows = []
    for i in chosen:
        first = 0 if rng.random() < BEGINNINGS else int(rng.integers(starts[i]))
        windows.append((walks[i], slice(first, first + WINDOW)))
    x = torch.stack([walk.x[window] for walk, window in windows], 1)
    y = torch.stack([walk.y[window] for walk, window in windows], 1)
    learn = torch.stack([walk.learn[window] for walk, window in windows], 1)
    # Cut out of a walk, a window starts from a state that no observer in use is ever in.
    cut = torch.tensor([window.start > 0 for _, window in windows])
    learn[:WARM_UP, cut] = False
    return x, y, learn


@torch.no_grad()
def _score(
    network: Network, walks: list[_Walk], loss: str, y_scale: np.ndarray
) -> tuple[float, np.ndarray]:
    """Loss of the held-out rows, and their RMSE (3,) in m/s."""
    losses, squares = [], []
    for walk in walks:
        outputs = network(walk.x[:, None])[0][:, 0][walk.held]
        losses.append(loss_of(loss, outputs, walk.y[walk.held]))
        squares.append((outputs[:, :3] - walk.y[walk.held]).square())
    rmse = torch.cat(squares).mean(0).sqrt().double().numpy() * y_scale
    return float(torch.cat(losses).mean()), rmse


def _warm_cosine(done: float) -> float:
    return min(1.0, done / 0.05) * 0.5 * (1 + np.cos(np.pi * done))


def _scaling(parts: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard deviation of each channel; a channel that never moves keeps unit scale."""
    values = np.concatenate(parts)
    spread = values.std(axis=0)
    return values.mean(axis=0), np.where(spread > 1e-6, spread, 1.0)


def _common_robot(logs: list[Log], robot: Mounted | None) -> Mounted:
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


@contextmanager
def _one_thread() -> Iterator[None]:
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)
