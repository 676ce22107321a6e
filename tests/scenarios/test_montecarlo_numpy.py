"""The study's EKF against a plain numpy filter of textbook formulas, in numbers and in time."""

from dataclasses import replace
from time import perf_counter

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from scenarios.montecarlo_batch import Setting, run_batch
from scenarios.montecarlo_study import BIASED, Study, load_study
from scenarios.montecarlo_trials import Trials, Truth, make_trials, true_motion

G = np.array([0.0, 0.0, -9.81])


def hat(x: np.ndarray) -> np.ndarray:
    return np.array([[0.0, -x[2], x[1]], [x[2], 0.0, -x[0]], [-x[1], x[0], 0.0]])


def numpy_trial(study: Study, truth: Truth, trials: Trials, k: int, R_noise) -> np.ndarray:
    """Distances (L,) [m] of trial k by the right-invariant EKF of Hartley (2020), step by step.

    The mean takes the sample as held over the step to second order, the covariance the
    continuous error dynamics A to third order in dt.
    """
    mean, P = trials.means[k].copy(), trials.covariance.copy()
    R, v, p, b_a, b_g = mean[:3], mean[3], mean[4], mean[5], mean[6]
    dt = 1.0 / study.imu_rate
    A = np.zeros((15, 15))
    A[3:6, :3], A[6:9, 3:6] = hat(G), np.eye(3)
    Q = np.diag(np.repeat([study.imu.gyro**2, study.imu.accel**2], 3))
    out = []
    for n in range(1, study.samples + 1):
        w, a = trials.gyro[k, n] - b_g, trials.accel[k, n] - b_a
        A[:3, 12:], A[3:6, 12:], A[6:9, 12:] = -R, -hat(v) @ R, -hat(p) @ R
        A[3:6, 9:12] = -R
        step = A * dt
        Phi = np.eye(15) + step + step @ step / 2.0 + step @ step @ step / 6.0
        B = np.zeros((15, 6))
        B[:9, :3], B[3:6, 3:] = A[:9, 12:], A[3:6, 9:12]
        P = Phi @ (P + B @ Q @ B.T * dt) @ Phi.T
        turned = a + 0.5 * dt * np.cross(w, a)
        p = p + v * dt + 0.5 * dt * dt * (G + R @ a)
        v = v + dt * (G + R @ turned)
        R = R @ Rotation.from_rotvec(w * dt).as_matrix()
        if n % study.per_update == 0:
            H = np.zeros((3, 15))
            H[:, 3:6] = -R.T
            S = H @ P @ H.T + R_noise
            K = np.linalg.solve(S, H @ P).T
            delta = K @ (trials.v_I[k, n // study.per_update - 1] - R.T @ v)
            P = (np.eye(15) - K @ H) @ P
            xi = np.zeros((5, 5))
            xi[:3, :3], xi[:3, 3], xi[:3, 4] = hat(delta[:3]), delta[3:6], delta[6:9]
            X = np.eye(5)
            X[:3, :3], X[:3, 3], X[:3, 4] = R, v, p
            X = expm(-xi) @ X
            R, v, p = X[:3, :3], X[:3, 3], X[:3, 4]
            b_a, b_g = b_a - delta[9:12], b_g - delta[12:]
        if n % study.per_score == 0:
            out.append(np.linalg.norm(p - truth.p_GI[n]))
    return np.array(out)


def made(duration: float, count: int):
    study = replace(load_study(), duration=duration)
    truth = true_motion(study)
    seeds = np.random.SeedSequence(11).spawn(count)
    return study, truth, make_trials(study, truth, BIASED.test, seeds)


def test_the_ekf_is_the_textbooks():
    study, truth, trials = made(4.0, 2)
    R_noise = np.diag(study.noise**2)
    found = run_batch(study, truth, trials, Setting(R=R_noise)).distance
    for k in range(2):
        plain = numpy_trial(study, truth, trials, k, R_noise)
        # The integrators differ by what second order leaves of a step: far below a millimetre.
        assert np.abs(found[k] - plain).max() < 5e-4


@pytest.mark.slow
def test_the_batch_is_thirty_times_as_fast_as_numpy_a_trial_at_a_time():
    study, truth, trials = made(20.0, 40)
    setting = Setting(R=np.diag(study.noise**2))
    run_batch(study, truth, trials, setting)
    batch, plain = [], []
    for _ in range(3):
        started = perf_counter()
        run_batch(study, truth, trials, setting)
        batch.append((perf_counter() - started) / 40)
        started = perf_counter()
        numpy_trial(study, truth, trials, 0, setting.R)
        plain.append(perf_counter() - started)
    print(f"EKF, one trial: numpy over batch {min(plain) / min(batch):.0f}x")
    assert min(plain) > 30.0 * min(batch)
