"""Many walks at once, each on its own thread, in compiled code that releases the GIL.

Walks share nothing, so robots, grounds and courses may differ within a batch, and each walk is
equal, bit for bit, to the same walk alone.
"""

import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeVar

from surefoot.sim.effects import Effect
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario
from surefoot.sim.walk import Plan, plan, walk_planned

S = TypeVar("S")
T = TypeVar("T")


@dataclass(frozen=True)
class Job:
    """Arguments of `sim.walk.walk`, with the robot by its name or file."""

    scenario: Scenario
    robot: str
    seed: int
    effects: tuple[Effect, ...] = ()
    declared: bool = True


class _Stopped(Exception):
    """The batch has ended, so its remaining walks stop."""


def walk_job(job: Job, progress: Callable[[float], None] | None = None) -> Log:
    """Simulate one walk, as `sim.walk.walk` does."""
    return walk_planned(plan_of(job), progress)


def plan_of(job: Job) -> Plan:
    """The plan of a walk."""
    return plan(job.scenario, known_robot(job.robot), job.seed, job.effects, job.declared)


@lru_cache(maxsize=16)
def known_robot(name_or_path: str) -> Robot:
    """`Robot.load`, cached."""
    return Robot.load(name_or_path)


def on_threads(
    items: Sequence[S],
    work: Callable[[S, Callable[[float], None]], T],
    threads: int = 1,
    progress: Callable[[float], None] | None = None,
) -> Iterator[T]:
    """Run `work(item, report)` for every item on `threads` threads; yields results in order of
    finishing.

    Results can be used, and files written, within `work`, in parallel. It calls `report` with the
    share done, which raises once the batch has ended; `progress` is called with the share of the
    whole batch. An error, or leaving the iterator early, stops the walks in progress within a
    second of simulated time.
    """
    shares = [0.0] * len(items)
    stop, guard = threading.Event(), threading.Lock()

    def one(i: int) -> T:
        def report(share: float) -> None:
            if stop.is_set():
                raise _Stopped
            if progress:
                with guard:
                    shares[i] = share
                    progress(sum(shares) / len(items))

        report(0.0)
        result = work(items[i], report)
        report(1.0)
        return result

    with ThreadPoolExecutor(threads, thread_name_prefix="walk") as pool:
        try:
            # No list of futures is kept: it would hold every result until the end.
            for future in as_completed({pool.submit(one, i) for i in range(len(items))}):
                yield future.result()
        finally:
            stop.set()
            pool.shutdown(wait=False, cancel_futures=True)
