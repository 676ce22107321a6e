"""One walk of a dataset, simulated into its file."""

import os
from collections.abc import Callable
from pathlib import Path

from surefoot.scenarios.datasets.index import (
    MINUTE,
    IndexRow,
    fall_path,
    log_name,
    row_of,
    walk_facts,
)
from surefoot.sim.common.files import whole_file
from surefoot.sim.log import Log, LogReader, LogWriter
from surefoot.sim.walk import Fallen, Plan, fallen_log, meta_of, walk_planned
from surefoot.sim.walking.batch import Job, plan_of
from surefoot.sim.walking.long_walk import LONG_WALK, needs_whole, walk_in_pieces


def walk_and_save(
    folder: Path,
    force: bool,
    job: Job,
    progress: Callable[[float], None] = lambda share: None,
) -> IndexRow:
    """Simulate one walk and write its log, a long one in pieces, up to a fall if any; returns the
    row.

    Args:
        folder: of the dataset.
        force: whether its file may be replaced.
        job: the walk.
        progress: called with the share done.
    """
    made, path = plan_of(job), folder / f"{log_name(job)}.parquet"
    try:
        if made.seconds > LONG_WALK and not needs_whole(made):
            _write_in_pieces(made, path, fall_path(folder, job), force, progress)
            return row_of(job, made, walk_facts(Log.chunks(LogReader(path), MINUTE)), path)
        log = walk_planned(made, progress)
    except Fallen as fall:
        if before := fallen_log(made, fall):
            before.write(fall_path(folder, job), force=True)
        return row_of(job, made, fall)
    log.write(path, force)
    return row_of(job, made, walk_facts([log]), path)


def _write_in_pieces(
    made: Plan, path: Path, fallen: Path, force: bool, progress: Callable[[float], None]
) -> None:
    """Write a walk with the memory of one piece. Raises Fallen if it falls; what came before is
    then at another path.

    Args:
        made: plan of the walk.
        path: of the log.
        fallen: path of the log up to a fall.
        force: whether the log may be replaced.
        progress: called with the share done.
    """
    with whole_file(path, force) as temporary:
        with LogWriter(temporary, meta_of(made)) as writer:
            fall = None
            try:
                for frame in walk_in_pieces(made, progress):
                    writer.write(frame)
            except Fallen as error:
                fall = error
        if fall:
            if writer.rows:
                with whole_file(fallen, force=True) as kept:
                    os.replace(temporary, kept)
            raise fall
