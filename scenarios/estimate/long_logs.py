"""Estimate the file of a log, as a whole or, if it is long, in pieces."""

from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from surefoot.estimator.evaluation.health import Health
from surefoot.estimator.evaluation.run_summary import RunSummary, summary_of_run
from surefoot.estimator.evaluation.trajectory import (
    Trajectory,
    TrajectoryError,
    TrajectoryWriter,
    reference,
)
from surefoot.estimator.metrics import (
    METRICS_RATE,
    Metrics,
    evaluate,
    matched,
    relative_errors,
)
from surefoot.scenarios.estimate.contract import Learnt
from surefoot.scenarios.estimate.estimators import estimator_named
from surefoot.scenarios.estimate.run import (
    estimated_in_chunks,
    health_of,
    joined_trajectory,
    robot_of,
    run_filter,
)
from surefoot.scenarios.estimate.settings import FilterSettings
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.files import whole_file
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
"""Largest number of estimates for the metrics of a long log, evenly spread: 80 MB. Relative
errors are of all, within each piece.
"""


def estimate_file(
    name: str,
    reader: LogReader,
    robot_name: str | None,
    learnt: Learnt,
    out: Path | None,
    force: bool = False,
    settings: FilterSettings | None = None,
    warnings: Sequence[str] = (),
) -> tuple[Metrics | None, Health]:
    """Estimate a log with one filter.

    Returns its metrics, None where it has no reference or the filter diverged, and its health. A
    log longer than LONG is processed in pieces, using the memory of one, unless it declares
    effects, whose compensation needs the whole log. Raises SurefootError saying what is missing or
    wrong.

    Args:
        name: of the filter.
        reader: of the log.
        robot_name: name or MJCF file; None for the log's own.
        learnt: observers and bounds.
        out: file for the trajectory (.parquet), with a .tum beside it; None to write none.
        force: whether to overwrite them.
        settings: noise, priors and start.
        warnings: about what in the log was not plausible, kept in the trajectory's metadata.
    """
    if reader.rows / reader.meta.rate <= LONG or reader.meta.effects:
        (log,) = Log.chunks(reader)
        result = run_filter(name, log, robot_of(log, robot_name), learnt, settings)
        if out:
            with whole_file(out, force) as temporary:
                result.trajectory.write(temporary, warnings=warnings)
                result.trajectory.write_tum(out.with_suffix(".tum"), force)
        return result.metrics, result.health
    try:
        return _in_pieces(name, reader, robot_name, learnt, out, force, settings, warnings)
    except SurefootError as error:
        raise SurefootError(f"filter {name}: {error}") from None


def first_minutes(reader: LogReader) -> Log:
    """The log, or the first CHECKED seconds of a long one, for checks."""
    long = reader.rows / reader.meta.rate > LONG
    return next(Log.chunks(reader, CHECKED if long else np.inf))


def _in_pieces(
    name: str,
    reader: LogReader,
    robot_name: str | None,
    learnt: Learnt,
    out: Path | None,
    force: bool,
    settings: FilterSettings | None,
    warnings: Sequence[str],
) -> tuple[Metrics | None, Health]:
    """`estimate_file` for a log that is read in pieces.

    Args:
        name: of the filter.
        reader: of the log.
        robot_name: or None for the log's own.
        learnt: observers and bounds.
        out: file for the trajectory, or None.
        force: whether its file may be replaced.
        settings: noise, priors and start.
        warnings: about what in the log was not plausible.
    """
    every = int(np.ceil(reader.rows / reader.meta.rate * METRICS_RATE / JUDGED))
    waiting: deque[Log] = deque()  # pieces that were read but not estimated
    parts: list[RunSummary] = []
    judged: list[tuple[Trajectory, Trajectory]] = []
    squares, segments = np.zeros(2), 0  # sums over the relative errors

    def pieces() -> Iterator[Log]:
        for log in Log.chunks(reader, LOG_PIECE):
            waiting.append(log)
            yield log

    first = next(Log.chunks(reader, LOG_PIECE))
    robot, estimator = robot_of(first, robot_name), estimator_named(name)
    with ExitStack() as files:
        table, lines = None, None
        if out:
            table = files.enter_context(TrajectoryWriter(out, force, None, warnings))
            path = files.enter_context(whole_file(out.with_suffix(".tum"), force))
            lines = files.enter_context(path.open("w"))
        for part in estimated_in_chunks(estimator, pieces(), robot, learnt, None, settings):
            if table is not None and lines is not None:
                table.write(part)
                part.append_tum(lines)
            log = waiting.popleft()
            parts.append(summary_of_run(part, log))
            if log.has("reference"):
                with suppress(TrajectoryError):  # no reference was measured during this piece
                    truth, estimate = matched(reference(log), part)
                    errors = relative_errors(truth, estimate)
                    squares += [np.sum(np.square(one)) for one in errors]
                    segments += len(errors[0])
                    judged.append((_thinned(truth, every), _thinned(estimate, every)))
    found = health_of(parts, estimator, robot, first, settings)
    if not judged or parts[-1].diverged:
        return None, found
    metrics = evaluate(*_joined_pairs(judged))
    trans, rot = np.sqrt(squares / segments) if segments else (np.nan, np.nan)
    relative = {"rpe_trans": float(trans), "rpe_rot": float(rot), "segments": segments}
    return replace(metrics, **relative), found


def _thinned(part: Trajectory, every: int) -> Trajectory:
    """Keep one in `every` estimates, and as many updates, without holding on to the others."""
    updates = part.updates
    if updates is not None:
        known = {name: value for name, value in vars(updates).items() if value is not None}
        kept = {name: value[::every].copy() for name, value in known.items()}
        updates = replace(updates, **kept)
    return replace(part.rows(np.arange(0, len(part.t), every)), updates=updates)


def _joined_pairs(
    pairs: list[tuple[Trajectory, Trajectory]],
) -> tuple[Trajectory, Trajectory]:
    """Join successive references and estimates, and empty their list, to hold them only once."""
    truths, estimates = zip(*pairs, strict=True)
    pairs.clear()
    return joined_trajectory(truths), joined_trajectory(estimates)
