"""Walks on a Dask cluster: same jobs, same bits; workers need surefoot, but no shared disk."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TypeVar

from surefoot.scenarios.datasets.index import IndexRow, fall_path, recipe
from surefoot.scenarios.datasets.walk_file import walk_and_save
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.files import whole_file
from surefoot.sim.walking.batch import Job, known_robot

T = TypeVar("T")
R = TypeVar("R")
PATIENCE = 20.0  # s to wait for the scheduler and a first worker


def walk_on_cluster(
    address: str, jobs: Sequence[Job], folder: Path, force: bool, progress: Callable[[float], None]
) -> Iterator[IndexRow]:
    """Run walks on the scheduler at `address`; yields rows as their files are written here.

    The walks of a worker that dies are repeated on the others. Workers send whole files; only this
    process writes them into `folder`. Raises SurefootError in one line where the cluster is
    unreachable, or a worker would not give the same bits.

    Args:
        address: of the scheduler, host:port.
        jobs: the walks.
        folder: for the logs.
        force: whether files there may be replaced.
        progress: called with the share done.
    """
    tasks = [(job, recipe(job)) for job in jobs]
    for done, (place, found) in enumerate(run_on_cluster(address, _walk_remotely, tasks), 1):
        values, content = found
        row = IndexRow(**values)
        if content:
            path = folder / row.file if row.file else fall_path(folder, jobs[place])
            with whole_file(path, force or bool(row.falls)) as temporary:
                temporary.write_bytes(content)
        yield row
        progress(done / len(jobs))


def run_on_cluster(
    address: str, function: Callable[[T], R], arguments: Sequence[T]
) -> Iterator[tuple[int, R]]:
    """Map a function on the scheduler at `address`; yields indices in `arguments` and results as
    completed.

    A result stays with its worker until the next is requested. Raises SurefootError in one line
    where the cluster is unreachable or lacks the function.
    """
    if not arguments:
        return
    try:
        from distributed import Client, as_completed
    except ImportError:
        raise SurefootError("cluster: needs the extra, pip install 'surefoot[cluster]'") from None
    with (
        _one_line_errors(address),
        Client(address, timeout=PATIENCE, set_as_default=False) as client,
    ):
        client.wait_for_workers(1, timeout=PATIENCE)
        futures = {client.submit(function, x, pure=False): i for i, x in enumerate(arguments)}
        for future in as_completed(list(futures), loop=client.loop):
            yield futures.pop(future), future.result()
            future.release()


def _walk_remotely(task: tuple[Job, str]) -> tuple[dict, bytes]:
    """On a worker: the row of a job with its recipe, and the log's file, empty if it fell before
    the log began.
    """
    job, expected = task
    if recipe(job) != expected:
        raise SurefootError(
            f"robot {known_robot(job.robot).name}: a worker has another model of it, or another "
            "version of surefoot, mujoco, numpy or numba: its walks would differ"
        )
    with TemporaryDirectory() as name:
        folder = Path(name)
        row = walk_and_save(folder, False, job)
        path = folder / row.file if row.file else fall_path(folder, job)
        return asdict(row), path.read_bytes() if path.is_file() else b""


@contextmanager
def _one_line_errors(address: str) -> Iterator[None]:
    """Convert errors of a cluster to one line."""
    from distributed import KilledWorker
    from distributed.client import FutureCancelledError

    faults = OSError, TimeoutError, ValueError, TypeError  # the last of addresses of other schemes
    try:
        yield
    except SurefootError:
        raise
    except (*faults, KilledWorker, FutureCancelledError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise SurefootError(f"cluster {address}: {reason}") from None
