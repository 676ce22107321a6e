"""Noise of a reference's samples, estimated by a smoother over IMU and poses.

Relative to the IMU's integrals (`sim.log.reference_vs_imu`), the path of a tracked point varies
slowly: initial position and velocity, a force that drifts with tilt and bias, and a lever arm that
rotates with the body. The rest of a sample is the noise of its position, and its velocity times the
error of its stamp. The noise levels are found by maximum likelihood of a Kalman filter with the
states position, velocity, drift and lever arm; a Rauch-Tung-Striebel smoother then re-estimates
every stamp (Bar-Shalom et al., Estimation with Applications to Tracking and Navigation, 2001, ch.
8).
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from surefoot.sim.common.kernels import kernel
from surefoot.sim.log.derived import REFERENCE_WINDOW, derivative
from surefoot.sim.log.reference import Poses
from surefoot.sim.log.reference_vs_imu import ReferenceVsImu, compare_with_imu

FEWEST_SAMPLES = 100
"""Least number of samples for an estimate."""
_LONGEST = 4000
"""Number of samples used, from the middle of a longer reference."""
_LEVER = 0.3
"""Prior standard deviation of each coordinate of the lever arm [m]."""
_DRIFT = 0.3
"""Prior standard deviation of the drift of the force, from bias and tilt [m/s^2]."""
_WANDER = 0.05
"""Random walk of this drift [m/s^2/sqrt(s)]: errors of a walking body's tilt of a few tenths of a
degree.
"""
_START = (1e-3, 2e-3, 0.1)
"""Initial values of the search: position [m], stamp [s] and force [m/s^2/sqrt(Hz)]."""
_SMALLEST = np.array([1e-5, 1e-5, 1e-3])
"""Lower limits of these values."""

_TURN_WINDOW = 0.08
"""Interval over which angular rates are compared [s]: short compared with a stride, some samples
long.
"""
_MOST_MISSED_ROTATION = 0.5
"""Share of the gyro's rotation that a reference may miss; beyond it, it belongs to another body
or clock. Noise of a walking robot's motion capture leaves a few hundredths.
"""


@dataclass(frozen=True)
class ReferenceNoise:
    """Noise of a reference.

    Attributes:
        position: standard deviation of a sample's position [m].
        stamp: standard deviation of a sample's stamp [s].
        angle: standard deviation of a sample's attitude [rad].
        innovation: standard deviation of the prediction error from one sample to the next [m].
        correction: RMS of the corrections of the stamps [s].
    """

    position: float
    stamp: float
    angle: float
    innovation: float
    correction: float

    @property
    def line(self) -> str:
        """The result in words."""
        return (
            f"reference compared with the IMU: noise of {1e3 * self.position:.2g} mm, "
            f"{np.degrees(self.angle):.2g} deg and {1e3 * self.stamp:.2g} ms; a smoother over both "
            f"corrects stamps by {1e3 * self.correction:.2g} ms and predicts a sample to "
            f"{1e3 * self.innovation:.2g} mm"
        )


def reference_noise(
    t: np.ndarray, gyro: np.ndarray, accel: np.ndarray, poses: Poses
) -> ReferenceNoise | None:
    """Estimate the noise of a reference's samples.

    None where there are too few, or where it does not rotate like the IMU.

    Args:
        t: (N,) of the IMU's rows [s].
        gyro: (N, 3) [rad/s], mean over the step before each row.
        accel: (N, 3) [m/s^2], likewise.
        poses: with the attitude of the IMU frame; the tracked point may be elsewhere on the body.
    """
    poses = poses.rows((poses.t > t[1]) & (poses.t < t[-1]))
    extra = max(len(poses.t) - _LONGEST, 0) // 2
    poses = poses.rows(slice(extra, extra + _LONGEST))
    beside = matching_imu(t, gyro, accel, poses)
    if beside is None:
        return None
    velocity = derivative(poses.t, poses.p, REFERENCE_WINDOW, causal=False)
    tables = (np.diff(poses.t, prepend=poses.t[0]), beside.path - beside.path[0])
    tables += (np.ascontiguousarray(beside.R_GI), velocity)

    def unlikely(log_sizes: np.ndarray) -> float:
        # Without noise the likelihood has no maximum; constant below the limits, it lets the
        # search end.
        return _filtered(*tables, *np.maximum(np.exp(log_sizes), _SMALLEST))[0]

    enough = {"xatol": 0.03, "fatol": 0.1}
    best = minimize(unlikely, np.log(_START), method="Nelder-Mead", options=enough)
    position, stamp, force = np.maximum(np.exp(best.x), _SMALLEST)
    _, innovation, states = _filtered(*tables, position, stamp, force)
    rest = _smoothed_rest(*tables[:3], force, *states)
    along = np.sum(rest * velocity, axis=1)
    corrections = stamp**2 * along / (position**2 + stamp**2 * np.sum(velocity**2, axis=1))
    return ReferenceNoise(
        position=float(position),
        stamp=float(stamp),
        angle=_angle(beside, stamp),
        innovation=float(np.sqrt(np.mean(innovation[1:] ** 2))),
        correction=float(np.sqrt(np.mean(corrections**2))),
    )


def matching_imu(
    t: np.ndarray, gyro: np.ndarray, accel: np.ndarray, poses: Poses
) -> ReferenceVsImu | None:
    """Poses of the IMU frame, within the times of the IMU's rows, relative to the IMU's integrals;
    None where they are too few, or do not rotate like the IMU.

    Args:
        t: (N,) of the IMU's rows [s].
        gyro: (N, 3) [rad/s], mean over the step before each row.
        accel: (N, 3) [m/s^2], likewise.
        poses: of the IMU frame.
    """
    if len(poses.t) < FEWEST_SAMPLES:
        return None
    beside = compare_with_imu(t, gyro, accel, poses)
    return beside if missed_rotation(beside) <= _MOST_MISSED_ROTATION else None


def missed_rotation(beside: ReferenceVsImu) -> float:
    """Share of the gyro's rotation that the reference does not have; over 1 for another body's."""
    other = derivative(beside.t, beside.turn, _TURN_WINDOW, causal=False)
    turning = np.sum(np.var(beside.omega, axis=0))
    return float(np.sum(np.var(other, axis=0)) / max(turning, 1e-12))


def _angle(beside: ReferenceVsImu, stamp: float) -> float:
    """Standard deviation of a sample's attitude [rad], about each axis.

    From the changes, between samples, of its rotation relative to the gyro's integral, less the
    contribution of the stamp's error [s].
    """
    square = np.sort(np.sum(np.diff(beside.turn, axis=0) ** 2, axis=1)) / 6.0
    by_stamps = stamp**2 * np.mean(np.sum(beside.omega**2, axis=1)) / 3.0
    # Up to 1 % of the samples may belong to another body.
    most = square[: int(np.ceil(0.99 * len(square)))].mean()
    return float(np.sqrt(max(most - by_stamps, 0.0)))


@kernel
def _transition(dt, force):
    """Transition and process noise (12, 12) over dt [s]; `force` is the density of its white
    part.
    """
    F, Q = np.eye(12), np.zeros((12, 12))
    for i in range(3):
        F[i, 3 + i], F[i, 6 + i], F[3 + i, 6 + i] = dt, 0.5 * dt * dt, dt
        Q[i, i], Q[3 + i, 3 + i] = force**2 * dt**3 / 3.0, force**2 * dt
        Q[i, 3 + i] = Q[3 + i, i] = force**2 * dt**2 / 2.0
        Q[6 + i, 6 + i] = _WANDER**2 * dt
    return F, Q


@kernel
def _filtered(dt, path, R_GI, velocity, position, stamp, force):
    """Kalman filter: negative log-likelihood, innovations (K, 3) [m], and the states for the
    smoother.

    The states are means (K, 12) and covariances (K, 12, 12), predicted and updated.

    Args:
        dt: (K,) since the sample before [s].
        path: (K, 3) of the samples relative to the IMU's [m].
        R_GI: (K, 3, 3).
        velocity: (K, 3) of the tracked point in G [m/s].
        position: standard deviation of a sample [m].
        stamp: standard deviation of its time [s].
        force: density of other accelerations of the path [m/s^2/sqrt(Hz)].
    """
    count = len(dt)
    x, P = np.zeros(12), np.zeros((12, 12))
    for i in range(3):
        P[i, i], P[3 + i, 3 + i] = _LEVER**2, 1.0
        P[6 + i, 6 + i], P[9 + i, 9 + i] = _DRIFT**2, _LEVER**2
    means, covariances = np.empty((2, count, 12)), np.empty((2, count, 12, 12))
    innovation = np.empty((count, 3))
    H, unlikely = np.zeros((3, 12)), 0.0
    H[:, :3] = np.eye(3)
    for k in range(count):
        F, Q = _transition(dt[k], force)
        x = F @ x
        P = F @ P @ F.T + Q
        means[0, k], covariances[0, k] = x, P
        H[:, 9:] = R_GI[k]
        v = velocity[k]
        N = position**2 * np.eye(3) + stamp**2 * np.outer(v, v)
        S = H @ P @ H.T + N
        e = path[k] - H @ x
        gain = np.ascontiguousarray(np.linalg.solve(S, H @ P).T)
        x = x + gain @ e
        # Joseph's form, which stays positive definite under rounding.
        keep = np.eye(12) - gain @ H
        P = keep @ P @ keep.T + gain @ N @ gain.T
        means[1, k], covariances[1, k] = x, P
        innovation[k] = e
        unlikely += 0.5 * (np.log(np.linalg.det(S)) + e @ np.linalg.solve(S, e))
    return unlikely, innovation, (means, covariances)


@kernel
def _smoothed_rest(dt, path, R_GI, force, means, covariances):
    """Residuals of the samples from the smoothed path (K, 3) [m].

    Args:
        dt: (K,) since the sample before [s].
        path: (K, 3) of the samples relative to the IMU's [m].
        R_GI: (K, 3, 3).
        force: density of other accelerations of the path [m/s^2/sqrt(Hz)].
        means: of the states, predicted and updated (2, K, 12).
        covariances: of the states (2, K, 12, 12).
    """
    rest = np.empty_like(path)
    x = means[1, -1].copy()
    for back in range(len(dt)):
        k = len(dt) - 1 - back
        if back > 0:
            F, _ = _transition(dt[k + 1], force)
            gain = np.linalg.solve(covariances[0, k + 1], F @ covariances[1, k]).T
            x = means[1, k] + np.ascontiguousarray(gain) @ (x - means[0, k + 1])
        rest[k] = path[k] - x[:3] - np.ascontiguousarray(R_GI[k]) @ x[9:]
    return rest
