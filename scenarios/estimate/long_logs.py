"""Estimating the file of a log: as a whole, or piece by piece where it is long."""

from collections import deque
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from surefoot.estimator.evaluation.trajectory import (
    Trajectory,
    TrajectoryError,
    TrajectoryWriter,
    reference,
)
from surefoot.estimator.metrics import Metrics, evaluate, matched
from surefoot.estimator.run import OUTPUT_PERIOD
from surefoot.scenarios.estimate.contract import Learnt
from surefoot.scenarios.estimate.estimators import estimator_named
from surefoot.scenarios.estimate.run import estimated_in_chunks, joined_trajectory, run_filter
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.files import whole_file
from surefoot.sim.log import Log, LogReader
from surefoot.sim.robot import Robot

LONG = 1800.0
"""s. A longer log is estimated in pieces: its trajectory alone would take gigabytes."""
LOG_PIECE = 60.0
"""s of a piece."""
JUDGED = 100_000
"""Estimates at most that the metrics of a long log are taken from, evenly spread: 180 MB."""


def estimate_file(
    name: str,
    reader: LogReader,
    robot_name: str | None,
    learnt: Learnt,
    out: Path | None,
    force: bool = False,
) -> Metrics | None:
    """Estimate a log with one filter; its metrics, None where it has no reference.

    A log longer than LONG goes in pieces, in the memory of one, unless it declares effects, whose
    compensation takes the whole log.

    Args:
        name: of the filter.
        reader: of the log.
        robot_name: name or MJCF file; the log's own where it is None.
        learnt: observers and bounds.
        out: file for the trajectory (.parquet), with a .tum beside it; none is written for None.
        force: whether to overwrite them.

    Raises SurefootError saying what is missing or wrong.
    """
    if reader.rows / reader.meta.rate <= LONG or reader.meta.effects:
        (log,) = reader.chunks()
        result = run_filter(name, log, Robot.for_log(log, robot_name), learnt)
        if out:
            result.trajectory.write(out, force)
            result.trajectory.write_tum(out.with_suffix(".tum"), force)
        return result.metrics
    try:
        return _in_pieces(name, reader, robot_name, learnt, out, force)
    except SurefootError as error:
        raise SurefootError(f"filter {name}: {error}") from None


def _in_pieces(
    name: str,
    reader: LogReader,
    robot_name: str | None,
    learnt: Learnt,
    out: Path | None,
    force: bool,
) -> Metrics | None:
    """One filter over a log read piece by piece; its metrics, or None without a reference.

    Args:
        name: of the filter.
        reader: of the log.
        robot_name: or None for the log's own.
        learnt: observers and bounds.
        out: folder for the estimate, or None.
        force: whether its file may be replaced.
    """
    every = int(np.ceil(reader.rows / reader.meta.rate / OUTPUT_PERIOD / JUDGED))
    waiting: deque[Trajectory] = deque()  # references of pieces that were read but not estimated
    judged: list[tuple[Trajectory, Trajectory]] = []

    def pieces() -> Iterator[Log]:
        for log in reader.chunks(LOG_PIECE):
            if log.has("reference"):
                waiting.append(reference(log))
            yield log

    robot = Robot.for_log(next(reader.chunks(LOG_PIECE)), robot_name)
    with ExitStack() as files:
        table, lines = None, None
        if out:
            table = files.enter_context(TrajectoryWriter(out, force))
            path = files.enter_context(whole_file(out.with_suffix(".tum"), force))
            lines = files.enter_context(path.open("w"))
        for part in estimated_in_chunks(estimator_named(name), pieces(), robot, learnt):
            if table is not None and lines is not None:
                table.write(part)
                part.append_tum(lines)
            if waiting:
                with suppress(TrajectoryError):  # no reference was measured during this piece
                    judged.append(matched(waiting.popleft(), _thinned(part, every)))
    if not judged:
        return None
    truths, estimates = zip(*judged, strict=True)
    return evaluate(joined_trajectory(truths), joined_trajectory(estimates))


def _thinned(part: Trajectory, every: int) -> Trajectory:
    """Every so many estimates and updates of it."""
    updates = part.updates
    if updates is not None:
        values = {name: value for name, value in vars(updates).items() if value is not None}
        updates = replace(updates, **{name: value[::every] for name, value in values.items()})
    return replace(part.rows(slice(None, None, every)), updates=updates)
