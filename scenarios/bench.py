"""`surefoot bench`: what this costs against what it is measured by, each a ratio of one run.

A and B run in turn, so that both see the same machine; the smallest time of either counts.
"""

import os
from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter

from scenarios.bench_walking import race

Tell = Callable[[float], None]


@dataclass(frozen=True)
class Ratio:
    """One line of the table."""

    what: str
    against: str
    value: float
    target: str
    note: str

    def as_row(self) -> dict[str, str]:
        return {
            "what": self.what,
            "against": self.against,
            "ratio": f"{self.value:.2f}",
            "target": self.target,
            "note": self.note,
        }


def in_turn(
    ours: Callable[[], object], theirs: Callable[[], object], rounds: int, tell: Tell | None = None
) -> tuple[float, float]:
    """Smallest times [s] of the two, run in turn `rounds` times after once to warm up."""
    times: list[tuple[float, float]] = []
    for i in range(rounds + 1):
        now = perf_counter()
        ours()
        between = perf_counter()
        theirs()
        times.append((between - now, perf_counter() - between))
        if tell:
            tell((i + 1) / (rounds + 1))
    return min(a for a, _ in times[1:]), min(b for _, b in times[1:])


def walking(rounds: int, tell: Tell | None = None, robots: int = 4, threads: int = 0) -> Ratio:
    """Simulated walking against `mujoco.rollout` of the recorded controls; threads 0: all cores."""
    threads = threads or os.cpu_count() or 1
    pair = race(robots, threads)
    ours, theirs = in_turn(pair.walk, pair.replay, rounds, tell)
    return Ratio(
        what=f"walking, {robots} robots on {threads} threads, controller and sensors included",
        against="mujoco.rollout of the same controls, same states",
        value=theirs / ours,
        target=">= 0.6",
        note=f"{pair.steps / ours:,.0f} against {pair.steps / theirs:,.0f} steps/s; "
        f"{pair.steps * 0.002 / ours:.0f} simulated s per s",
    )


ITEMS: dict[str, Callable[[int, Tell | None], Ratio]] = {"walking": walking}
