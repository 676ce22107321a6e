"""Train both observers on some walks, and calibrate bounds for both."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from surefoot.models.calibration.bounds import Bounds
from surefoot.models.calibration.calibrate import calibrate
from surefoot.models.observer.observer import Observer
from surefoot.models.observer.training import DEFAULT_SCHEDULE, Schedule, train
from surefoot.models.registry import LOSSES
from surefoot.scenarios.estimate.run import Learnt
from surefoot.scenarios.stages import processes, submitted
from surefoot.sim.log import Log


@dataclass(frozen=True)
class Recipe:
    """How observers are trained, and their bounds calibrated.

    Attributes:
        inputs: columns of the observer, as for `train`.
        schedule: length and learning rate of the training.
        gamma: joint level of the bounds.
    """

    inputs: str = "q,dq,tau"
    schedule: Schedule = DEFAULT_SCHEDULE
    gamma: float = 0.8


def learn(
    training: Sequence[Log],
    calibration: Log,
    out: Path,
    seed: int,
    recipe: Recipe | None = None,
    force: bool = False,
) -> Learnt:
    """Train with each loss in parallel, one process each, calibrate, and store all four in `out`.

    Args:
        training: logs to train on.
        calibration: log for the bounds.
        out: folder for observers and bounds.
        seed: of weights and windows.
        recipe: how.
        force: whether files may be replaced.
    """
    recipe = recipe or Recipe()
    with processes(len(LOSSES)) as pool:
        assert pool is not None
        tasks = [(_train, list(training), loss, seed, recipe) for loss in LOSSES]
        observers = tuple(job.result() for job in [submitted(pool, task) for task in tasks])
    bounds = []
    for observer in observers:
        observer.save(out / f"observer_{observer.loss}.pt", force)
        bounds.append(calibrate(observer, calibration, recipe.gamma))
        bounds[-1].save(out / f"bounds_{observer.loss}.json", force)
    return Learnt(observers, tuple(bounds))


def learnt_in(out: Path) -> Learnt:
    """Load what `learn` stored in a folder."""
    return Learnt(
        tuple(Observer.load(out / f"observer_{loss}.pt") for loss in LOSSES),
        tuple(Bounds.load(out / f"bounds_{loss}.json") for loss in LOSSES),
    )


def _train(logs: list[Log], loss: str, seed: int, recipe: Recipe) -> Observer:
    """`train` with positional arguments, for another process."""
    return train(
        logs,
        inputs=recipe.inputs,
        loss=loss,
        seed=seed,
        progress=True,
        schedule=recipe.schedule,
    )
