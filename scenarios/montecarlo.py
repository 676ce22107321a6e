"""The paper's Monte-Carlo study: the EKF and coverage, unbiased and biased, and what lies beyond.

Two readings of "bounds from the gamma-quantiles of the noise" are kept apart: each axis' quantile
of |e| at gamma (the box then holds less than gamma jointly), and at gamma^(1/3) (the paper's own
calibration, which holds gamma where axes are independent). The filters with a persistent state are
given what separate calibration trials show; see `variance_components`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter

import numpy as np

from scenarios.montecarlo_batch import Scores, Setting, run_batch
from scenarios.montecarlo_study import BIASED, UNBIASED, ErrorLaw, Regime, Study
from scenarios.montecarlo_trials import Trials, Truth, make_trials, population, true_motion
from scenarios.montecarlo_trials import velocity_errors as draw_errors

READINGS = ("gamma", "gamma^(1/3)")


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
class Components:
    """Variance components of errors: between trials (3, 3) and within, both [m^2/s^2].

    residuals (n, 3) [m/s] is the mixing part, each trial's mean taken off.
    """

    between: np.ndarray
    within: np.ndarray
    residuals: np.ndarray


@dataclass(frozen=True)
class Found:
    """The study's rows: the paper's two regimes, and those beyond; seconds that the runs took."""

    study: Study
    truth: Truth
    rows: tuple[Row, ...]
    beyond: tuple[Row, ...]
    seconds: float


def run_study(study: Study, tell: Callable[[float], None] | None = None) -> Found:
    """Both tables from the study's seed alone; `tell` is given the share done."""
    truth = true_motion(study)
    per_regime = 2 * len(study.gammas) + 4
    total = 2 * study.trials * per_regime + len(study.beyond) * study.beyond_trials * 4
    done = 0

    def count(trials: int) -> None:
        nonlocal done
        done += trials
        if tell:
            tell(done / total)

    rows: list[Row] = []
    beyond: list[Row] = []
    started = perf_counter()
    for number, regime in enumerate((UNBIASED, BIASED)):
        settings = paper_settings(study, regime, study_seed(study, number, 0))
        trials = study_trials(study, truth, regime.test, study.trials, number)
        rows += run_settings(study, truth, trials, regime, settings, count)
    for number, regime in enumerate(study.beyond, start=2):
        settings = beyond_settings(study, regime, study_seed(study, number, 0))
        # The same trial numbers as the paper's regimes, so that rows differ by their errors alone.
        trials = study_trials(study, truth, regime.test, study.beyond_trials, 1)
        beyond += run_settings(study, truth, trials, regime, settings, count)
    return Found(study, truth, tuple(rows), tuple(beyond), perf_counter() - started)


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


def run_settings(
    study: Study,
    truth: Truth,
    trials: Trials,
    regime: Regime,
    settings: list[Named],
    tell: Callable[[int], None] | None = None,
) -> list[Row]:
    """One row a setting, all on the same trials."""
    return [
        Row(
            regime.name, name, gamma, reading, setting.epsilon,
            run_batch(study, truth, trials, setting, tell),
        )
        for name, gamma, reading, setting in settings
    ]  # fmt: skip


def variance_components(errors: np.ndarray) -> Components:
    """What lasts through a trial and what does not, from errors (S, n, 3) of S trials.

    Within: the covariance about each trial's mean. Between: the second moment M of the means. As a
    prior of the next trial's mean it has to tell what S trials do not: given M, the covariance
    follows an inverse Wishart law with S degrees of freedom (its scale S M, no prior weight), whose
    mean is S / (S - 4) M in three dimensions. The share of M that the mixing part's own mean makes
    (within / n_eff) stays in it: a smaller persistent part cannot be told from none.
    """
    S = len(errors)
    means = errors.mean(axis=1)
    residuals = (errors - means[:, None]).reshape(-1, 3)
    between = means.T @ means / (S - 4)
    return Components(between, second_moment(residuals), residuals)


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
    seeds = seed.spawn(study.calibration_trials)
    errors = [draw_errors(study, law, study.updates, np.random.default_rng(s)) for s in seeds]
    parts = variance_components(np.array(errors))
    gamma = study.beyond_gamma
    named: list[Named] = [
        ("velocity_persistent", None, None, Setting(R=parts.within, persistent=parts.between))
    ]
    for reading in readings:
        epsilon = bounds(parts.residuals, gamma, reading)
        setting = Setting(epsilon=epsilon, gamma=gamma, persistent=parts.between)
        named.append(("coverage_persistent", gamma, reading, setting))
    return named


def study_seed(study: Study, number: int, purpose: int) -> np.random.SeedSequence:
    return np.random.SeedSequence([study.seed, number, purpose])


def study_trials(study: Study, truth: Truth, law: ErrorLaw, count: int, number: int) -> Trials:
    return make_trials(study, truth, law, study_seed(study, number, 1).spawn(count))
