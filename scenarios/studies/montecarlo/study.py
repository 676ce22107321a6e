"""The paper's Monte-Carlo study: the EKF and coverage, unbiased and biased, and what lies beyond.

Two readings of "bounds from the gamma-quantiles of the noise" are kept apart: each axis' quantile
of |e| at gamma (the box then holds less than gamma jointly), and at gamma^(1/3) (the paper's own
calibration, which holds gamma where axes are independent). The filters with a persistent state
take its prior from separate calibration trials (`models.calibration.bias_model`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from surefoot.estimator.core.state import FilterNoise, NavState
from surefoot.estimator.evaluation.trajectory import Trajectory
from surefoot.estimator.filter import run_coverage, run_velocity
from surefoot.estimator.metrics import nees
from surefoot.estimator.updates.bias_states import PersistentError
from surefoot.models.calibration.bias_model import estimate_bias_model
from surefoot.models.calibration.regions import second_moment
from surefoot.scenarios.datasets.cluster import run_on_cluster
from surefoot.scenarios.stages import processes, stage
from surefoot.scenarios.studies.montecarlo.settings import (
    BIASED,
    UNBIASED,
    ErrorLaw,
    MonteCarloStudy,
    Regime,
)
from surefoot.scenarios.studies.montecarlo.trials import (
    Trials,
    Truth,
    make_trials,
    population,
    true_motion,
    velocity_errors,
)

READINGS = ("gamma", "gamma^(1/3)")
ITERATIONS = (1, 2, 5)
"""Projections of one coverage update that are set side by side."""
JOB = 20
"""Trials of a job: what a worker is sent."""


@dataclass(frozen=True)
class Setting:
    """One filter of the study: a Gaussian update with R, or coverage with epsilon at gamma.

    R (3, 3) [m^2/s^2] or None; epsilon (3,) [m/s], the joint level gamma and its reading, None for
    Gaussian filters; persistent, None without those states: with them epsilon bounds the mean of a
    window; iterations of the projection in one coverage update.
    """

    filter: str
    R: np.ndarray | None = None
    epsilon: np.ndarray | None = None
    gamma: float | None = None
    reading: str | None = None
    persistent: PersistentError | None = None
    iterations: int = 1


@dataclass(frozen=True)
class Scores:
    """Results of T trials at L instants (the start is left out), against the truth in G.

    distance (T, L) [m] of the position; nees (T, L) of the position; active (T,) the share of
    updates that changed the state.
    """

    distance: np.ndarray
    nees: np.ndarray
    active: np.ndarray

    @staticmethod
    def joined(parts: Sequence["Scores"]) -> "Scores":
        """All trials of the parts, one part after the other."""
        return Scores(
            np.concatenate([part.distance for part in parts]),
            np.concatenate([part.nees for part in parts]),
            np.concatenate([part.active for part in parts]),
        )

    @property
    def rmse(self) -> np.ndarray:
        """Position RMSE (T,) [m] over each trial."""
        return np.sqrt(np.mean(self.distance**2, axis=1))

    @property
    def mean_nees(self) -> np.ndarray:
        """Mean position NEES (T,) over each trial."""
        return self.nees.mean(axis=1)


@dataclass(frozen=True)
class FilterScores:
    """One filter in one regime, with its scores over the trials."""

    regime: str
    setting: Setting
    scores: Scores


@dataclass(frozen=True)
class Results:
    """The study's rows: the paper's two regimes, those beyond, and iterated projections."""

    study: MonteCarloStudy
    paper: tuple[FilterScores, ...]
    beyond: tuple[FilterScores, ...]
    iterated: tuple[FilterScores, ...]
    seconds: float


@dataclass(frozen=True)
class Batch:
    """Filters that meet the same trials of one regime: `count` trials of the seed `number`."""

    table: str
    regime: Regime
    settings: tuple[Setting, ...]
    number: int
    count: int


def run_montecarlo(study: MonteCarloStudy, workers: int = 1, cluster: str | None = None) -> Results:
    """All tables from the study's seed alone, the same on any number of workers.

    workers: processes of this machine; cluster: address of a Dask scheduler to run on instead.
    """
    started = perf_counter()
    batches = study_batches(study)
    jobs = {
        (place, first): (run_job, study, batch, first, min(first + JOB, batch.count))
        for place, batch in enumerate(batches)
        for first in range(0, batch.count, JOB)
    }
    if cluster is None:
        with processes(workers) as pool:
            scores = stage(pool, "trials", jobs)
    else:
        keys = list(jobs)
        done = run_on_cluster(cluster, _call, list(jobs.values()))
        scores = {keys[place]: one for place, one in done}
    tables: dict[str, list[FilterScores]] = {"paper": [], "beyond": [], "iterated": []}
    for place, batch in enumerate(batches):
        parts = [scores[place, first] for first in range(0, batch.count, JOB)]
        for setting, own in zip(batch.settings, zip(*parts, strict=True), strict=True):
            tables[batch.table].append(FilterScores(batch.regime.name, setting, Scores.joined(own)))
    rows = {name: tuple(table) for name, table in tables.items()}
    return Results(study, **rows, seconds=perf_counter() - started)


def study_batches(study: MonteCarloStudy) -> list[Batch]:
    """Everything that the study runs."""
    batches, iterated = [], []
    for number, regime in enumerate((UNBIASED, BIASED)):
        seed = study_seed(study, number, 0)
        settings = tuple(paper_settings(study, regime, seed))
        batches.append(Batch("paper", regime, settings, number, study.trials))
        repeated = tuple(
            replace(setting, iterations=count)
            for setting in beyond_settings(study, regime, study_seed(study, number, 0))
            if setting.epsilon is not None
            for count in ITERATIONS
        )
        iterated.append(Batch("iterated", regime, repeated, number, study.beyond.trials))
    for number, regime in enumerate(study.beyond.regime, start=2):
        settings = tuple(beyond_settings(study, regime, study_seed(study, number, 0)))
        # The same trial numbers as the paper's regimes, so that rows differ by their errors alone.
        batches.append(Batch("beyond", regime, settings, 1, study.beyond.trials))
    return batches + iterated


def run_job(study: MonteCarloStudy, batch: Batch, first: int, stop: int) -> list[Scores]:
    """The scores of each setting of a batch on its trials first..stop - 1."""
    truth = true_motion(study)
    seeds = study_seed(study, batch.number, 1).spawn(stop)[first:]
    trials = make_trials(study, truth, batch.regime.test, seeds)
    return [run_trials(study, truth, trials, setting) for setting in batch.settings]


def run_trials(study: MonteCarloStudy, truth: Truth, trials: Trials, setting: Setting) -> Scores:
    """One filter on each of the trials."""
    rows = np.arange(1, study.updates + 1) * study.per_update
    at = slice(None, None, study.per_score)
    zeros = np.zeros((len(truth.t[at]), 3))
    true = Trajectory(truth.t[at], truth.R_GI[at], truth.v_GI[at], truth.p_GI[at], zeros, zeros)
    noise = FilterNoise(study.imu.gyro, study.imu.accel, 0.0, 0.0)
    distance, position_nees, active = [], [], []
    for gyro, accel, v_I, mean in zip(
        trials.gyro, trials.accel, trials.v_I, trials.means, strict=True
    ):
        log = truth.t, gyro, accel, rows, v_I
        start = NavState.unpack(mean), trials.covariance, noise, study.per_score
        if setting.R is not None:
            found = run_velocity(*log, setting.R, *start, setting.persistent)
        else:
            found = run_coverage(
                *log,
                setting.epsilon,
                setting.gamma,
                *start,
                persistent=setting.persistent,
                iterations=setting.iterations,
            )
        assert found.updates is not None
        distance.append(np.linalg.norm(found.p_GI - true.p_GI, axis=1)[1:])
        position_nees.append(nees(true, found).position[1:])
        active.append(found.updates.active.mean())
    return Scores(np.array(distance), np.array(position_nees), np.array(active))


def paper_settings(
    study: MonteCarloStudy, regime: Regime, seed: np.random.SeedSequence
) -> list[Setting]:
    """The paper's rows, then the two filters with a persistent state."""
    noise_seed, calibration_seed = seed.spawn(2)
    errors = population(study, regime.calibration, np.random.default_rng(noise_seed))
    settings = [Setting("velocity", R=second_moment(errors))]
    settings += [
        Setting("coverage", epsilon=bounds(errors, gamma, reading), gamma=gamma, reading=reading)
        for reading in READINGS
        for gamma in study.gammas
    ]
    return settings + _persistent(study, regime.calibration, calibration_seed, READINGS)


def beyond_settings(
    study: MonteCarloStudy, regime: Regime, seed: np.random.SeedSequence
) -> list[Setting]:
    """The four filters at one gamma with bounds at gamma^(1/3), calibrated as the regime says."""
    noise_seed, calibration_seed = seed.spawn(2)
    errors = population(study, regime.calibration, np.random.default_rng(noise_seed))
    gamma, reading = study.beyond.gamma, READINGS[1]
    return [
        Setting("velocity", R=second_moment(errors)),
        Setting("coverage", epsilon=bounds(errors, gamma, reading), gamma=gamma, reading=reading),
        *_persistent(study, regime.calibration, calibration_seed, (reading,)),
    ]


def bounds(errors: np.ndarray, gamma: float, reading: str) -> np.ndarray:
    """epsilon (3,): each axis' quantile of |errors (n, 3)| at the level that the reading means."""
    level = gamma if reading == READINGS[0] else gamma ** (1 / 3)
    return np.quantile(np.abs(errors), level, axis=0)


def study_seed(study: MonteCarloStudy, number: int, purpose: int) -> np.random.SeedSequence:
    """The seed of a regime's settings (purpose 0) or of its trials (purpose 1)."""
    return np.random.SeedSequence([study.seed, number, purpose])


def _persistent(
    study: MonteCarloStudy, law: ErrorLaw, seed: np.random.SeedSequence, readings: tuple[str, ...]
) -> list[Setting]:
    """Both filters with a persistent state, its prior estimated on separate calibration trials."""
    seeds = seed.spawn(study.calibration_trials)
    errors = [velocity_errors(study, law, study.updates, np.random.default_rng(s)) for s in seeds]
    gamma, dt = study.beyond.gamma, 1.0 / study.update_rate
    # `estimate_bias_model` ranks each axis at the cube root of the level that it is given.
    levels = {READINGS[0]: gamma**3, READINGS[1]: gamma}
    parts = {reading: estimate_bias_model(errors, dt, levels[reading]) for reading in readings}
    part = parts[readings[0]]
    persistent = PersistentError(
        part.covariance, part.time_constant, part.window, part.max_error, part.course
    )
    return [
        Setting("velocity_persistent", R=part.within, persistent=persistent),
        *(
            Setting(
                "coverage_persistent",
                epsilon=found.epsilon,
                gamma=gamma,
                reading=reading,
                persistent=persistent,
            )
            for reading, found in parts.items()
        ),
    ]


def _call(job: tuple) -> list[Scores]:
    work, *arguments = job
    return work(*arguments)
