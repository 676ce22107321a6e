"""Estimate the file of a log, piece by piece: a short log is one piece."""

import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from itertools import tee
from pathlib import Path
from typing import NamedTuple

import numpy as np

from surefoot.estimator.evaluation.health import Health, RunSummary, summary_of_run
from surefoot.estimator.evaluation.trajectory import (
    Trajectory,
    TrajectoryError,
    reference,
    trajectory_file,
)
from surefoot.estimator.metrics import METRICS_RATE, Metrics, evaluate, matched, relative_errors
from surefoot.scenarios.estimate import run
from surefoot.scenarios.estimate.advice import advice, needs_advice
from surefoot.scenarios.estimate.estimators import estimator_named
from surefoot.scenarios.estimate.inputs import learnt_from, not_plausible, notes_on, with_effects
from surefoot.scenarios.estimate.settings import read_settings
from surefoot.scenarios.settings import EstimateSettings
from surefoot.sim.common.errors import SurefootError, errors_in
from surefoot.sim.common.files import refuse_overwrite, whole_file
from surefoot.sim.log import Log, LogReader

LONG = 1800.0
"""Length above which a log is estimated in pieces [s]; its trajectory alone would take
gigabytes.
"""
LOG_PIECE = 60.0
"""Length of a piece [s]."""
CHECKED = 300.0
"""Length of the part of a long log that is checked before it is estimated [s]; takes some
seconds and, at 500 Hz, 600 MB.
"""
JUDGED = 40_000
"""Largest number of estimates for the metrics of a log in pieces, evenly spread: 80 MB. Relative
errors are of all, within each piece.
"""


class EstimateOfFile(NamedTuple):
    """What `estimate_file` found: metrics, None where the log has no reference or the filter
    diverged; health; and what would mend the estimate, "" where it needs no advice.
    """

    metrics: Metrics | None
    health: Health
    advice: str


def estimate_file(settings: EstimateSettings) -> EstimateOfFile:
    """Estimate a log with one filter and, with `out`, write the trajectory.

    A log longer than LONG is processed in pieces, using the memory of one, unless there are effects
    to compensate, which needs the whole log; remedies are not tried on one in pieces. What
    is implausible in its start, and what else is to be known (`notes_on`), is printed to stderr.
    Raises SurefootError saying what is missing or wrong.
    """
    reader = LogReader(settings.log)
    if settings.out:
        if settings.out.suffix != ".parquet":
            raise SurefootError(
                f"out {settings.out}: give a .parquet file; the .tum is written beside it, and "
                "`surefoot export` writes CSV or MCAP"
            )
        for path in (settings.out, settings.out.with_suffix(".tum")):
            refuse_overwrite(path, settings.force)
    learnt = learnt_from(settings.observer, settings.bounds)
    chosen = read_settings(settings.settings, settings.entries)
    whole = reader.rows / reader.meta.rate <= LONG
    first = next(Log.chunks(reader, np.inf if whole else CHECKED))
    (doubts,) = not_plausible([first], settings.robot, settings.strict)
    estimator = estimator_named(settings.filter)
    whole = whole or bool(reader.meta.effects) or settings.effects is not None
    first = next(Log.chunks(reader, np.inf if whole else LOG_PIECE))
    first.require("imu")
    robot = run.robot_of(first, settings.robot)
    read = with_effects(first, robot, settings.effects)
    first, model = run.declared_model(read, robot)
    for note in notes_on(first, model, learnt, chosen):
        print(f"note: {first.name}: {note}", file=sys.stderr)
    judge = _Judge(None if whole else reader)
    parts: list[RunSummary] = []
    pieces, same = tee([first] if whole else Log.chunks(reader, LOG_PIECE))
    with errors_in(f"filter {settings.filter}"), ExitStack() as files:
        write: Callable[[Trajectory], None] | None = None
        estimates = run.estimated_in_chunks(estimator, pieces, model, learnt, chosen)
        for part, log in zip(estimates, same, strict=False):  # ends where it diverged
            if settings.out is not None:
                write = write or files.enter_context(
                    _opened(settings.out, settings.force, doubts, part if whole else None)
                )
                write(part)
            parts.append(summary_of_run(part, log))
            judge.add(log, part)
        metrics = None if parts[-1].diverged else judge.metrics()
    found = run.health_of(parts, estimator, model, first, chosen)
    advised = whole and not settings.no_advice and needs_advice(settings.filter, metrics, found)
    words = ""
    if advised:
        print("trying what would mend the estimate (--no-advice skips this)", file=sys.stderr)
        words = advice(settings.filter, read, robot, learnt, chosen)
    return EstimateOfFile(metrics, found, words)


@contextmanager
def _opened(
    out: Path, force: bool, doubts: tuple[str, ...], only: Trajectory | None
) -> Iterator[Callable[[Trajectory], None]]:
    """A function that writes the next piece to both files, which are whole or absent.

    doubts: about what in the log was not plausible, kept in the trajectory's metadata. only: the
    one piece, whose columns the file has.
    """
    columns = None if only is None else tuple(only.columns())
    with (
        trajectory_file(out, force, columns, doubts) as append,
        whole_file(out.with_suffix(".tum"), force) as path,
        path.open("w") as lines,
    ):

        def write(part: Trajectory) -> None:
            append(part)
            part.append_tum(lines)

        yield write


class _Judge:
    """Metrics of an estimate that comes in pieces; `reader` None for one in a single piece."""

    def __init__(self, reader: LogReader | None):
        self._every = 1
        if reader is not None:
            estimates = reader.rows / reader.meta.rate * METRICS_RATE
            self._every = int(np.ceil(estimates / JUDGED))
        self._whole = reader is None
        self._pairs: list[tuple[Trajectory, Trajectory]] = []
        self._squares, self._segments = np.zeros(2), 0  # sums over the relative errors

    def add(self, log: Log, part: Trajectory) -> None:
        """Count the estimate of a piece, if a reference was measured during it."""
        if not log.has("reference"):
            return
        if self._whole:
            self._pairs.append((reference(log), part))
            return
        with suppress(TrajectoryError):
            truth, estimate = matched(reference(log), part)
            errors = relative_errors(truth, estimate)
            self._squares += [np.sum(np.square(one)) for one in errors]
            self._segments += len(errors[0])
            self._pairs.append((_thinned(truth, self._every), _thinned(estimate, self._every)))

    def metrics(self) -> Metrics | None:
        """Metrics over all pieces; None without a reference."""
        if not self._pairs:
            return None
        if self._whole:
            return evaluate(*self._pairs[0])
        truths, estimates = zip(*self._pairs, strict=True)
        self._pairs.clear()  # to hold them only once
        metrics = evaluate(run.joined_trajectory(truths), run.joined_trajectory(estimates))
        n = self._segments
        trans, rot = np.sqrt(self._squares / n) if n else (np.nan, np.nan)
        return replace(metrics, rpe_trans=float(trans), rpe_rot=float(rot), segments=n)


def _thinned(part: Trajectory, every: int) -> Trajectory:
    """Keep one in `every` estimates, and as many updates, without holding on to the others."""
    updates = part.updates
    if updates is not None:
        kept = {name: x[::every].copy() for name, x in vars(updates).items() if x is not None}
        updates = replace(updates, **kept)
    return replace(part.rows(np.arange(0, len(part.t), every)), updates=updates)
