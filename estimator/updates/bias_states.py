"""The persistent part of an observer's error as three more states, and statements about means.

An observer's errors come in two parts, v_tilde = R_GI^T v + b_p + e: b_p (3,) in I lasts for long
stretches and e mixes. A filter that takes every measurement for news believes that b_p averages
out, which it never does. So b_p joins the state, with the error delta b_p = b_p_bar - b_p, and

    z = H delta X = (v_I + b_p) - (v_I_bar + b_p_bar) to first order,   H = [0 -R^T 0 0 0 -I]

(for the velocity as eq. setup_feasible_set_lie_linear_augmented: it stays right-invariant, as b_p
adds to the output alone). What lasts does so on two scales: over a stretch of ground or a turn, and
over the whole of a course, or for the life of a robot. So b_p is a first-order Gauss-Markov
process, of covariance C and time constant tau, about a constant c of prior covariance C_c that is
three more states,

    b_p <- c + k (b_p - c),    delta b_p <- k delta b_p + (1 - k) delta c,    k = exp(-dt/tau),

with C (1 - k^2) added. tau = inf is a constant; C_c = 0 leaves c at zero. Without c, a filter whose
tau is a few seconds takes a bias of a whole course for a row of independent ones: position
covariance then grows by the duration, and its error by the duration squared. What the updates are
told, bounds or R, is of e alone.

One statement an update cannot average: the posterior of Theorem 1 believes z to within the bounds
and learns nothing more from them once it does, however many e have passed. So the statement is made
of the MEAN e of a window of w measurements, whose calibrated bounds are narrower. The window is
three more states as well, s = -(mean of e so far), which is exact whatever the IMU does meanwhile:

    s_bar <- s_bar + (v_I_bar + b_p_bar - v_tilde)/w,    delta s <- delta s - H delta X / w,

and |s| <= epsilon with probability gamma is the box update with z = -delta s at the window's end;
then s starts from zero again.

Both updates leave outliers out (`estimator.updates.outliers`), no more of them in a row than a
window has.
"""

from dataclasses import dataclass, field

import numpy as np

from surefoot.estimator.core.state import EXTRA, numbers, spd
from surefoot.estimator.updates.coverage import FLOOR, posterior_moments
from surefoot.estimator.updates.outliers import is_outlier
from surefoot.estimator.updates.velocity import gaussian_update
from surefoot.estimator.updates.velocity_output import lift, velocity_output
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.kernels import kernel

EXTRAS = 3
"""Extra vectors in the packed state: b_p, then s, then c."""
_B, _S, _C = EXTRA, EXTRA + 1, EXTRA + 2
_b, _s, _c = 15, 18, 21


@dataclass(frozen=True)
class PersistentError:
    """What the filter is told of an observer's persistent error, all in I.

    covariance (3, 3) [m^2/s^2]: prior of b_p about c. time_constant [s] > 0, inf for a constant.
    window: measurements in the mean that a coverage update's epsilon bounds. reach (3,) [m/s]: the
    largest mixing errors; larger ones are outliers. course (3, 3) [m^2/s^2]: prior of c, which may
    be zero.
    """

    covariance: np.ndarray
    time_constant: float = np.inf
    window: int = 1
    reach: np.ndarray = field(default_factory=lambda: np.full(3, np.inf))
    course: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))

    def __post_init__(self):
        object.__setattr__(self, "covariance", spd("persistent", self.covariance, 3))
        course = numbers("persistent: course", self.course, (3, 3))
        least = -1e-12 * max(float(np.trace(course)), 1e-12)
        if not np.allclose(course, course.T) or np.linalg.eigvalsh(course)[0] < least:
            raise SurefootError("persistent: course is no covariance")
        object.__setattr__(self, "course", 0.5 * (course + course.T))
        reach = np.array(self.reach, dtype=float)
        if reach.shape != (3,) or not np.all(reach > 0):
            raise SurefootError("persistent: reach must be three numbers > 0")
        object.__setattr__(self, "reach", reach)
        if not self.time_constant > 0:
            raise SurefootError(f"persistent: time_constant {self.time_constant} must be > 0")
        if self.window < 1 or self.window != int(self.window):
            raise SurefootError(f"persistent: window {self.window} must be a whole number >= 1")

    def enter(self, covariance: np.ndarray) -> np.ndarray:
        """The covariance (15, 15) with these states in it, (24, 24)."""
        P = np.zeros((15 + 3 * EXTRAS, 15 + 3 * EXTRAS))
        P[:15, :15], P[_b:_s, _b:_s] = covariance, self.covariance + self.course
        P[_b:_s, _c:] = P[_c:, _b:_s] = P[_c:, _c:] = self.course
        return P

    def model(self) -> tuple[np.ndarray, float, int, np.ndarray, np.ndarray]:
        """What the kernels take: covariance, time constant, window, reach, and fresh counts."""
        counts = np.zeros(2, dtype=np.int64)
        return self.covariance, float(self.time_constant), int(self.window), self.reach, counts


NONE = (np.zeros((3, 3)), np.inf, 1, np.full(3, np.inf), np.zeros(2, dtype=np.int64))
"""The `model` of a filter without a persistent part, for the kernels' arguments."""


@kernel
def propagate_bias(mean, covariance, prior, time_constant: float, dt: float):
    """b_p over dt [s], in place; prior (3, 3) is its stationary covariance about c."""
    if time_constant == np.inf:
        return
    keep = np.exp(-dt / time_constant)
    for i in range(3):
        mean[_B, i] = keep * mean[_B, i] + (1.0 - keep) * mean[_C, i]
        for j in range(covariance.shape[0]):
            covariance[_b + i, j] *= keep
            covariance[_b + i, j] += (1.0 - keep) * covariance[_c + i, j]
    for i in range(3):
        for j in range(covariance.shape[0]):
            covariance[j, _b + i] *= keep
            covariance[j, _b + i] += (1.0 - keep) * covariance[j, _c + i]
        for j in range(3):
            covariance[_b + i, _b + j] += (1.0 - keep * keep) * prior[i, j]


@kernel
def update_velocity_persistent(mean, covariance, v_I, R, window: int, reach, counts) -> float:
    """Gaussian update with v_I (3,) whose mixing error has the covariance R (3, 3), in place.

    Returns the squared Mahalanobis distance of the innovation, nan where it was left out.
    """
    n = covariance.shape[0]
    PHt, S, residual = np.empty((n, 3)), np.empty((3, 3)), np.empty(3)
    velocity_output(mean, covariance, 0, v_I, PHt, S, residual)
    if is_outlier(S, residual, reach, window, counts):
        return np.nan
    return gaussian_update(mean, covariance, 0, PHt, S, residual, R)


@kernel
def update_coverage_persistent(
    mean, covariance, v_I, epsilon, gamma: float, iterations: int, window: int, reach, counts
) -> float:
    """One measurement v_I (3,), and at the window's end the coverage update, in place.

    epsilon (3,) [m/s] bounds the mean of `window` mixing errors at the joint level gamma; counts
    (2,) are the measurements gathered and those left out in a row. Returns pi of the window that
    ends, nan within one.
    """
    n = covariance.shape[0]
    PHt, S, residual = np.empty((n, 3)), np.empty((3, 3)), np.empty(3)
    velocity_output(mean, covariance, 0, v_I, PHt, S, residual)
    if is_outlier(S, residual, reach, window, counts):
        return np.nan
    accumulate_window(mean, covariance, PHt, S, residual, 1.0 / window)
    counts[0] += 1
    if counts[0] < window:
        return np.nan
    counts[0] = 0
    for i in range(3):
        residual[i] = -mean[_S, i]
        for j in range(n):
            PHt[j, i] = -covariance[j, _s + i]
        for j in range(3):
            S[i, j] = covariance[_s + i, _s + j]
    floor = FLOOR**2 + 1e-10 * (S[0, 0] + S[1, 1] + S[2, 2])
    for i in range(3):
        S[i, i] += floor
    lower, upper = residual - epsilon, residual + epsilon
    z_mean, z_cov = np.zeros(3), S.copy()
    first = np.nan
    for _ in range(iterations):
        before, spread = z_mean.copy(), z_cov.copy()
        pi = posterior_moments(before, spread, lower, upper, gamma, z_mean, z_cov)
        if np.isnan(first):
            first = pi
        if not pi < gamma:
            break
    if first < gamma:
        lift(mean, covariance, 0, PHt, S, z_mean, z_cov)
    mean[_S] = 0.0
    covariance[_s : _s + 3, :] = 0.0
    covariance[:, _s : _s + 3] = 0.0
    return first


@kernel
def accumulate_window(mean, covariance, PHt, S, residual, share: float):
    """s_bar and delta s take one measurement's share, with the covariance."""
    n = covariance.shape[0]
    for i in range(3):
        mean[_S, i] -= share * residual[i]
    # H Sigma of delta s' = delta s - share z, before its columns change.
    HPs = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            HPs[i, j] = PHt[_s + j, i]
    for i in range(n):
        if not _s <= i < _c:
            for j in range(3):
                covariance[i, _s + j] -= share * PHt[i, j]
                covariance[_s + j, i] = covariance[i, _s + j]
    for i in range(3):
        for j in range(3):
            covariance[_s + i, _s + j] += share * (share * S[i, j] - HPs[i, j] - HPs[j, i])
