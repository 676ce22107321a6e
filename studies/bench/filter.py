"""Run time of a filter step, compared with the paper's sampling and with gtsam's filter."""

from dataclasses import replace

import numpy as np
import torch

from studies.bench.ratio import SAMPLES, Progress, Ratio, in_turn
from studies.montecarlo.qmc import ordinary_boxes, qmc_moments
from studies.montecarlo.settings import UNBIASED, load_study
from studies.montecarlo.trials import make_trials, true_motion
from surefoot import Observer
from surefoot.estimator import (
    EXTRA,
    FLOOR,
    hat,
    lift,
    propagate,
    update_coverage,
    velocity_memory,
    velocity_output,
)
from surefoot.extend import ARCHITECTURES, GRAVITY, FilterNoise, InvariantFilter, NavState, kernel
from surefoot.models.observer.network import Network

BENCH_GAMMA, FILTER_STEPS = 0.8, 200
PYTHON_STEPS = 2000
"""Number of steps from Python, large enough that constructing the filter is negligible."""


def trial(steps: int = FILTER_STEPS):
    """The Monte-Carlo study's walk at 200 Hz, one second of it, with a velocity for every
    sample.
    """
    study = load_study()
    study = replace(study, duration=steps / study.imu_rate, update_rate=study.imu_rate)
    truth = true_motion(study)
    trials = make_trials(study, truth, UNBIASED.test, np.random.SeedSequence(4).spawn(1))
    return study, truth, trials


def coverage_row(rounds: int, progress: Progress | None = None) -> Ratio:
    """Predict and coverage update, compiled, compared with the same two with sampled moments."""
    study, truth, trials = trial()
    noise = FilterNoise(study.imu.gyro, study.imu.accel, 0.0, 0.0).packed()
    # 1.8 deviations per axis contain 0.8 of a Gaussian error jointly.
    epsilon = 1.8 * study.noise_std
    shifts = np.random.default_rng(6).random((FILTER_STEPS, 3))

    def run(samples: int):
        mean, covariance = trials.means[0].copy(), trials.covariance.copy()
        log = truth.t, trials.gyro[0], trials.accel[0], trials.v_I[0]
        run_updates(*log, epsilon, mean, covariance, noise, velocity_memory(), shifts, samples)
        return mean

    ours, theirs = in_turn(lambda: run(0), lambda: run(SAMPLES), rounds, progress)
    return Ratio(
        "predict + coverage update",
        f"the same filter with QMC, N = {SAMPLES}",
        theirs / ours,
        10.0,
        f"{1e6 * ours / FILTER_STEPS:.1f} us a step",
    )


@kernel
def run_updates(
    t, gyro, accel, v_I, epsilon, mean, covariance, noise, memory, shifts, samples: int
):  # fmt: skip
    """Run the filter over a log with an update at every sample, in place.

    Args:
        t: (N,) [s].
        gyro: (N, 3) [rad/s] in I.
        accel: (N, 3) [m/s^2] in I.
        v_I: (N-1, 3) [m/s] in I.
        epsilon: (3,) [m/s], bounds of v_I.
        mean: (7, 3), the packed mean.
        covariance: (15, 15).
        noise: (4, 3), `FilterNoise.packed`.
        memory: VelocityMemory.
        shifts: (N-1, 3) in [0, 1), of the lattices.
        samples: of the moments; 0 for exact ones.
    """
    columns, rotation_columns = np.zeros((15, 6)), np.zeros((0, 3))
    for k in range(1, t.shape[0]):
        dt = t[k] - t[k - 1]
        propagate(mean, covariance, gyro[k], accel[k], dt, noise, columns, rotation_columns)
        if samples == 0:
            update_coverage(mean, covariance, v_I[k - 1], epsilon, BENCH_GAMMA, 1, memory)
        else:
            sampled_update(mean, covariance, v_I[k - 1], epsilon, samples, shifts[k - 1])


@kernel
def sampled_update(mean, covariance, v_I, epsilon, samples: int, shift):
    """`estimator.updates.coverage.update_coverage` with moments from samples.

    Args:
        mean: (7, 3), the packed mean, in place.
        covariance: (15, 15), in place.
        v_I: (3,) [m/s] in I.
        epsilon: (3,) [m/s], its bounds.
        samples: of the moments.
        shift: (3,) in [0, 1), of the lattice.
    """
    PHt, S, residual = np.empty((15, 3)), np.empty((3, 3)), np.empty(3)
    velocity_output(mean, covariance, 0, v_I, PHt, S, residual)
    floor = FLOOR**2 + 1e-10 * (S[0, 0] + S[1, 1] + S[2, 2])
    for i in range(3):
        S[i, i] += floor
    z_mean, z_cov = np.empty(3), np.empty((3, 3))
    lower, upper = residual - epsilon, residual + epsilon
    pi = qmc_moments(np.zeros(3), S, lower, upper, samples, shift, z_mean, z_cov)
    if pi < BENCH_GAMMA:
        alpha = (BENCH_GAMMA - pi) / (1.0 - pi)
        for i in range(3):
            for j in range(3):
                between = (1.0 - alpha) * z_mean[i] * z_mean[j]
                z_cov[i, j] = S[i, j] + alpha * (z_cov[i, j] - S[i, j] + between)
        lift(mean, covariance, 0, PHt, S, alpha * z_mean, z_cov)


def step_row(rounds: int, progress: Progress | None = None) -> Ratio:
    """Observer, predict and coverage update, one Python call each, compared with the sampling
    alone.
    """
    study, _, trials = trial()
    running = untrained_observer().running()
    x = np.random.default_rng(7).standard_normal((FILTER_STEPS, 36))
    epsilon, dt = 1.8 * study.noise_std, 1.0 / study.imu_rate
    noise = FilterNoise(study.imu.gyro, study.imu.accel, 0.0, 0.0)
    state, covariance = NavState.unpack(trials.means[0, :EXTRA]), trials.covariance

    def ours():
        f = InvariantFilter(state, covariance, noise)
        for k in range(FILTER_STEPS):
            running(x[k : k + 1])
            f.predict(trials.gyro[0, k + 1], trials.accel[0, k + 1], dt)
            # The network is untrained, so the trial's velocity replaces its output.
            f.update_coverage(trials.v_I[0, k], epsilon, BENCH_GAMMA)

    boxes = list(zip(*ordinary_boxes(np.random.default_rng(8), FILTER_STEPS), strict=True))
    shift, mean, cov = np.full(3, 0.3), np.empty(3), np.empty((3, 3))

    def theirs():
        for box in boxes:
            qmc_moments(*box, SAMPLES, shift, mean, cov)

    fast, slow = in_turn(ours, theirs, rounds, progress)
    return Ratio(
        "whole step from Python: observer + predict + coverage",
        f"QMC, N = {SAMPLES}, alone",
        slow / fast,
        1.0,
        f"{1e6 * fast / FILTER_STEPS:.0f} us a step",
    )


def untrained_observer(inputs: int = 36) -> Observer:
    """A GRU of the usual size (q, dq and tau of 12 joints) with initial weights."""
    width = ARCHITECTURES["gru"].width
    network = Network("gru", inputs, 3, width)
    network.initialise(torch.Generator().manual_seed(0))
    return Observer(
        model="gru",
        width=width,
        weights={name: weight.numpy() for name, weight in network.state_dict().items()},
        inputs=("q", "dq", "tau"),
        joints=tuple(f"joint_{k}" for k in range(inputs // 3)),
        input_mean=np.zeros(inputs),
        input_scale=np.ones(inputs),
        output_mean=np.zeros(3),
        output_scale=np.ones(3),
        robot="none",
        p_BI=np.zeros(3),
        R_BI=np.eye(3),
        loss="mse",
        logs=(),
        seed=0,
        rate=100.0,
        rmse=np.ones(3),
        errors=np.zeros((1, 3)),
    )


def gtsam_row(rounds: int, progress: Progress | None = None) -> Ratio:
    """Predict and Gaussian velocity update, one sample at a time from Python, compared with
    gtsam.
    """
    what, against = "predict + velocity update from Python", "gtsam NavStateImuEKF"
    try:
        import gtsam  # pyright: ignore[reportMissingImports]
    except ImportError:
        return Ratio(what, against, None, 5.0, "not installed: the extra surefoot[gtsam]")
    ours, theirs = velocity_filter(), gtsam_filter(gtsam)
    fast, slow = in_turn(ours, theirs, rounds, progress)
    ours_us, theirs_us = 1e6 * fast / PYTHON_STEPS, 1e6 * slow / PYTHON_STEPS
    note = f"{ours_us:.1f} against {theirs_us:.1f} us a step; gtsam's state has "
    return Ratio(what, against, slow / fast, 5.0, note + "no biases (9 errors), ours has (15)")


def velocity_filter():
    """Function that runs our filter over the trial and returns its last v_I (3,)."""
    study, _, trials = trial(PYTHON_STEPS)
    noise = FilterNoise(study.imu.gyro, study.imu.accel, 0.0, 0.0)
    R, dt = np.diag(study.noise_std**2), 1.0 / study.imu_rate
    state = replace(
        NavState.unpack(trials.means[0, :EXTRA]), b_a=study.imu.bias_accel, b_g=study.imu.bias_gyro
    )
    covariance = trials.covariance.copy()
    # Practically known biases, as in gtsam.
    covariance[9:, :] = covariance[:, 9:] = 0.0
    covariance[9:, 9:] = 1e-16 * np.eye(6)

    gyro, accel, v_I = trials.gyro[0], trials.accel[0], trials.v_I[0]

    def run() -> np.ndarray:
        f = InvariantFilter(state, covariance, noise)
        for k in range(PYTHON_STEPS):
            f.predict(gyro[k + 1], accel[k + 1], dt)
            f.update_velocity(v_I[k], R)
        return f.state.v_I

    return run


def gtsam_filter(gtsam):
    """The same for gtsam's filter, whose errors are (rotation, position, velocity) in the body
    frame.
    """
    study, _, trials = trial(PYTHON_STEPS)
    params = gtsam.PreintegrationParams.MakeSharedU(GRAVITY)
    params.setGyroscopeCovariance(study.imu.gyro**2 * np.eye(3))
    params.setAccelerometerCovariance(study.imu.accel**2 * np.eye(3))
    params.setIntegrationCovariance(1e-12 * np.eye(3))
    start = trials.means[0]
    X = gtsam.NavState(gtsam.Rot3(start[:3]), start[4], start[3])
    # From the right-invariant error to gtsam's: rotated, with the lever arms of v and p.
    R, dt = np.diag(study.noise_std**2), 1.0 / study.imu_rate
    T = np.zeros((9, 9))
    for row, column, lever in ((0, 0, None), (3, 6, start[4]), (6, 3, start[3])):
        T[row : row + 3, column : column + 3] = -start[:3].T
        if lever is not None:
            T[row : row + 3, :3] = start[:3].T @ hat(lever)
    covariance = T @ trials.covariance[:9, :9] @ T.T
    gyro, accel = trials.gyro[0] - study.imu.bias_gyro, trials.accel[0] - study.imu.bias_accel
    v_I = trials.v_I[0]
    H = np.zeros((3, 9))
    H[:, 6:] = np.eye(3)

    def run() -> np.ndarray:
        f = gtsam.NavStateImuEKF(X, covariance, params)
        for k in range(PYTHON_STEPS):
            f.predict(gyro[k + 1], accel[k + 1], dt)
            predicted = f.state().bodyVelocity()
            x, y, z = predicted.tolist()
            H[0, 1], H[0, 2], H[1, 0], H[1, 2], H[2, 0], H[2, 1] = -z, y, z, -x, -y, x
            f.updateWithVector(predicted, H, v_I[k], R)
        return f.state().bodyVelocity()

    return run
