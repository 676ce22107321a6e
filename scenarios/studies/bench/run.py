"""`surefoot bench`: what this costs against what it is measured by, each a ratio of one run.

A and B run in turn, so that both see the same machine; the smallest time of either counts.
"""

import os
from collections.abc import Callable

from surefoot.scenarios.studies.bench.box import box_rows
from surefoot.scenarios.studies.bench.filter import coverage_row, gtsam_row, step_row
from surefoot.scenarios.studies.bench.montecarlo import montecarlo_rows
from surefoot.scenarios.studies.bench.ratio import Progress, Ratio, in_turn
from surefoot.scenarios.studies.bench.walking import race


def walking(rounds: int, tell: Progress | None = None, robots: int = 4, threads: int = 0) -> Ratio:
    """Simulated walking against `mujoco.rollout` of the recorded controls; threads 0: all cores."""
    threads = threads or os.cpu_count() or 1
    pair = race(robots, threads)
    ours, theirs = in_turn(pair.walk, pair.replay, rounds, tell)
    return Ratio(
        what=f"walking, {robots} robots on {threads} threads, controller and sensors included",
        against="mujoco.rollout of the same controls, same states",
        value=theirs / ours,
        target=0.6,
        note=f"{pair.steps / ours:,.0f} against {pair.steps / theirs:,.0f} steps/s; "
        f"{pair.steps * 0.002 / ours:.0f} simulated s per s",
    )


ITEMS: dict[str, Callable[[int, Progress | None], list[Ratio]]] = {
    "box": box_rows,
    "coverage": lambda rounds, tell: [coverage_row(rounds, tell)],
    "step": lambda rounds, tell: [step_row(rounds, tell)],
    "gtsam": lambda rounds, tell: [gtsam_row(rounds, tell)],
    "montecarlo": montecarlo_rows,
    "walking": lambda rounds, tell: [walking(rounds, tell)],
}
