"""The paper's Monte-Carlo study: EKF and coverage, unbiased and biased, and further regimes.

"Bounds from the gamma-quantiles of the noise" has four readings (`READINGS`), which are kept apart:
each axis' quantile of |e| at gamma (the box then holds less than gamma jointly); at gamma^(1/3)
(the paper's own calibration, which holds gamma where axes are independent); and the "outer
quantiles" that the paper names for its biased regime, at 99 % and at 99.9 %. The filters with a
persistent state take its prior from separate calibration trials (`models.calibration.bias_model`).

Each regime is a case whose row is stored, so that an interrupted study is resumed.
"""

import re
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from studies.montecarlo.settings import (
    BIASED,
    UNBIASED,
    ErrorLaw,
    MonteCarloStudy,
    Regime,
)
from studies.montecarlo.trials import (
    Trials,
    Truth,
    make_trials,
    population,
    true_motion,
    velocity_errors,
)
from surefoot.estimator import bounded_velocities, gaussian_velocities, imu_samples
from surefoot.extend import (
    CoverageSettings,
    FilterNoise,
    InvariantFilter,
    NavState,
    PersistentError,
    PersistentFilter,
    Trajectory,
    estimate_bias_model,
    level_per_axis,
    nees,
)
from surefoot.scenarios.datasets.cluster import run_on_cluster
from surefoot.scenarios.reporting import finished_case, processes, stage

AT_GAMMA, PER_AXIS = "gamma", "gamma^(1/3)"
READINGS: dict[str, Callable[[float], float]] = {
    AT_GAMMA: lambda gamma: gamma,
    PER_AXIS: level_per_axis,
    "outer, 99 %": lambda gamma: max(0.99, level_per_axis(gamma)),
    "outer, 99.9 %": lambda gamma: max(0.999, level_per_axis(gamma)),
}
"""Name -> quantile of each axis' |e| that is used as its bound, from the filter's joint level."""
OUTER = "outer, 99 %"
ITERATIONS = (1, 2, 5)
"""Numbers of projections in a coverage update that are compared."""
JOB = 10
"""Trials in a job for one worker."""
CURVE = 60
"""Largest number of instants of a stored curve over time."""
_MODULE = "studies.montecarlo.study"


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
    """Scores of one filter in one regime over the trials, for a table.

    rmse [m] and nees: mean, standard deviation and median over trials, of position; active: share
    of updates that changed the state. Curves over instants of a trial, root mean square distance
    [m] and mean NEES, are empty where no figure shows them.
    """

    regime: str
    filter: str
    gamma: float | None
    reading: str | None
    iterations: int
    epsilon: tuple[float, ...] | None
    rmse: tuple[float, float, float]
    nees: tuple[float, float, float]
    active: float
    distance_curve: tuple[float, ...] = ()
    nees_curve: tuple[float, ...] = ()


@dataclass(frozen=True)
class Batch:
    """A case of the study: the filters of a table on `trials` trials of one regime.

    numbers: of the seeds from which settings and trials are drawn.
    """

    table: str
    regime: Regime
    numbers: tuple[int, int]
    trials: int


@dataclass(frozen=True)
class Results:
    """The study's rows: the paper's two regimes, those beyond, and iterated projections.

    beside: regime -> comparison of `coverage_persistent` with `velocity_persistent`.
    """

    study: MonteCarloStudy
    paper: tuple[FilterScores, ...]
    beyond: tuple[FilterScores, ...]
    iterated: tuple[FilterScores, ...]
    beside: dict[str, str]


def run_montecarlo(
    study: MonteCarloStudy, workers: int = 1, cluster: str | None = None, data: Path | None = None
) -> Results:
    """All tables from the study's seed alone, the same on any number of workers.

    Args:
        study: what is drawn.
        workers: processes of this machine.
        cluster: address of a Dask scheduler to run on instead.
        data: folder of finished cases, which are not run again; by default they are not stored.
    """
    tables: dict[str, list[FilterScores]] = {"paper": [], "beyond": [], "iterated": []}
    beside = {}
    with processes(1 if cluster else workers) as pool:
        for batch in study_batches(study):
            inputs = {"study": asdict(study), "batch": asdict(batch)}
            inputs["study"]["beyond"]["regime"] = []  # the batch has its own
            name = re.sub(r"\W+", "_", f"{batch.table} {batch.regime.name}")
            make = partial(run_batch, study, batch, pool, cluster)
            row = finished_case(data, name, inputs, _MODULE, make) if data else make()
            tables[batch.table] += [FilterScores(**scores) for scores in row["filters"]]
            if "beside" in row:
                beside[batch.regime.name] = row["beside"]
    return Results(study, **{k: tuple(v) for k, v in tables.items()}, beside=beside)


def study_batches(study: MonteCarloStudy) -> list[Batch]:
    """Every case that the study runs."""
    few = study.beyond.trials
    regimes = list(enumerate((UNBIASED, BIASED)))
    return [
        *(Batch("paper", regime, (k, k), study.trials) for k, regime in regimes),
        # The same trial numbers as the biased regime's, so that rows differ by their errors alone.
        *(
            Batch("beyond", regime, (k, 1), few)
            for k, regime in enumerate(study.beyond.regime, start=2)
        ),
        *(Batch("iterated", regime, (k, k), few) for k, regime in regimes),
    ]


def run_batch(
    study: MonteCarloStudy,
    batch: Batch,
    pool: ProcessPoolExecutor | None = None,
    cluster: str | None = None,
) -> dict[str, Any]:
    """The row of a case: scores of each filter, and a comparison of the two with a persistent
    state.

    Args:
        study: what is drawn.
        batch: the case.
        pool: of processes; by default this process.
        cluster: address of a Dask scheduler to run on instead.
    """
    settings = batch_settings(study, batch)
    jobs = {
        first: (run_job, study, batch, settings, first, min(first + JOB, batch.trials))
        for first in range(0, batch.trials, JOB)
    }
    if cluster is None:
        parts = list(stage(pool, f"{batch.table}, {batch.regime.name}", jobs).values())
    else:
        done = run_on_cluster(cluster, _call, list(jobs.values()))
        parts = [one for _, one in sorted(done, key=lambda pair: pair[0])]
    scores = [
        Scores(*(np.concatenate([getattr(p, n) for p in own]) for n in Scores.__annotations__))
        for own in zip(*parts, strict=True)
    ]
    found = zip(settings, scores, strict=True)
    row: dict[str, Any] = {"filters": [asdict(_row(study, batch, *one)) for one in found]}
    if batch.table == "beyond":
        named = dict(zip([s.filter for s in settings], scores, strict=True))
        row["beside"] = compared(named["coverage_persistent"], named["velocity_persistent"])
    return row


def compared(ours: Scores, theirs: Scores) -> str:
    """Whether a filter is more accurate and more consistent than another on the same trials.

    Compares RMSE, and the factor between each trial's NEES and 3: "more" or "less" if the mean
    difference exceeds two of its standard errors, else "as".
    """
    off = [np.abs(np.log(s.mean_nees / 3.0)) for s in (ours, theirs)]
    words = []
    for what, excess in (("accurate", ours.rmse - theirs.rmse), ("consistent", off[0] - off[1])):
        error = excess.std(ddof=1) / np.sqrt(len(excess))
        known = abs(excess.mean()) > 2.0 * error
        words.append(f"{'as' if not known else 'less' if excess.mean() > 0 else 'more'} {what}")
    return ", ".join(words)


def _row(study: MonteCarloStudy, batch: Batch, setting: Setting, scores: Scores) -> FilterScores:
    drawn = batch.table == "paper" and setting.gamma in (None, study.beyond.gamma)
    at = slice(None, None, max(1, scores.nees.shape[1] // CURVE)) if drawn else slice(0)
    epsilon = setting.epsilon

    def rounded(values) -> tuple[float, ...]:
        return tuple(float(f"{x:.6g}") for x in values)

    def over_trials(x: np.ndarray) -> Any:
        return rounded((x.mean(), x.std(ddof=1), np.median(x)))

    return FilterScores(
        regime=batch.regime.name,
        filter=setting.filter,
        gamma=setting.gamma,
        reading=setting.reading,
        iterations=setting.iterations,
        epsilon=None if epsilon is None else rounded(epsilon),
        rmse=over_trials(scores.rmse),
        nees=over_trials(scores.mean_nees),
        active=float(f"{scores.active.mean():.6g}"),
        distance_curve=rounded(np.sqrt(np.mean(scores.distance**2, axis=0))[at]),
        nees_curve=rounded(scores.nees.mean(axis=0)[at]),
    )


def batch_settings(study: MonteCarloStudy, batch: Batch) -> list[Setting]:
    """The filters of a case."""
    seed = study_seed(study, batch.numbers[0], 0)
    if batch.table == "paper":
        return paper_settings(study, batch.regime, seed)
    settings = beyond_settings(study, batch.regime, seed)
    if batch.table == "beyond":
        return settings
    return [
        replace(setting, iterations=count)
        for setting in settings
        if setting.reading == PER_AXIS
        for count in ITERATIONS
    ]


def run_job(
    study: MonteCarloStudy, batch: Batch, settings: Sequence[Setting], first: int, stop: int
) -> list[Scores]:
    """The scores of each setting on the trials first..stop - 1 of a case.

    Args:
        study: what is drawn.
        batch: the case.
        settings: its filters.
        first: trial.
        stop: one past the last trial.
    """
    truth = true_motion(study)
    seeds = study_seed(study, batch.numbers[1], 1).spawn(stop)[first:]
    trials = make_trials(study, truth, batch.regime.test, seeds)
    return [run_trials(study, truth, trials, setting) for setting in settings]


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
        imu, start = imu_samples(truth.t, gyro, accel), (NavState.unpack(mean), trials.covariance)
        if setting.persistent is None:
            one = InvariantFilter(*start, noise)
        else:
            one = PersistentFilter(*start, setting.persistent, noise)
        if setting.R is not None:
            velocities, levels = gaussian_velocities(rows, v_I, setting.R, len(imu.t)), None
        else:
            assert setting.gamma is not None
            velocities = bounded_velocities(rows, v_I, setting.epsilon, len(imu.t))
            levels = CoverageSettings(setting.gamma, setting.iterations)
        found = one.run(imu, velocities, np.arange(0, len(imu.t), study.per_score), levels)
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
    settings = [Setting("velocity", R=_second_moment(errors))]
    settings += [
        Setting("coverage", epsilon=bounds(errors, gamma, reading), gamma=gamma, reading=reading)
        for reading in READINGS
        for gamma in study.gammas
    ]
    plain = (AT_GAMMA, PER_AXIS)
    return settings + _persistent(study, regime.calibration, calibration_seed, plain)


def beyond_settings(
    study: MonteCarloStudy, regime: Regime, seed: np.random.SeedSequence
) -> list[Setting]:
    """The filters at one gamma, calibrated as in the regime, with bounds at gamma^(1/3); and
    coverage with outer quantiles.
    """
    noise_seed, calibration_seed = seed.spawn(2)
    errors = population(study, regime.calibration, np.random.default_rng(noise_seed))
    gamma = study.beyond.gamma
    return [
        Setting("velocity", R=_second_moment(errors)),
        *(
            Setting("coverage", epsilon=bounds(errors, gamma, name), gamma=gamma, reading=name)
            for name in (PER_AXIS, OUTER)
        ),
        *_persistent(study, regime.calibration, calibration_seed, (PER_AXIS,)),
    ]


def bounds(errors: np.ndarray, gamma: float, reading: str) -> np.ndarray:
    """epsilon (3,): quantile of |errors (n, 3)| on each axis, at the level of the reading."""
    return np.quantile(np.abs(errors), READINGS[reading](gamma), axis=0)


def study_seed(study: MonteCarloStudy, number: int, purpose: int) -> np.random.SeedSequence:
    """The seed of a regime's settings (purpose 0) or of its trials (purpose 1)."""
    return np.random.SeedSequence([study.seed, number, purpose])


def _second_moment(errors: np.ndarray) -> np.ndarray:
    """Mean of e e^T (3, 3) over errors (n, 3)."""
    return errors.T @ errors / len(errors)


def _persistent(
    study: MonteCarloStudy, law: ErrorLaw, seed: np.random.SeedSequence, readings: tuple[str, ...]
) -> list[Setting]:
    """Both filters with a persistent state, its prior estimated on separate calibration trials."""
    seeds = seed.spawn(study.calibration_trials)
    errors = [velocity_errors(study, law, study.updates, np.random.default_rng(s)) for s in seeds]
    gamma, dt = study.beyond.gamma, 1.0 / study.update_rate
    # `estimate_bias_model` ranks each axis at the cube root of the level that it is given.
    parts = {
        reading: estimate_bias_model(errors, dt, READINGS[reading](gamma) ** 3)
        for reading in readings
    }
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
