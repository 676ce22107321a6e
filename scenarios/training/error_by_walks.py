"""Error of observers on walks that nothing was trained on, by the number of walks to train on."""

from collections.abc import Sequence
from itertools import takewhile
from pathlib import Path

import numpy as np

from surefoot.models.observer.observer import Observer
from surefoot.models.observer.predict import prediction_errors
from surefoot.models.observer.settings import TrainSettings
from surefoot.models.observer.training import train
from surefoot.scenarios.reporting.html import Picture, Section, write_report
from surefoot.scenarios.reporting.observer_errors import error_by_number
from surefoot.scenarios.training.kept_walks import KeptLogs
from surefoot.sim.common.files import whole_folder
from surefoot.sim.log import Log

CAPTION = (
    "Root mean square error of the velocity over all test walks, each of equal weight, against the "
    "number of walks to train on."
)


def write_error_by_walks(
    folder: Path,
    observer: Observer,
    walks: KeptLogs,
    held_out: Sequence[Log],
    tests: Sequence[Log],
    settings: TrainSettings,
    force: bool = False,
) -> None:
    """Train on the first 1, 4, 16, ... walks too, and write report.html with table and figure.

    Args:
        folder: to write.
        observer: trained on all `walks`.
        walks: to train on.
        held_out: to stop by.
        tests: to evaluate on.
        settings: of each training.
        force: whether the folder may be replaced.
    """
    errors = {}
    for count in takewhile(lambda n: n < len(walks), (4**k for k in range(10))):
        fewer = train(walks.first(count), None, settings, True, held_out=held_out)
        errors[count] = test_rmse(fewer, tests)
    errors[len(walks)] = test_rmse(observer, tests)
    rows = [
        {"walks": count, "RMSE [m/s]": rmse, "unseen walks": len(tests)}
        for count, rmse in errors.items()
    ]
    inputs = ",".join(observer.inputs)
    figure = Picture(error_by_number({inputs: errors}), CAPTION, "error_by_walks.png")
    with whole_folder(folder, force) as out:
        section = Section(f"Observers of {inputs}", CAPTION, rows, (figure,))
        title = f"Error of {observer.robot}'s observers by the number of walks"
        write_report(out / "report.html", title, [section])


def test_rmse(observer: Observer, tests: Sequence[Log]) -> float:
    """Root mean square of the error's norm [m/s], in which each walk has equal weight."""
    squares = [(prediction_errors(observer, log)[1] ** 2).sum(axis=1).mean() for log in tests]
    return float(np.sqrt(np.mean(squares)))
