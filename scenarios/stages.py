"""Work in stages, each spread over processes of this machine and shown by a bar."""

import multiprocessing
import os
import signal
from collections.abc import Iterator
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from threading import Thread
from typing import Any

from surefoot.sim.common.progress import bar as drawn_bar


@contextmanager
def processes(workers: int) -> Iterator[ProcessPoolExecutor | None]:
    """A pool of processes; one worker is this process itself.

    They end with this process however it ends, at once where it is interrupted; after an error
    those at work finish what they have begun.
    """
    if workers == 1:
        yield None
        return
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_end_with_parent)
    try:
        yield pool
    except Exception:
        pool.shutdown(cancel_futures=True)
        raise
    except BaseException:
        # Nothing is cancelled here: the pool's own thread fails on such tasks.
        for process in multiprocessing.active_children():
            process.terminate()
        raise
    finally:
        pool.shutdown()


def submitted(pool: ProcessPoolExecutor, task: tuple) -> Future:
    """A task (a function and its arguments) given to a pool of `processes`.

    A keyboard's interrupt reaches all processes of a terminal: workers are started deaf to it, so
    that this one alone says what happened and ends them.
    """
    if not hasattr(signal, "pthread_sigmask"):
        return pool.submit(*task)
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        return pool.submit(*task)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _end_with_parent() -> None:
    """In a worker: end when the process that started it is gone."""
    parent = multiprocessing.parent_process()

    def wait() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    Thread(target=wait, daemon=True).start()


def stage(pool: ProcessPoolExecutor | None, label: str, tasks: dict[Any, tuple]) -> dict[Any, Any]:
    """What the tasks (a function and its arguments each) return, made in the pool.

    An error ends the stage; the tasks keep what they have done.
    """
    results: dict[Any, Any] = {}
    with drawn_bar(total=len(tasks), desc=label, disable=not tasks) as bar:
        if pool is None:
            for key, (work, *arguments) in tasks.items():
                results[key] = work(*arguments)
                bar.update()
            return results
        futures = {submitted(pool, task): key for key, task in tasks.items()}
        try:
            for future in as_completed(futures):
                results[futures[future]] = future.result()
                bar.update()
        except Exception:
            for future in futures:
                future.cancel()
            raise
    # In the tasks' order, whatever finished first.
    return {key: results[key] for key in tasks}
