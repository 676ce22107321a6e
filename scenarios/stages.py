"""Work in stages, each spread over processes of this machine and shown by a bar."""

from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from multiprocessing import get_context
from typing import Any

from tqdm import tqdm


@contextmanager
def processes(workers: int) -> Iterator[ProcessPoolExecutor | None]:
    """A pool of processes; one worker is this process itself."""
    if workers == 1:
        yield None
        return
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        yield pool


def stage(pool: Executor | None, label: str, tasks: dict[Any, tuple]) -> dict[Any, Any]:
    """What the tasks (a function and its arguments each) return, made in the pool.

    An error ends the stage; the tasks keep what they have done.
    """
    results: dict[Any, Any] = {}
    with tqdm(total=len(tasks), desc=label, disable=not tasks) as bar:
        if pool is None:
            for key, (work, *arguments) in tasks.items():
                results[key] = work(*arguments)
                bar.update()
            return results
        futures = {pool.submit(*task): key for key, task in tasks.items()}
        try:
            for future in as_completed(futures):
                results[futures[future]] = future.result()
                bar.update()
        finally:
            for future in futures:
                future.cancel()
    # In the tasks' order, whatever finished first.
    return {key: results[key] for key in tasks}
