"""Work shown by bars, and distributed in stages over processes of this machine."""

import multiprocessing
import signal
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from os import _exit
from threading import Thread
from typing import Any

from surefoot.sim.common.files import remove_unfinished
from surefoot.sim.common.plugins import exits_raised, naming_plugins
from surefoot.sim.common.progress import bar as drawn_bar
from surefoot.sim.common.terminal import printing_plainly

LAYOUT = "{l_bar}{bar}| {elapsed}, {remaining} left{postfix}"
LONGEST_LABEL = 24
"""Number of characters to which a label is cut."""


@contextmanager
def percent_bar(label: str) -> Iterator[Callable[[float], None]]:
    """Context with a function that takes the completed share of the work, from 0 to 1."""
    with drawn_bar(total=100, desc=label[:LONGEST_LABEL], bar_format=LAYOUT) as bar:

        def show(share: float) -> None:
            if share > 0.0 and not bar.n:
                bar.unpause()  # what was compiled before tells nothing of the time left
            bar.update(100.0 * share - bar.n)

        yield show


@contextmanager
def processes(workers: int) -> Iterator[ProcessPoolExecutor | None]:
    """Context with a pool of processes; None for one worker, which is this process itself.

    The processes end with this one in any case, at once if it is interrupted; after an error,
    running tasks are finished.
    """
    if workers == 1:
        yield None
        return
    # Python's tracker, a process of its own, removes semaphores of a pool that a signal has ended;
    # it would report that after the line of the interruption.
    sys.warnoptions.append("ignore::UserWarning:multiprocessing.resource_tracker")
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_end_with_parent)
    try:
        yield pool
    except Exception:
        pool.shutdown(cancel_futures=True)
        raise
    except BaseException:
        end_processes()
        raise
    finally:
        pool.shutdown()


def end_processes() -> None:
    """End all processes of pools at once.

    Their tasks are not cancelled, since a pool's own thread fails on cancelled tasks.
    """
    for process in multiprocessing.active_children():
        process.terminate()


def submitted(pool: ProcessPoolExecutor, task: tuple) -> Future:
    """Submit a task (a function and its arguments) to a pool of `processes`.

    A keyboard interrupt reaches all processes of a terminal; workers are started with it blocked,
    so that only this process reports it and ends them.
    """
    if not hasattr(signal, "pthread_sigmask"):
        return pool.submit(_run, *task)
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        return pool.submit(_run, *task)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _run(work: Callable[..., Any], *arguments: Any) -> Any:
    """In a worker: run a task, whose errors reach the other process without their places."""
    with printing_plainly(), naming_plugins(), exits_raised():
        return work(*arguments)


def _end_with_parent() -> None:
    """In a worker: end when the process that started it is gone."""
    parent = multiprocessing.parent_process()

    def wait() -> None:
        if parent is not None:
            parent.join()
            remove_unfinished()
            _exit(1)

    Thread(target=wait, daemon=True).start()


def stage(pool: ProcessPoolExecutor | None, label: str, tasks: dict[Any, tuple]) -> dict[Any, Any]:
    """Run the tasks (a function and its arguments each) in the pool; returns their results.

    An error ends the stage; what other tasks have stored remains.
    """
    results: dict[Any, Any] = {}
    with drawn_bar(total=len(tasks), desc=label, disable=not tasks) as bar:
        if pool is None:
            for key, (work, *arguments) in tasks.items():
                results[key] = work(*arguments)
                bar.update()
            return results
        futures = {submitted(pool, task): key for key, task in tasks.items()}
        for future in as_completed(futures):
            results[futures[future]] = future.result()
            bar.update()
    # In the order of the tasks, not of their completion.
    return {key: results[key] for key in tasks}
