"""Many trials of one filter in compiled loops, spread over threads."""

import math
import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from surefoot.estimator.core.propagation import propagate
from surefoot.estimator.core.state import EXTRA, FilterNoise, P
from surefoot.estimator.updates.bias_states import (
    EXTRAS,
    NONE,
    PersistentError,
    propagate_bias,
    update_coverage_persistent,
    update_velocity_persistent,
)
from surefoot.estimator.updates.coverage import FLOOR, update_coverage
from surefoot.estimator.updates.velocity import update_velocity
from surefoot.estimator.updates.velocity_output import velocity_output
from surefoot.scenarios.studies.montecarlo.settings import Study
from surefoot.scenarios.studies.montecarlo.trials import Trials, Truth
from surefoot.sim.common.kernels import kernel

_CHUNK = 5
"""Trials a thread takes at once: few enough for a bar that moves."""


@dataclass(frozen=True)
class Setting:
    """One filter of the study: a Gaussian update with R, or coverage with epsilon at gamma.

    R (3, 3) [m^2/s^2] or None; epsilon (3,) [m/s], gamma the joint level; persistent, None
    without those states: then epsilon bounds the mean of a window; iterations of the projection in
    one coverage update.
    """

    R: np.ndarray | None = None
    epsilon: np.ndarray | None = None
    gamma: float = 0.0
    persistent: PersistentError | None = None
    iterations: int = 1


@dataclass(frozen=True)
class Scores:
    """What T trials gave at L instants (the start is left out), against the truth in G.

    distance (T, L) [m] of the position; nees (T, L) of the position; active (T,) the share of
    updates that changed the state.
    """

    distance: np.ndarray
    nees: np.ndarray
    active: np.ndarray

    def joined(self, more: "Scores") -> "Scores":
        """These trials and those of `more` after them."""
        return Scores(
            np.concatenate([self.distance, more.distance]),
            np.concatenate([self.nees, more.nees]),
            np.concatenate([self.active, more.active]),
        )

    @property
    def rmse(self) -> np.ndarray:
        """Position RMSE (T,) [m] over each trial."""
        return np.sqrt(np.mean(self.distance**2, axis=1))

    @property
    def mean_nees(self) -> np.ndarray:
        """Mean position NEES (T,) over each trial."""
        return self.nees.mean(axis=1)


def run_batch(
    study: Study,
    truth: Truth,
    trials: Trials,
    setting: Setting,
    threads: int | None = None,
) -> Scores:
    """Run one filter over all trials; the numbers are those of `run_coverage`, `run_velocity`.

    Threads (one a core where None) only share the work: the result does not depend on them.
    """
    lasting = setting.persistent
    T, extras = len(trials.gyro), 0 if lasting is None else EXTRAS
    means = np.zeros((T, EXTRA + extras, 3))
    means[:, :EXTRA] = trials.means
    start = trials.covariance if lasting is None else lasting.enter(trials.covariance)
    model = (NONE if lasting is None else lasting.model())[:4]
    true_p = np.ascontiguousarray(truth.p_GI[study.per_score :: study.per_score])
    distance, nees = np.empty((T, len(true_p))), np.empty((T, len(true_p)))
    active = np.empty(T)
    gaussian = setting.R is not None
    R = np.eye(3) if setting.R is None else setting.R
    epsilon = np.ones(3) if setting.epsilon is None else setting.epsilon
    noise = FilterNoise(study.imu.gyro, study.imu.accel, 0.0, 0.0).packed()

    def chunk(first: int) -> None:
        part = slice(first, min(first + _CHUNK, T))
        _run(
            truth.t, trials.gyro[part], trials.accel[part], trials.v_I[part], study.per_update,
            gaussian, np.ascontiguousarray(R), np.ascontiguousarray(epsilon), setting.gamma,
            setting.iterations, means[part], start, noise, true_p, study.per_score,
            distance[part], nees[part], active[part], lasting is not None, *model,
        )  # fmt: skip

    with ThreadPoolExecutor(max_workers=threads or os.cpu_count() or 1) as pool:
        list(pool.map(chunk, range(0, T, _CHUNK)))
    return Scores(distance, nees, active)


@kernel(nogil=True)
def _run(
    t, gyro, accel, v_I, per_update, gaussian, R, epsilon, gamma, iterations, means, start, noise,
    true_p, per_score, distance, nees, active, lasting, prior, time_constant, window, reach,
):  # fmt: skip
    """A chunk of trials, one after the other, into distance, nees and active."""
    n = start.shape[0]
    for trial in range(gyro.shape[0]):
        mean, covariance = means[trial].copy(), start.copy()
        columns, rotation_columns = np.zeros((n, 6)), np.zeros((n - 15, 3))
        counts = np.zeros(2, dtype=np.int64)
        changed = judged = 0
        for k in range(1, t.shape[0]):
            propagate(
                mean, covariance, gyro[trial, k], accel[trial, k], t[k] - t[k - 1], noise,
                columns, rotation_columns,
            )  # fmt: skip
            if lasting:
                propagate_bias(mean, covariance, prior, time_constant, t[k] - t[k - 1])
            if k % per_update == 0:
                m = k // per_update - 1
                v = v_I[trial, m]
                if lasting:
                    if gaussian:
                        pi = update_velocity_persistent(
                            mean, covariance, v, R, window, reach, counts
                        )
                    else:
                        pi = update_coverage_persistent(
                            mean, covariance, v, epsilon, gamma, iterations, window, reach, counts
                        )
                    judged += gaussian or not np.isnan(pi)
                    changed += not np.isnan(pi) if gaussian else pi < gamma
                elif gaussian:
                    update_velocity(mean, covariance, 0, v, R)
                    changed += 1
                elif not _holds_already(mean, covariance, v, epsilon, gamma):
                    pi = update_coverage(mean, covariance, 0, v, epsilon, gamma, iterations)
                    changed += pi < gamma
            if k % per_score == 0:
                m = k // per_score - 1
                error = mean[P] - true_p[m]
                distance[trial, m] = np.sqrt(np.sum(error * error))
                nees[trial, m] = _position_nees(mean[P], error, covariance)
        active[trial] = changed / (judged if lasting else v_I.shape[1])


@kernel(nogil=True)
def _holds_already(mean, covariance, v_I, epsilon, gamma: float) -> bool:
    """Whether pi >= gamma without an integral: the axes' own tails leave gamma inside the box.

    pi >= 1 - sum of the six tails, and the update changes nothing where pi >= gamma.
    """
    n = covariance.shape[0]
    PHt, S, residual = np.empty((n, 3)), np.empty((3, 3)), np.empty(3)
    velocity_output(mean, covariance, 0, v_I, PHt, S, residual)
    floor = FLOOR**2 + 1e-10 * (S[0, 0] + S[1, 1] + S[2, 2])
    outside = 0.0
    for i in range(3):
        spread = math.sqrt(2.0 * (S[i, i] + floor))
        outside += 0.5 * math.erfc((epsilon[i] + residual[i]) / spread)
        outside += 0.5 * math.erfc((epsilon[i] - residual[i]) / spread)
    return 1.0 - outside > gamma + 1e-12


@kernel(nogil=True)
def _position_nees(p, error, covariance) -> float:
    """Squared error over J Sigma J^T, J = [-[p_bar]x 0 I] on (rotation, velocity, position)."""
    J = np.zeros((3, 9))
    J[0, 1], J[0, 2] = p[2], -p[1]
    J[1, 0], J[1, 2] = -p[2], p[0]
    J[2, 0], J[2, 1] = p[1], -p[0]
    for i in range(3):
        J[i, 6 + i] = 1.0
    S = J @ covariance[:9, :9].copy() @ J.T
    return np.sum(error * np.linalg.solve(S, error))
