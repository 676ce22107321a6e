"""Training of the velocity observer (paper, "Supervised Training").

Random, overlapping windows, each from the zero state. Labels of held-out logs, or else of
validation blocks, are not part of the loss; on them the network is scored as it will be used, with
its state running through the whole log, and the weights with the best score are kept. The state of
a training is stored on disk, so that an interrupted one continues with bit-identical results.
"""

import hashlib
import json
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import torch

from surefoot.models.observer.data import Dataset, ScaledLog, draw, prepare
from surefoot.models.observer.inference import LOSS_OUTPUTS
from surefoot.models.observer.network import Network, loss_of
from surefoot.models.observer.novelty import TrainingStates, blocks_of, training_states
from surefoot.models.observer.observer import (
    WIDEST,
    Observer,
    ObserverError,
    check_inputs,
    check_network,
)
from surefoot.models.observer.odometry import Mounted
from surefoot.models.observer.samples import RATE
from surefoot.models.observer.settings import TRAIN_DEFAULT, TrainSettings
from surefoot.models.registry import ARCHITECTURES
from surefoot.sim.common.errors import check_seed
from surefoot.sim.common.files import check_plain, kept_file, say_made_again
from surefoot.sim.common.progress import bar as drawn_bar
from surefoot.sim.log import Log

CPU = torch.device("cpu")


def torch_device(name: str) -> torch.device:
    """Torch's device of that name. Raises ObserverError where torch cannot use it here."""
    try:
        device = torch.device(name)
        torch.zeros(1, device=device).item()
    except Exception as error:
        # torch raises many types here, depending on device, build and driver.
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise ObserverError(f"device {name}: torch cannot use it here ({reason[:200]})") from None
    return device


WARM_UP = 25
"""Steps that a recurrent network is not trained on, in windows that begin inside a log."""
MEAN_FIRST = 0.4
"""Share of the steps in which only a Gaussian's mean is fitted, by mse. With the likelihood from
the start, small motions are attributed to the covariance: the vertical error became twice as large.
"""
TUNING = 0.1
"""Share of an architecture's learning rate with which an observer is tuned on further logs."""
TUNED = 0.5
"""Share of the way from the weights of `start` to those fitted that the result has. Half way
generalises better than either end (Wortsman et al., Robust fine-tuning of zero-shot models, CVPR
2022); a few seconds of a walk are fitted too well otherwise.
"""
BETAS = 0.9, 0.99
"""Adam's decay of the gradient's moments. A longer memory of the second, 0.999 by default, takes in
gradients of the first steps, which are much larger.
"""
MOST_ERRORS = 20_000
"""Errors that an observer keeps: enough for their distribution, in half a megabyte."""
SCHEDULE = ("steps", "batch", "rate", "every", "patience")
"""Settings of the course of a training."""
TRAINING_FORMAT = b"surefoot training state\n"
"""First bytes of a file that has one."""


TrainingProgress = Callable[[int, int, np.ndarray], None]


def train(
    logs: Log | Iterable[Log],
    robot: Mounted | None = None,
    settings: TrainSettings = TRAIN_DEFAULT,
    progress: bool | TrainingProgress = False,
    partial: Path | None = None,
    held_out: Sequence[Log] = (),
    start: Observer | None = None,
) -> Observer:
    """Train an observer for the robot of `logs`; deterministic for the same seed and logs.

    A single thread is used on any machine, since more threads, like other devices, would sum in
    another order. The observer is validated and stored on the CPU, where it will run. Raises
    ObserverError where a log is too short or lacks an input, where the logs disagree on robot,
    mounting or joints, or where torch has no such device; LogError where one has no reference.

    Args:
        logs: to train on; each is read once, so that they may come one at a time.
        robot: theirs, by default Robot.for_log.
        settings: inputs, loss, network and course of the training.
        progress: True shows a bar with the validation RMSE; a function is called with (step, steps,
            rmse (3,) in m/s) after each validation.
        partial: file for the state after each validation, from which an interrupted training
            continues. The caller deletes it once the observer is saved.
        held_out: walks whose error decides when to stop; by default one second in ten of `logs`.
        start: observer to be tuned, such as one from simulated walks on ten seconds of a real one;
            its network, inputs and loss are kept, and its weights go half of the way (TUNED).
    """
    torch_device(settings.device)
    check_seed(settings.seed)
    if start is not None:
        settings = replace(
            settings, model=start.model, width=start.width, inputs=start.inputs, loss=start.loss
        )
    inputs = check_inputs(settings.inputs)
    check_network(settings.model, settings.loss)
    units: int = ARCHITECTURES[settings.model].width if settings.width is None else settings.width
    if not 0 < units <= WIDEST:
        raise ObserverError(f"train: width must be within 1 and {WIDEST}, is {units}")
    dataset = prepare([logs] if isinstance(logs, Log) else logs, robot, inputs, held_out, start)
    with _one_thread():
        fitted = _fit(dataset, replace(settings, width=units), progress, partial, start)
        network, weights, rmse = fitted.network, fitted.best, fitted.rmse
        network.to(CPU).load_state_dict(weights)
        if start is not None:
            weights = {
                name: torch.lerp(weight, weights[name], TUNED)
                for name, weight in start.network.state_dict().items()
            }
            network.load_state_dict(weights)
            scored = [log for log in dataset.logs if log.validation.any()]
            _, rmse = _score(network, scored, settings.loss, dataset.y_scale)
        errors, states = _final(network, dataset)
    return Observer(
        model=settings.model,
        width=units,
        weights={name: weight.numpy() for name, weight in weights.items()},
        inputs=inputs,
        joints=dataset.joints,
        input_mean=dataset.x_mean,
        input_scale=dataset.x_scale,
        output_mean=np.zeros(3),
        output_scale=dataset.y_scale,
        robot=dataset.robot.name,
        p_BI=np.array(dataset.robot.p_BI, dtype=float),
        R_BI=np.array(dataset.robot.R_BI, dtype=float),
        loss=settings.loss,
        logs=(*(start.logs if start else ()), *dataset.about),
        seed=settings.seed,
        rate=RATE,
        rmse=rmse,
        errors=errors,
        causal_dq=dataset.causal_dq,
        legs=dataset.legs,
        training_states={} if start else states,
    )


def partial_path(observer: Path) -> Path:
    """Path of the training state of `observer`: beside it, with `.partial` appended."""
    return observer.with_name(observer.name + ".partial")


@dataclass
class Training:
    """State of a training after `step` steps: all that the next step depends on.

    Attributes:
        network: being trained.
        optimiser: its optimiser.
        rng: draws the windows.
        best: weights with the lowest `score` on the validation rows, on the CPU.
        step: number of steps done.
        score: of the best weights.
        rmse: of the best weights (3,) [m/s].
        since: validations since the best.
    """

    network: Network
    optimiser: torch.optim.Adam
    rng: np.random.Generator
    best: dict[str, torch.Tensor]
    step: int = 0
    score: float = np.inf
    rmse: np.ndarray = field(default_factory=lambda: np.full(3, np.nan))
    since: int = 0

    def save(self, path: Path, task: str) -> None:
        """Write the state, replacing an earlier one, whole or not at all, after its digest; `task`
        identifies the training.
        """
        values = vars(self) | {
            "task": task,
            "network": self.network.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "rng": json.dumps(self.rng.bit_generator.state),
            "rmse": self.rmse.tolist(),
        }
        stream = BytesIO()
        torch.save(values, stream)
        content = stream.getvalue()
        with kept_file(path) as temporary:
            temporary.write_bytes(TRAINING_FORMAT + hashlib.sha256(content).digest() + content)

    def restore(self, path: Path, task: str) -> bool:
        """Continue from the state at `path`; False where there is none, it is of another task or,
        with a note on stderr, its content has changed.

        Raises ObserverError where the file is something else, which is then left untouched.
        """
        check_plain(path)
        if not path.exists():
            return False
        form, _, rest = path.read_bytes().partition(TRAINING_FORMAT)
        digest, content = rest[:32], rest[32:]
        if form or not rest:
            raise ObserverError(
                f"{path}: not a training that was broken off; move it away, or delete it"
            )
        if digest != hashlib.sha256(content).digest():
            say_made_again(path)
            return False
        values: Any = torch.load(BytesIO(content), map_location="cpu", weights_only=True)
        if values["task"] != task:
            return False
        self.network.load_state_dict(values["network"])
        self.optimiser.load_state_dict(values["optimiser"])
        self.rng.bit_generator.state = json.loads(values["rng"])
        self.best, self.step, self.score = values["best"], values["step"], values["score"]
        self.rmse, self.since = np.array(values["rmse"]), values["since"]
        return True

    def judge(self, score: float, rmse: np.ndarray) -> None:
        """Keep the weights if they have the best score so far."""
        self.since += 1
        if score < self.score:
            self.best = _kept_weights(self.network)
            self.score, self.rmse, self.since = score, rmse, 0


def task_digest(logs: Sequence[ScaledLog], **settings: object) -> str:
    """SHA-256 of all that determines a training's outcome: data, settings and torch's version."""
    settings["torch"] = torch.__version__
    digest = hashlib.sha256(json.dumps(settings, sort_keys=True).encode())
    for log in logs:
        for tensor in (log.x, log.y, log.train, log.validation):
            digest.update(tensor.numpy().tobytes())
    return digest.hexdigest()


def _fit(
    dataset: Dataset,
    settings: TrainSettings,
    progress: bool | TrainingProgress,
    partial: Path | None,
    start: Observer | None,
) -> Training:
    """Train until the schedule ends.

    Args:
        dataset: to train on.
        settings: as of `train`, with a width.
        progress: as of `train`.
        partial: as of `train`.
        start: observer to be tuned; None to begin with drawn weights.
    """
    device = torch_device(settings.device)
    loss, model = settings.loss, settings.model
    architecture = ARCHITECTURES[model]
    rate = settings.rate or architecture.rate * (TUNING if start else 1.0)
    unsettled = max(WARM_UP, (architecture.receptive_field or 0) - 1)
    known = {name: getattr(settings, name) for name in ("model", "loss", "seed", "width")}
    known |= {"rate": rate, "schedule": {name: getattr(settings, name) for name in SCHEDULE}}
    if device.type != CPU.type:  # which sums in another order
        known["device"] = device.type
    if start is not None:
        known["start"] = start.hash
    task = task_digest(dataset.logs, **known)
    logs = [log.to(device) for log in dataset.logs]
    scored = [log for log in logs if log.validation.any()]
    trained = [log for log in logs if log.train.any()]
    now = _begin(dataset, settings, device, start)
    if partial:
        now.restore(partial, task)

    def stage(step: int) -> str:
        return "mse" if step <= MEAN_FIRST * settings.steps else loss

    if start is not None and now.step == 0:
        now.judge(*_score(now.network, scored, stage(0), dataset.y_scale))
    with drawn_bar(
        total=settings.steps,
        initial=now.step,
        desc=f"train {model} {loss}",
        unit="step",
        disable=progress is not True,
    ) as bar:
        while now.step < settings.steps:
            if now.since >= settings.patience and stage(now.step) == loss:
                break
            now.step += 1
            kind = stage(now.step)
            if kind != stage(now.step - 1):
                now.score, now.since = np.inf, 0
            for group in now.optimiser.param_groups:
                group["lr"] = rate * _warm_cosine(now.step / settings.steps)
            x, y, trains = draw(trained, settings.batch, unsettled, now.rng)
            now.optimiser.zero_grad()
            # A sum, since the mean over a batch without a measured reference would be undefined.
            losses = loss_of(kind, now.network(x), y)[trains]
            (losses.sum() / max(int(trains.sum()), 1)).backward()
            torch.nn.utils.clip_grad_norm_(now.network.parameters(), 1.0)
            now.optimiser.step()
            bar.update()
            if now.step % settings.every and now.step != settings.steps:
                continue
            score, rmse = _score(now.network, scored, kind, dataset.y_scale)
            now.judge(score, rmse)
            if partial:
                now.save(partial, task)
            said = " ".join(f"{e:.3f}" for e in rmse)
            bar.set_postfix_str(f"RMSE {said}", refresh=False)
            if callable(progress):
                progress(now.step, settings.steps, rmse)
    if not np.isfinite(now.score):
        raise ObserverError("train: the loss did not stay finite; are the inputs of one unit?")
    return now


def _begin(
    dataset: Dataset,
    settings: TrainSettings,
    device: torch.device,
    start: Observer | None = None,
) -> Training:
    """Initialise a training; the weights are drawn on the CPU, so they are the same for every
    device, or those of `start`. The settings have a width.
    """
    assert settings.width is not None
    rng = np.random.default_rng(settings.seed)
    inputs = len(dataset.x_mean)
    legs = len(dataset.legs["radius"]) if dataset.legs else 0
    network = Network(settings.model, inputs, LOSS_OUTPUTS[settings.loss], settings.width, legs)
    network.initialise(torch.Generator().manual_seed(int(rng.integers(2**63))))
    if network.odometry is not None:
        network.odometry.set_units(dataset.x_mean, dataset.x_scale, dataset.y_scale)
    if start is not None:
        network.load_state_dict(start.network.state_dict())
    best = _kept_weights(network)
    network.to(device)  # before Adam, which keeps its state where the weights are
    optimiser = torch.optim.Adam(network.parameters(), betas=BETAS)  # the schedule sets its rate
    return Training(network, optimiser, rng, best)


def _kept_weights(network: Network) -> dict[str, torch.Tensor]:
    """A copy of the current weights on the CPU."""
    return {name: w.detach().cpu().clone() for name, w in network.state_dict().items()}


@torch.no_grad()
def _score(
    network: Network, logs: Sequence[ScaledLog], loss: str, y_scale: np.ndarray
) -> tuple[float, np.ndarray]:
    """Loss of the validation rows, and their RMSE (3,) in m/s."""
    losses, squares = [], []
    for log in logs:
        outputs, target = network(log.x[:, None])[:, 0][log.validation], log.y[log.validation]
        losses.append(loss_of(loss, outputs, target))
        squares.append((outputs[:, :3] - target).square())
    rmse = torch.cat(squares).mean(0).sqrt().cpu().double().numpy() * y_scale
    return float(torch.cat(losses).mean()), rmse


@torch.no_grad()
def _final(network: Network, dataset: Dataset) -> tuple[np.ndarray, TrainingStates]:
    """Errors (M, 3), m/s, at measured rows of all logs, evenly spaced, and the states."""
    errors, blocks = [], []
    for log in dataset.logs:
        x, measured = log.x[:, None], log.train | log.validation
        features = network.features(x)
        outputs = network.outputs(x, features)[:, 0, :3]
        errors.append((outputs - log.y)[measured].double().numpy() * dataset.y_scale)
        blocks.append(blocks_of(features[:, 0].numpy()))
    every = -(-sum(map(len, errors)) // MOST_ERRORS)
    return np.concatenate(errors)[::every], training_states(blocks)


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
