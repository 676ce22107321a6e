"""Run times relative to a peer, each a ratio measured in one run.

The two run alternately, under the same conditions; the smallest time of each counts.
"""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from tyro.conf import UseAppendAction, arg

from studies.bench.box import box_rows
from studies.bench.filter import coverage_row, gtsam_row, step_row
from studies.bench.ratio import Progress, Ratio, in_turn, part_of
from studies.bench.walking import race
from studies.montecarlo.numpy_reference import numpy_trial
from studies.montecarlo.settings import BIASED, load_study
from studies.montecarlo.study import Setting, run_trials
from studies.montecarlo.trials import make_trials, true_motion
from surefoot.extend import SurefootError, check_limit, did_you_mean
from surefoot.scenarios.reporting import Section, origin_of, percent_bar, to_markdown, write_page

_TRIALS, _DURATION = 40, 4.0


def montecarlo_rows(rounds: int, progress: Progress | None = None) -> list[Ratio]:
    """Four seconds of 40 trials on one core, compared with one trial in numpy; one line per
    filter.
    """
    study = replace(load_study(), duration=_DURATION)
    truth = true_motion(study)
    seeds = np.random.SeedSequence(11).spawn(_TRIALS)
    trials = make_trials(study, truth, BIASED.test, seeds)
    settings = {
        "EKF": Setting("velocity", R=np.diag(study.noise_std**2)),
        "coverage": Setting("coverage", epsilon=1.8 * study.noise_std, gamma=0.8),
    }
    rows = []
    for number, (name, setting) in enumerate(settings.items()):
        batch, one = in_turn(
            lambda setting=setting: run_trials(study, truth, trials, setting),
            lambda setting=setting: numpy_trial(study, truth, trials, 0, setting),
            rounds,
            part_of(progress, number, len(settings)),
        )
        note = (
            f"{1e3 * batch / _TRIALS:.2f} against {1e3 * one:.0f} ms a trial of {_DURATION:.0f} s"
        )
        what = f"Monte-Carlo study, {name}"
        rows.append(Ratio(what, "one trial at a time in numpy", one * _TRIALS / batch, 30.0, note))
    return rows


def walking(
    rounds: int, progress: Progress | None = None, robots: int = 4, threads: int = 0
) -> Ratio:
    """Simulated walking compared with `mujoco.rollout` of the recorded controls; threads 0: all
    cores.
    """
    threads = threads or os.cpu_count() or 1
    pair = race(robots, threads)
    ours, theirs = in_turn(pair.walk, pair.replay, rounds, progress)
    return Ratio(
        what=f"walking, {robots} robots on {threads} threads, controller and sensors included",
        against="mujoco.rollout of the same controls, same states",
        value=theirs / ours,
        target=0.6,
        note=f"{pair.steps / ours:,.0f} against {pair.steps / theirs:,.0f} steps/s; "
        f"{pair.steps * 0.002 / ours:.0f} simulated s per s",
    )


ROWS: dict[str, Callable[[int, Progress | None], list[Ratio]]] = {
    "box": box_rows,
    "coverage": lambda rounds, progress: [coverage_row(rounds, progress)],
    "step": lambda rounds, progress: [step_row(rounds, progress)],
    "gtsam": lambda rounds, progress: [gtsam_row(rounds, progress)],
    "montecarlo": montecarlo_rows,
    "walking": lambda rounds, progress: [walking(rounds, progress)],
}


@dataclass(frozen=True)
class Bench:
    """Measure run times, each as a ratio to a reference timed in the same run."""

    rounds: int = 12
    """Number of repetitions of each pair, alternating; the shortest time counts."""
    only: Annotated[
        UseAppendAction[tuple[str, ...]],
        arg(metavar="ITEM", help=f"One of {', '.join(ROWS)}; by default all."),
    ] = ()
    page: Path | None = None
    """Page of results to write as well, such as docs/results/bench.md."""

    def run(self) -> None:
        print(bench(self.rounds, self.only, self.page))


def bench(rounds: int, only: Sequence[str] = (), page: Path | None = None) -> str:
    """Run the items, by default all; returns the table in Markdown.

    Raises SurefootError for an unknown item or no round; writes the page of results if requested.
    """
    for name in only:
        if name not in ROWS:
            hint = did_you_mean(name, ROWS)
            raise SurefootError(f"--only {name}: known are {', '.join(ROWS)}{hint}")
    if rounds < 1:
        raise SurefootError(f"--rounds {rounds}: at least 1")
    check_limit("items", rounds, "--rounds")
    rows = []
    for name in only or ROWS:
        with percent_bar(name) as progress:
            rows += [ratio.as_row() for ratio in ROWS[name](rounds, progress)]
    if page:
        write_page(
            page, "Speed", ratio_sections(rows, rounds), origin_of(__name__, "make study-bench")
        )
    return to_markdown(rows)


def ratio_sections(rows: Sequence[Mapping[str, str]], rounds: int) -> list[Section]:
    """Findings with the ratios, how they are measured, and the ratios with notes."""
    asked = [row for row in rows if row[""] != "-"]
    missed = [row for row in asked if row[""] == "missed"]
    names = "; ".join(f"{r['what']} ({r['times as fast']}, target {r['target']})" for r in missed)
    main = f"{len(asked) - len(missed)} of {len(asked)} ratios of run times reach their targets."
    method = (
        "Each ratio is measured in one run, with ours and its peer in turn; the smallest of "
        f"{rounds} times counts for each. gtsam is the extra `gtsam`."
    )
    shown = [{key: value for key, value in row.items() if key != "note"} for row in rows]
    return [
        Section("Findings", f"{main}\n\nMissed: {names or 'none'}.", shown),
        Section("Method", method),
        Section("Ratios with times", "", list(rows), file="ratios"),
    ]
