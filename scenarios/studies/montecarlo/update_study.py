"""The coverage update by itself, in numbers: the paper's remark pi < pi+ <= gamma, and iterations.

That the remark holds for exact moments is proved in `estimator.updates.coverage`. What is studied
here is
how far one update gets, and what becomes of the remark where the proof does not reach: moments that
are sampled, as the paper's are, and a state that turns while it is updated.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from surefoot.estimator.box import box_moments
from surefoot.estimator.core import lie
from surefoot.estimator.core.state import NavState
from surefoot.estimator.updates.coverage import posterior_moments, update_coverage
from surefoot.estimator.updates.velocity_output import velocity_output
from surefoot.scenarios.studies.montecarlo.batch import Scores, run_batch
from surefoot.scenarios.studies.montecarlo.qmc import ordinary_boxes, qmc_moments
from surefoot.scenarios.studies.montecarlo.settings import BIASED, UNBIASED, Study
from surefoot.scenarios.studies.montecarlo.study import beyond_settings, study_seed, study_trials
from surefoot.scenarios.studies.montecarlo.trials import true_motion

ITERATIONS = (1, 2, 5)
_TINY = 1e-12


@dataclass(frozen=True)
class Remark:
    """Whether pi < pi+ <= gamma holds, over boxes on which the update is active.

    way: how the update was made; active: how many boxes; raised and within: the shares of them with
    pi+ > pi and with pi+ <= gamma; closed: the mean of (pi+ - pi) / (gamma - pi), the share of the
    gap that one update closes, and after_five: that five close (NaN where not asked); breach:
    (pi, pi+) where the remark fails by most, None where it never does.
    """

    way: str
    gamma: float
    active: int
    raised: float
    within: float
    closed: float
    after_five: float
    breach: tuple[float, float] | None


@dataclass(frozen=True)
class Iterated:
    """What a coverage filter of the Monte-Carlo study does with so many projections an update."""

    regime: str
    filter: str
    iterations: int
    scores: Scores


def update(mean, cov, lower, upper, gamma: float) -> tuple[float, np.ndarray, np.ndarray]:
    """pi of the prior, and mean (3,) and covariance (3, 3) of the matched posterior."""
    mean_plus, cov_plus = np.empty(3), np.empty((3, 3))
    pi = posterior_moments(
        np.asarray(mean, dtype=float), np.asarray(cov, dtype=float), np.asarray(lower, dtype=float),
        np.asarray(upper, dtype=float), gamma, mean_plus, cov_plus,
    )  # fmt: skip
    return pi, mean_plus, cov_plus


def masses(mean, cov, lower, upper, gamma: float, iterations: int) -> list[float]:
    """The mass in the box before and after each projection, until it is gamma or more."""
    chain = []
    for _ in range(iterations):
        before, mean, cov = update(mean, cov, lower, upper, gamma)
        chain.append(before)
        if before >= gamma:
            return chain
    return [*chain, _mass(mean, cov, lower, upper)]


def study_remark(
    rng: np.random.Generator, gammas: tuple[float, ...], gamma: float, boxes: int
) -> list[Remark]:
    """Exact moments at each of `gammas`, then at `gamma` the ways that the proof does not cover."""
    drawn = list(_boxes(rng, boxes))
    rows = []
    for level in gammas:
        chains = [masses(*box, gamma=level, iterations=5) for box in drawn]
        chains = [chain for chain in chains if len(chain) > 1]
        last = [chain[-1] for chain in chains]
        rows.append(_remark("exact moments", level, [(c[0], c[1]) for c in chains], last))
    for samples in (1000, 100):
        pairs = [_sampled(box, gamma, samples, rng.random(3)) for box in drawn]
        rows.append(_remark(f"moments from {samples} samples", gamma, pairs))
    for attitude in (0.1, 2.0):
        pairs = [_in_filter(rng, attitude, gamma) for _ in range(boxes)]
        rows.append(_remark(f"in the filter, attitude known to {attitude:g} rad", gamma, pairs))
    return rows


def study_iterations(
    study: Study,
    iterations: tuple[int, ...] = ITERATIONS,
    tell: Callable[[float], None] | None = None,
) -> list[Iterated]:
    """The coverage filters in the paper's two regimes, on the first trials of the paper's rows."""
    truth = true_motion(study)
    regimes = UNBIASED, BIASED
    rows: list[Iterated] = []
    for number, regime in enumerate(regimes):
        settings = beyond_settings(study, regime, study_seed(study, number, 0))
        trials = study_trials(study, truth, regime.test, study.beyond_trials, number)
        filters = [(name, setting) for name, _, _, setting in settings if setting.R is None]
        for name, setting in filters:
            for count in iterations:
                scores = run_batch(study, truth, trials, replace(setting, iterations=count))
                rows.append(Iterated(regime.name, name, count, scores))
                if tell:
                    tell(len(rows) / (len(regimes) * len(filters) * len(iterations)))
    return rows


def _boxes(rng: np.random.Generator, count: int) -> Iterator[tuple]:
    """Boxes wider than `ordinary_boxes` by up to two deviations a side, up to three from the mean,
    so that pi runs from nothing to above gamma.
    """
    means, covs, lowers, uppers = ordinary_boxes(rng, count)
    wider, shift = rng.uniform(0.0, 2.0, (count, 3)), rng.uniform(-2.0, 2.0, (count, 3))
    yield from zip(means, covs, lowers - wider + shift, uppers + wider + shift, strict=True)


def _remark(
    way: str, gamma: float, pairs: list[tuple[float, float]], last: list[float] | None = None
) -> Remark:
    """One row from (pi, pi+) of boxes, those on which pi is nothing or above gamma left out."""
    active = np.array([p for p in pairs if _TINY < p[0] < gamma]).reshape(-1, 2)
    pi, after = active.T
    fails = np.maximum(pi - after, after - gamma)
    worst = int(fails.argmax()) if len(fails) else 0
    five = np.nan
    if last is not None:
        ends = np.array([e for e, p in zip(last, pairs, strict=True) if _TINY < p[0] < gamma])
        five = float(np.mean((ends - pi) / (gamma - pi)))
    return Remark(
        way, gamma, len(pi), float(np.mean(after > pi)), float(np.mean(after <= gamma)),
        float(np.mean((after - pi) / (gamma - pi))), five,
        (float(pi[worst]), float(after[worst])) if len(fails) and fails[worst] >= 0 else None,
    )  # fmt: skip


def _sampled(box: tuple, gamma: float, samples: int, shift: np.ndarray) -> tuple[float, float]:
    """Exact pi and pi+ of an update whose own moments come from samples, as the paper's do."""
    mean, cov, lower, upper = box
    m, C = np.empty(3), np.empty((3, 3))
    pi = _mass(mean, cov, lower, upper)
    if not _TINY < pi < gamma:
        return pi, pi
    p = qmc_moments(mean, cov, lower, upper, samples, shift, m, C)
    if p >= gamma:
        return 0.0, 0.0  # the sampled update is not active
    alpha, between = (gamma - p) / (1.0 - p), np.outer(m - mean, m - mean)
    mean_plus = mean + alpha * (m - mean)
    cov_plus = cov + alpha * (C - cov + (1.0 - alpha) * between)
    return pi, _mass(mean_plus, cov_plus, lower, upper)


def _in_filter(rng: np.random.Generator, attitude: float, gamma: float) -> tuple[float, float]:
    """pi and pi+ of an update of a whole state whose attitude has that deviation [rad]."""
    A = rng.standard_normal((15, 15)) / np.sqrt(15)
    spread = np.r_[np.full(3, attitude), np.full(12, 0.1)]
    P = (0.9 * A @ A.T + 0.1 * np.eye(15)) * np.outer(spread, spread)
    mean = NavState(lie.so3_exp(rng.normal(size=3)), 0.8 * rng.normal(size=3)).pack()
    v_I = mean[:3].T @ mean[3] + 0.1 * rng.normal(size=3)
    epsilon = rng.uniform(0.05, 0.4, 3)
    pi = update_coverage(mean, P, 0, v_I, epsilon, gamma)
    PHt, S, residual = np.empty((15, 3)), np.empty((3, 3)), np.empty(3)
    velocity_output(mean, P, 0, v_I, PHt, S, residual)
    return pi, _mass(np.zeros(3), S, residual - epsilon, residual + epsilon)


def _mass(mean, cov, lower, upper) -> float:
    return float(np.exp(box_moments(mean, cov, lower, upper)[0]))
