"""Training the velocity observer (paper, "Supervised Training").

Windows of 1 000 steps at 10 ms, drawn at random and overlapping, each from the zero state. The
labels of held-out blocks take no part in the loss; on them the network is scored as it will be
used, its state running through the whole log, and the best weights so scored are kept.
"""

from __future__ import annotations

import copy
import json
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
import torch
from tqdm import tqdm

from surefoot.models.observer.data import Dataset, Walk, draw, prepare
from surefoot.models.observer.decimate import RATE
from surefoot.models.observer.imu_mounting import Mounted
from surefoot.models.observer.network import OUTPUTS, Network, loss_of
from surefoot.models.observer.observer import (
    Observer,
    ObserverError,
    TrainingLog,
    check_inputs,
    check_loss,
    check_model,
    log_digest,
)
from surefoot.models.observer.training_state import State, task_digest
from surefoot.models.registry import ARCHITECTURES
from surefoot.sim.common.errors import check_seed
from surefoot.sim.log import Log

WARM_UP = 25
"""Steps, of windows that begin inside a walk, that a recurrent network is not taught by."""
MEAN_FIRST = 0.4
"""Share of the steps in which a Gaussian's mean is fitted alone, by mse. A likelihood from the
start explains the smaller motions as noise: the vertical error came out twice as large."""


@dataclass(frozen=True)
class Schedule:
    """How long and how fast to train: see DEFAULT for what was found to do.

    steps of Adam, each on `batch` windows, its rate rising over the first twentieth to `rate` (the
    architecture's own where None) and falling to zero along a cosine; validation every `every`
    steps, and an end after `patience` of them without a better one.
    """

    steps: int = 1200
    batch: int = 4
    rate: float | None = None
    every: int = 25
    patience: int = 20


DEFAULT = Schedule()
Progress = Callable[[int, int, np.ndarray], None]


def train(
    logs: Log | Sequence[Log],
    robot: Mounted | None = None,
    inputs: tuple[str, ...] | str = ("q", "dq", "tau"),
    loss: str = "mse",
    seed: int = 0,
    progress: bool | Progress = False,
    schedule: Schedule = DEFAULT,
    model: str = "gru",
    partial: Path | None = None,
) -> Observer:
    """An observer of `logs`' robot from `inputs`; the same seed and logs give the same one.

    `model` is one of surefoot.models.registry.ARCHITECTURES. `progress` True draws a bar with the
    held-out RMSE; a
    function is called with (step, steps, rmse (3,) in m/s) after each validation. `partial` is a
    file for the state after each of them: a training that was killed goes on from there, to the
    same bits; whoever saves the observer deletes it. One thread is used, whatever the machine has:
    more would sum in another order. Raises ObserverError where a log is too short, lacks an input,
    or where the logs disagree on robot, mounting or joints; LogError where one has no reference.
    """
    logs = [logs] if isinstance(logs, Log) else list(logs)
    check_seed(seed)
    inputs, loss, model = check_inputs(inputs), check_loss(loss), check_model(model)
    if not logs:
        raise ObserverError("train: no log given")
    lessons = prepare(logs, robot, inputs)
    with _one_thread():
        fitted = _fit(model, loss, lessons, seed, schedule, progress, partial)
        network = fitted.network
        network.load_state_dict(fitted.best)
        errors = _errors(network, lessons)
    return Observer(
        model=model,
        width=ARCHITECTURES[model].width,
        weights=network.state_dict(),
        inputs=inputs,
        joints=logs[0].joints,
        input_mean=lessons.x_mean,
        input_scale=lessons.x_scale,
        output_mean=lessons.y_mean,
        output_scale=lessons.y_scale,
        robot=lessons.robot.name,
        p_BI=np.array(lessons.robot.p_BI, dtype=float),
        R_BI=np.array(lessons.robot.R_BI, dtype=float),
        loss=loss,
        logs=tuple(TrainingLog(log.name, log_digest(log)) for log in logs),
        seed=seed,
        rate=RATE,
        rmse=fitted.rmse,
        errors=errors,
        causal_dq=lessons.causal_dq,
        legs=lessons.legs,
    )


@dataclass
class _Training:
    """A training under way: the fields are those of State, alive."""

    network: Network
    optimiser: torch.optim.Adam
    rng: np.random.Generator
    best: dict[str, torch.Tensor]
    step: int = 0
    score: float = np.inf
    rmse: np.ndarray = field(default_factory=lambda: np.full(3, np.nan))
    since: int = 0

    def state(self) -> State:
        return State(
            step=self.step,
            network=self.network.state_dict(),
            optimiser=self.optimiser.state_dict(),
            rng=json.dumps(self.rng.bit_generator.state),
            best=self.best,
            score=self.score,
            rmse=self.rmse.tolist(),
            since=self.since,
        )

    def restore(self, state: State) -> None:
        self.network.load_state_dict(state.network)
        self.optimiser.load_state_dict(state.optimiser)
        self.rng.bit_generator.state = json.loads(state.rng)
        self.best, self.step, self.score = state.best, state.step, state.score
        self.rmse, self.since = np.array(state.rmse), state.since

    def judge(self, score: float, rmse: np.ndarray) -> None:
        """Keep the weights if no earlier ones scored better."""
        self.since += 1
        if score < self.score:
            self.best = copy.deepcopy(self.network.state_dict())
            self.score, self.rmse, self.since = score, rmse, 0


def _fit(
    model: str,
    loss: str,
    lessons: Dataset,
    seed: int,
    schedule: Schedule,
    progress: bool | Progress,
    partial: Path | None,
) -> _Training:
    architecture, walks = ARCHITECTURES[model], lessons.walks
    rate = schedule.rate or architecture.rate
    unsettled = max(WARM_UP, (architecture.receptive_field or 0) - 1)
    task = task_digest(
        walks, model=model, loss=loss, seed=seed, schedule=asdict(schedule), rate=rate
    )
    now = _begin(model, loss, lessons, seed, rate)
    if partial and (state := State.load(partial, task)):
        now.restore(state)
    bar = tqdm(
        total=schedule.steps, initial=now.step, desc=f"train {model} {loss}", unit="step",
        disable=progress is not True,
    )  # fmt: skip

    def stage(step: int) -> str:
        return "mse" if step <= MEAN_FIRST * schedule.steps else loss

    with bar:
        while now.step < schedule.steps:
            if now.since >= schedule.patience and stage(now.step) == loss:
                break
            now.step += 1
            kind = stage(now.step)
            if kind != stage(now.step - 1):
                now.score, now.since = np.inf, 0
            for group in now.optimiser.param_groups:
                group["lr"] = rate * _warm_cosine(now.step / schedule.steps)
            x, y, learn = draw(walks, schedule.batch, unsettled, now.rng)
            now.optimiser.zero_grad()
            # A sum, not a mean over nothing, where a batch has no measured reference at all.
            losses = loss_of(kind, now.network(x), y)[learn]
            (losses.sum() / max(int(learn.sum()), 1)).backward()
            torch.nn.utils.clip_grad_norm_(now.network.parameters(), 1.0)
            now.optimiser.step()
            bar.update()
            if now.step % schedule.every and now.step != schedule.steps:
                continue
            score, rmse = _score(now.network, walks, kind, lessons.y_scale)
            now.judge(score, rmse)
            if partial:
                now.state().save(partial, task)
            bar.set_postfix_str("held-out RMSE " + " ".join(f"{e:.3f}" for e in rmse) + " m/s")
            if callable(progress):
                progress(now.step, schedule.steps, rmse)
    if not np.isfinite(now.score):
        raise ObserverError("train: the loss did not stay finite; are the inputs of one unit?")
    return now


def _begin(model: str, loss: str, lessons: Dataset, seed: int, rate: float) -> _Training:
    rng = np.random.default_rng(seed)
    inputs = len(lessons.x_mean)
    width = ARCHITECTURES[model].width
    legs = len(lessons.legs["radius"]) if lessons.legs else 0
    network = Network(model, inputs, OUTPUTS[loss], width, legs)
    network.initialise(torch.Generator().manual_seed(int(rng.integers(2**63))))
    if network.odometry is not None:
        network.odometry.set_units(lessons.x_mean, lessons.x_scale, lessons.y_scale)
    optimiser = torch.optim.Adam(network.parameters(), lr=rate)
    return _Training(network, optimiser, rng, copy.deepcopy(network.state_dict()))


@torch.no_grad()
def _score(
    network: Network, walks: Sequence[Walk], loss: str, y_scale: np.ndarray
) -> tuple[float, np.ndarray]:
    """Loss of the held-out rows, and their RMSE (3,) in m/s."""
    losses, squares = [], []
    for walk in walks:
        outputs = network(walk.x[:, None])[:, 0][walk.held]
        losses.append(loss_of(loss, outputs, walk.y[walk.held]))
        squares.append((outputs[:, :3] - walk.y[walk.held]).square())
    rmse = torch.cat(squares).mean(0).sqrt().double().numpy() * y_scale
    return float(torch.cat(losses).mean()), rmse


@torch.no_grad()
def _errors(network: Network, lessons: Dataset) -> np.ndarray:
    """Errors (M, 3), m/s, at all measured rows of all walks."""
    errors = []
    for walk in lessons.walks:
        measured = walk.learn | walk.held
        outputs = network(walk.x[:, None])[:, 0, :3]
        errors.append((outputs - walk.y)[measured].double().numpy() * lessons.y_scale)
    return np.concatenate(errors)


def _warm_cosine(done: float) -> float:
    return min(1.0, done / 0.05) * 0.5 * (1 + math.cos(math.pi * done))


@contextmanager
def _one_thread() -> Iterator[None]:
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)
