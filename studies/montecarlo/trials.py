"""The trials: a true motion, IMU samples and velocity pseudo-measurements, all trials at once."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from studies.montecarlo.settings import ErrorLaw, MonteCarloStudy, TrotMotion
from surefoot.estimator import gammas, retract, start_covariance
from surefoot.extend import GRAVITY, NavState, kernel


@dataclass(frozen=True)
class Truth:
    """The motion that all trials share, and the ideal IMU samples that reproduce it exactly.

    t (N+1,) [s]; R_GI (N+1, 3, 3), v_GI and p_GI (N+1, 3) in G; gyro and accel (N+1, 3) in I, row
    k over (t[k-1], t[k]] and row 0 unused.
    """

    t: np.ndarray
    R_GI: np.ndarray
    v_GI: np.ndarray
    p_GI: np.ndarray
    gyro: np.ndarray
    accel: np.ndarray

    def state(self, k: int = 0) -> NavState:
        """The true state at row k; biases are zero."""
        return NavState(self.R_GI[k], self.v_GI[k], self.p_GI[k])


@dataclass(frozen=True)
class Trials:
    """T trials: readings and initial states.

    gyro and accel (T, N+1, 3); v_I (T, M, 3) [m/s] after every N/M-th sample; means (T, 7, 3)
    packed starts and their covariance (15, 15), from which they were drawn.
    """

    gyro: np.ndarray
    accel: np.ndarray
    v_I: np.ndarray
    means: np.ndarray
    covariance: np.ndarray


def true_motion(study: MonteCarloStudy) -> Truth:
    """The base motion of the study, with the samples of a perfect IMU."""
    t = np.arange(study.samples + 1) / study.imu_rate
    R, v = _attitude_and_velocity(study.motion, t)
    gyro, accel, p = np.zeros_like(v), np.zeros_like(v), np.zeros_like(v)
    dt = 1.0 / study.imu_rate
    turns = Rotation.from_matrix(np.swapaxes(R[:-1], 1, 2) @ R[1:]).as_rotvec()
    _invert_imu(R, v, turns, dt, gyro, accel, p)
    return Truth(t, R, v, p, gyro, accel)


def make_trials(study: MonteCarloStudy, truth: Truth, law: ErrorLaw, seeds: Sequence) -> Trials:
    """One trial for each seed (SeedSequence); a trial depends on its own seed alone."""
    n = len(truth.t)
    T = len(seeds)
    gyro, accel = np.empty((T, n, 3)), np.empty((T, n, 3))
    v_I, means = np.empty((T, study.updates, 3)), np.empty((T, 7, 3))
    covariance = start_covariance(truth.state(), study.prior)
    factor = np.linalg.cholesky(covariance)
    rows = np.arange(1, study.updates + 1) * study.per_update
    true_v_I = np.einsum("nji,nj->ni", truth.R_GI[rows], truth.v_GI[rows])
    imu = study.imu
    start = truth.state().pack()
    start[5], start[6] = imu.bias_accel, imu.bias_gyro
    root = np.sqrt(study.imu_rate)
    for k, seed in enumerate(seeds):
        rng = np.random.default_rng(seed)
        gyro[k] = truth.gyro + imu.bias_gyro + imu.gyro * root * rng.standard_normal((n, 3))
        accel[k] = truth.accel + imu.bias_accel + imu.accel * root * rng.standard_normal((n, 3))
        means[k] = start
        # The initial mean has an error drawn from the covariance: X_bar = exp(xi^) X.
        retract(means[k], -(factor @ rng.standard_normal(15)), 0)
        v_I[k] = true_v_I + velocity_errors(study, law, study.updates, rng)
    return Trials(gyro, accel, v_I, means, covariance)


def velocity_errors(
    study: MonteCarloStudy, law: ErrorLaw, count: int, rng: np.random.Generator
) -> np.ndarray:
    """Errors (count, 3) [m/s] of one trial: a component kept throughout, and noise."""
    if law.bias == 0.0:
        persistent, factor = np.zeros((1, 3)), np.diag(study.noise_std)
    else:
        component = rng.choice(len(study.weights), p=study.weights)
        persistent, factor = law.bias * study.means[component][None], study.factors[component]
        if law.drift > 0.0:
            second = np.einsum("c,ci,cj->ij", study.weights, study.means, study.means)
            steps = rng.standard_normal((count, 3)) @ np.linalg.cholesky(second).T
            persistent = law.bias * _gauss_markov(steps, 1.0 / (study.update_rate * law.drift))
    return law.scale * (persistent + _mixing(law.mixing, count, rng) @ factor.T)


def population(study: MonteCarloStudy, law: ErrorLaw, rng: np.random.Generator) -> np.ndarray:
    """`study.population` errors (P, 3) from many trials, 100 of each."""
    parts = study.population // 100
    # A drifting part starts from its stationary distribution, so short pieces suffice.
    return np.concatenate([velocity_errors(study, law, 100, rng) for _ in range(parts)])


def _mixing(kind: str, count: int, rng: np.random.Generator) -> np.ndarray:
    """Independent draws (count, 3) of zero mean and unit variance, plus that of outliers."""
    normal = rng.standard_normal((count, 3))
    if kind == "student":
        return normal / np.sqrt(rng.chisquare(3, (count, 1)))
    if kind == "skewed":
        return rng.standard_exponential((count, 3)) - 1.0
    if kind == "bimodal":
        sign = rng.integers(0, 2, (count, 3)) * 2.0 - 1.0
        return 0.9 * sign + np.sqrt(1.0 - 0.81) * normal
    if kind == "outliers":
        return normal * np.where(rng.random((count, 1)) < 0.05, 10.0, 1.0)
    return normal


@kernel
def _gauss_markov(steps, rate: float):
    """A stationary process (M, 3) with the covariance of `steps` and correlation exp(-rate) per
    step.
    """
    keep = np.exp(-rate)
    scale = np.sqrt(1.0 - keep * keep)
    out = steps.copy()
    for k in range(1, steps.shape[0]):
        out[k] = keep * out[k - 1] + scale * steps[k]
    return out


def _attitude_and_velocity(motion: TrotMotion, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """R_GI (N, 3, 3) and v_GI (N, 3) at t (N,): yaw of the course, roll and pitch of the gait."""
    turn = 2 * np.pi / motion.turn_period
    yaw = motion.turn * t + motion.turn_swing / turn * (1.0 - np.cos(turn * t))
    gait = 2 * np.pi * motion.stride
    angles = [yaw, motion.pitch * np.sin(2 * gait * t), motion.roll * np.sin(gait * t)]
    R = Rotation.from_euler("ZYX", np.stack(angles, axis=1)).as_matrix()
    forward = motion.speed + motion.speed_swing * np.sin(2 * np.pi * t / motion.speed_period)
    forward = forward + 2 * gait * motion.surge * np.cos(2 * gait * t)
    lateral = gait * motion.sway * np.cos(gait * t)
    up = 2 * gait * motion.bob * np.cos(2 * gait * t)
    c, s = np.cos(yaw), np.sin(yaw)
    return R, np.stack([c * forward - s * lateral, s * forward + c * lateral, up], axis=1)


@kernel
def _invert_imu(R, v, turns, dt: float, gyro, accel, p):
    """Compute the samples with which `estimator.core.propagation` reproduces R and v.

    v' = v + g dt + R Gamma_1 a dt is solved for a; p' follows with Gamma_2.

    Args:
        R: (N+1, 3, 3), I to G.
        v: (N+1, 3) [m/s] in G.
        turns: (N, 3) [rad] in I, rotation vector of each step.
        dt: the step [s].
        gyro: (N+1, 3) [rad/s], filled from row 1.
        accel: (N+1, 3) [m/s^2], filled from row 1.
        p: (N+1, 3) [m] in G, filled from row 1 with the propagated position.
    """
    G0, G1, G2 = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    g = np.array([0.0, 0.0, -GRAVITY])
    for k in range(len(turns)):
        gyro[k + 1] = turns[k] / dt
        gammas(turns[k], G0, G1, G2)
        change = R[k].copy().T @ ((v[k + 1] - v[k]) / dt - g)
        a = np.linalg.solve(G1, change)
        accel[k + 1] = a
        p[k + 1] = p[k] + v[k] * dt + 0.5 * g * dt * dt + R[k] @ (G2 @ a) * dt * dt
