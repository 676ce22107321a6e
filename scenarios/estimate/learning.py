"""Train both observers on some walks, and calibrate bounds for both."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from surefoot.models.calibration.calibrate import calibrate
from surefoot.models.observer.settings import TRAIN_DEFAULT, TrainSettings
from surefoot.models.observer.training import train
from surefoot.models.registry import LOSSES
from surefoot.scenarios.estimate.contract import Learnt
from surefoot.scenarios.estimate.inputs import learnt_from
from surefoot.scenarios.stages import processes, submitted
from surefoot.sim.log import Log


def learn(
    training: Iterable[Log],
    calibration: Log | Iterable[Log],
    out: Path,
    settings: TrainSettings = TRAIN_DEFAULT,
    force: bool = False,
    held_out: Sequence[Log] = (),
) -> Learnt:
    """Train with each loss in parallel, one process each, calibrate, and store all four in `out`.

    Args:
        training: logs to train on.
        calibration: log or logs for the bounds.
        out: folder for observers and bounds.
        settings: of the training, apart from the loss.
        force: whether files may be replaced.
        held_out: logs by which the training stops.
    """
    with processes(len(LOSSES)) as pool:
        assert pool is not None
        tasks = [
            (train, training, None, replace(settings, loss=loss), True, None, held_out)
            for loss in LOSSES
        ]
        observers = tuple(job.result() for job in [submitted(pool, task) for task in tasks])
    bounds = []
    for observer in observers:
        observer.save(out / f"observer_{observer.loss}.safetensors", force)
        bounds.append(calibrate(observer, calibration))
        bounds[-1].save(out / f"bounds_{observer.loss}.json", force)
    return Learnt(observers, tuple(bounds))


def learnt_in(out: Path) -> Learnt:
    """Load what `learn` stored in a folder."""
    return learnt_from(
        [out / f"observer_{loss}.safetensors" for loss in LOSSES],
        [out / f"bounds_{loss}.json" for loss in LOSSES],
    )
