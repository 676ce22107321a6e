"""The paper's Monte-Carlo study: the EKF and coverage, unbiased and biased, and what lies beyond.

Two readings of "bounds from the gamma-quantiles of the noise" are kept apart: each axis' quantile
of |e| at gamma (the box then holds less than gamma jointly), and at gamma^(1/3) (the paper's own
calibration, which holds gamma where axes are independent). The filters with a persistent state are
given what separate calibration trials show (`models.calibration.bias_model`).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from time import perf_counter

import numpy as np

from surefoot.estimator.updates.bias_states import PersistentError
from surefoot.models.calibration.bias_model import estimate_bias_model
from surefoot.scenarios.studies.montecarlo.batch import Scores, Setting, run_batch
from surefoot.scenarios.studies.montecarlo.settings import BIASED, UNBIASED, ErrorLaw, Regime, Study
from surefoot.scenarios.studies.montecarlo.trials import (
    Trials,
    Truth,
    make_trials,
    population,
    true_motion,
)
from surefoot.scenarios.studies.montecarlo.trials import velocity_errors as draw_errors

READINGS = ("gamma", "gamma^(1/3)")
JOB = 20
"""Trials in a job."""


@dataclass(frozen=True)
class Row:
    """One filter in one regime. gamma and reading (one of READINGS) are None for Gaussian filters.

    epsilon (3,) [m/s], None for Gaussian filters; scores over the trials.
    """

    regime: str
    filter: str
    gamma: float | None
    reading: str | None
    epsilon: np.ndarray | None
    scores: Scores


@dataclass(frozen=True)
class Found:
    """The study's rows: the paper's two regimes, and those beyond; seconds that the runs took."""

    study: Study
    truth: Truth
    rows: tuple[Row, ...]
    beyond: tuple[Row, ...]
    seconds: float


@dataclass(frozen=True)
class Job:
    """Some trials of one regime, all filters on each: what a worker is sent.

    Trials first..stop - 1 of those with the seed `number`.
    """

    study: Study
    regime: Regime
    settings: "tuple[Named, ...]"
    number: int
    first: int
    stop: int


Spread = Callable[[Sequence[Job]], Iterator[tuple[int, list[Scores]]]]
"""Runs jobs somewhere: their places in the sequence and what `run_job` gives, in any order."""


def run_study(
    study: Study, tell: Callable[[float], None] | None = None, spread: Spread | None = None
) -> Found:
    """Both tables from the study's seed alone; `tell` is given the share done.

    `spread` runs the jobs, here one after the other where left out; the numbers are the same.
    """
    started = perf_counter()
    jobs = study_jobs(study)
    scores: list[list[Scores]] = [[] for _ in jobs]
    for done, (place, found) in enumerate((spread or run_locally)(jobs), 1):
        scores[place] = found
        if tell:
            tell(done / len(jobs))
    rows: dict[tuple, Row] = {}
    for job, found in zip(jobs, scores, strict=True):
        for (name, gamma, reading, setting), part in zip(job.settings, found, strict=True):
            key = job.regime.name, name, gamma, reading
            whole = rows[key].scores.joined(part) if key in rows else part
            rows[key] = Row(*key[:1], name, gamma, reading, setting.epsilon, whole)
    paper = [r for r in rows.values() if r.regime in (UNBIASED.name, BIASED.name)]
    beyond = [r for r in rows.values() if r.regime not in (UNBIASED.name, BIASED.name)]
    return Found(study, true_motion(study), tuple(paper), tuple(beyond), perf_counter() - started)


def study_jobs(study: Study) -> list[Job]:
    """The study in pieces of JOB trials."""
    jobs = []
    for number, regime in enumerate((UNBIASED, BIASED)):
        settings = tuple(paper_settings(study, regime, study_seed(study, number, 0)))
        jobs += _pieces(study, regime, settings, number, study.trials)
    for number, regime in enumerate(study.beyond, start=2):
        settings = tuple(beyond_settings(study, regime, study_seed(study, number, 0)))
        # The same trial numbers as the paper's regimes, so that rows differ by their errors alone.
        jobs += _pieces(study, regime, settings, 1, study.beyond_trials)
    return jobs


def run_locally(jobs: Sequence[Job]) -> Iterator[tuple[int, list[Scores]]]:
    """All jobs in this process, threads sharing each."""
    for place, job in enumerate(jobs):
        yield place, run_job(job)


def run_job(job: Job, threads: int | None = None) -> list[Scores]:
    """The scores of each setting on the job's trials."""
    truth = true_motion(job.study)
    trials = study_trials(job.study, truth, job.regime.test, job.stop, job.number, job.first)
    return [run_batch(job.study, truth, trials, setting, threads) for *_, setting in job.settings]


def _pieces(study, regime: Regime, settings, number: int, count: int) -> list[Job]:
    return [
        Job(study, regime, settings, number, first, min(first + JOB, count))
        for first in range(0, count, JOB)
    ]


Named = tuple[str, float | None, str | None, Setting]
"""Filter, gamma, reading, and what `run_batch` needs."""


def paper_settings(study: Study, regime: Regime, seed: np.random.SeedSequence) -> list[Named]:
    """The paper's rows, then the two filters with a persistent state."""
    noise_seed, calibration_seed = seed.spawn(2)
    errors = population(study, regime.calibration, np.random.default_rng(noise_seed))
    named: list[Named] = [("velocity", None, None, Setting(R=second_moment(errors)))]
    for reading in READINGS:
        for gamma in study.gammas:
            epsilon = bounds(errors, gamma, reading)
            named.append(("coverage", gamma, reading, Setting(epsilon=epsilon, gamma=gamma)))
    return named + _persistent(study, regime.calibration, calibration_seed, READINGS)


def beyond_settings(study: Study, regime: Regime, seed: np.random.SeedSequence) -> list[Named]:
    """The four filters at one gamma with bounds at gamma^(1/3), calibrated as the regime says."""
    noise_seed, calibration_seed = seed.spawn(2)
    errors = population(study, regime.calibration, np.random.default_rng(noise_seed))
    gamma, reading = study.beyond_gamma, READINGS[1]
    plain = Setting(epsilon=bounds(errors, gamma, reading), gamma=gamma)
    return [
        ("velocity", None, None, Setting(R=second_moment(errors))),
        ("coverage", gamma, reading, plain),
        *_persistent(study, regime.calibration, calibration_seed, (reading,)),
    ]


def bounds(errors: np.ndarray, gamma: float, reading: str) -> np.ndarray:
    """epsilon (3,): each axis' quantile of |errors (n, 3)| at the level that the reading means."""
    level = gamma if reading == READINGS[0] else gamma ** (1 / 3)
    return np.quantile(np.abs(errors), level, axis=0)


def second_moment(errors: np.ndarray) -> np.ndarray:
    """R (3, 3) of the zero-mean Gaussian fitted to errors (n, 3)."""
    return errors.T @ errors / len(errors)


def _persistent(
    study: Study, law: ErrorLaw, seed: np.random.SeedSequence, readings: tuple[str, ...]
) -> list[Named]:
    """Both filters with a persistent state, given what separate calibration trials show."""
    seeds = seed.spawn(study.calibration_trials)
    errors = [draw_errors(study, law, study.updates, np.random.default_rng(s)) for s in seeds]
    gamma, dt = study.beyond_gamma, 1.0 / study.update_rate
    # `estimate` ranks each axis at the cube root of the level that it is given.
    levels = {READINGS[0]: gamma**3, READINGS[1]: gamma}
    parts = {reading: estimate_bias_model(errors, dt, levels[reading]) for reading in readings}
    part = parts[readings[0]]
    lasting = PersistentError(
        part.covariance, part.time_constant, part.window, part.reach, part.course
    )
    coverage: list[Named] = [
        (
            "coverage_persistent", gamma, reading,
            Setting(epsilon=found.epsilon, gamma=gamma, persistent=lasting),
        )
        for reading, found in parts.items()
    ]  # fmt: skip
    return [
        ("velocity_persistent", None, None, Setting(R=part.within, persistent=lasting)),
        *coverage,
    ]


def study_seed(study: Study, number: int, purpose: int) -> np.random.SeedSequence:
    return np.random.SeedSequence([study.seed, number, purpose])


def study_trials(
    study: Study, truth: Truth, law: ErrorLaw, stop: int, number: int, first: int = 0
) -> Trials:
    return make_trials(study, truth, law, study_seed(study, number, 1).spawn(stop)[first:])
