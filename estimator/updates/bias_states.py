"""The persistent part of an observer's error as additional states, and statements about means.

An observer's error has two parts, v_tilde = R_GI^T v + b_p + e: b_p (3,) in I persists for long,
while e mixes. A filter that treats measurements as independent assumes that b_p averages out, which
it does not. So b_p joins the state, with the error delta b_p = b_p_bar - b_p, and

    z = H delta X = (v_I + b_p) - (v_I_bar + b_p_bar) to first order,   H = [0 -R^T 0 0 0 -I]

(for the velocity as in eq. setup_feasible_set_lie_linear_augmented, which stays right-invariant
since b_p only adds to the output). It persists on two scales: over a section of ground or a turn,
and over a whole course or the life of a robot. So b_p is a first-order Gauss-Markov process, with
covariance C and time constant tau, about a constant c (the course's bias) with prior covariance C_c
that is three more states,

    b_p <- c + k (b_p - c),    delta b_p <- k delta b_p + (1 - k) delta c,    k = exp(-dt/tau),

with C (1 - k^2) added. tau = inf makes b_p constant; C_c = 0 keeps c at zero. Without c, a filter
with tau of a few seconds models the bias of a whole course as a series of independent ones: its
position variance then grows with the duration, while the squared error grows with the duration
squared. Bounds and R of the updates refer to e alone.

One statement per update cannot average: the posterior of Theorem 1 moves z to within the bounds and
learns nothing more from them afterwards, however many e have passed. The statement is therefore
about the MEAN of e over a window of w measurements, whose calibrated bounds are narrower. The
window's error, s = -(mean of e so far), is three more states, which is exact whatever the IMU does
meanwhile:

    s_bar <- s_bar + (v_I_bar + b_p_bar - v_tilde)/w,    delta s <- delta s - H delta X / w,

and |s| <= epsilon with probability gamma is the box update with z = -delta s at the window's end;
then s restarts from zero.

Both updates reject outliers (`surefoot.estimator.updates.velocity`), at most as many in a row as a
window has.
"""

from dataclasses import dataclass, field

import numpy as np

from surefoot.estimator.core.checks import numbers, spd
from surefoot.estimator.core.state import EXTRA
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.kernels import kernel

EXTRAS = 3
"""Extra vectors in the packed state: b_p, then the window's error s, then the course's bias c."""
BIAS, WINDOW_ERROR, COURSE_BIAS = EXTRA, EXTRA + 1, EXTRA + 2
"""Their rows of the packed mean."""
BIAS_AT, WINDOW_AT, COURSE_AT = 15, 18, 21
"""Offsets of their errors in the covariance."""


@dataclass(frozen=True)
class PersistentError:
    """Model of an observer's persistent error, all in I.

    Attributes:
        covariance: prior of b_p about c (3, 3) [m^2/s^2].
        time_constant: > 0 [s], inf for a constant.
        window: number of measurements in the mean that a coverage update's epsilon bounds.
        max_error: largest mixing errors (3,) [m/s]; larger ones are outliers.
        course: prior of c (3, 3) [m^2/s^2], which may be zero.
    """

    covariance: np.ndarray
    time_constant: float = np.inf
    window: int = 1
    max_error: np.ndarray = field(default_factory=lambda: np.full(3, np.inf))
    course: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))

    def __post_init__(self):
        object.__setattr__(self, "covariance", spd("persistent", self.covariance, 3))
        course = numbers("persistent: course", self.course, (3, 3))
        least = -1e-12 * max(float(np.trace(course)), 1e-12)
        if not np.allclose(course, course.T) or np.linalg.eigvalsh(course)[0] < least:
            raise SurefootError("persistent: course is no covariance")
        object.__setattr__(self, "course", 0.5 * (course + course.T))
        max_error = np.array(self.max_error, dtype=float)
        if max_error.shape != (3,) or not np.all(max_error > 0):
            raise SurefootError("persistent: max_error must be three numbers > 0")
        object.__setattr__(self, "max_error", max_error)
        if not self.time_constant > 0:
            raise SurefootError(f"persistent: time_constant {self.time_constant} must be > 0")
        if self.window < 1 or self.window != int(self.window):
            raise SurefootError(f"persistent: window {self.window} must be a whole number >= 1")

    def enter(self, covariance: np.ndarray) -> np.ndarray:
        """Extend a covariance (15, 15) by these states, to (24, 24)."""
        P = np.zeros((15 + 3 * EXTRAS, 15 + 3 * EXTRAS))
        bias, course = slice(BIAS_AT, BIAS_AT + 3), slice(COURSE_AT, COURSE_AT + 3)
        P[:15, :15], P[bias, bias] = covariance, self.covariance + self.course
        P[bias, course] = P[course, bias] = P[course, course] = self.course
        return P


@kernel
def propagate_bias(mean, covariance, prior, time_constant: float, dt: float):
    """Propagate b_p in place.

    Args:
        mean: packed state (7+EXTRAS, 3).
        covariance: of its error (24, 24).
        prior: covariance of b_p about c (3, 3) [m^2/s^2].
        time_constant: of b_p [s], may be inf.
        dt: the step [s].
    """
    if time_constant == np.inf:
        return
    keep = np.exp(-dt / time_constant)
    for i in range(3):
        mean[BIAS, i] = keep * mean[BIAS, i] + (1.0 - keep) * mean[COURSE_BIAS, i]
        for j in range(covariance.shape[0]):
            covariance[BIAS_AT + i, j] *= keep
            covariance[BIAS_AT + i, j] += (1.0 - keep) * covariance[COURSE_AT + i, j]
    for i in range(3):
        for j in range(covariance.shape[0]):
            covariance[j, BIAS_AT + i] *= keep
            covariance[j, BIAS_AT + i] += (1.0 - keep) * covariance[j, COURSE_AT + i]
    for i in range(3):
        for j in range(3):
            covariance[BIAS_AT + i, BIAS_AT + j] += (1.0 - keep * keep) * prior[i, j]


@kernel
def accumulate_window(mean, covariance, PHt, S, residual, share: float):
    """Add one measurement's share to s_bar and delta s, with the covariance, in place.

    Args:
        mean: packed state (7+EXTRAS, 3).
        covariance: of its error (24, 24).
        PHt: Sigma H^T (24, 3) of the measurement.
        S: H Sigma H^T (3, 3) of it.
        residual: measured minus predicted velocity (3,) [m/s].
        share: one over the measurements of a window.
    """
    n = covariance.shape[0]
    for i in range(3):
        mean[WINDOW_ERROR, i] -= share * residual[i]
    # H Sigma of delta s' = delta s - share z, before its columns change.
    HPs = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            HPs[i, j] = PHt[WINDOW_AT + j, i]
    for i in range(n):
        if not WINDOW_AT <= i < COURSE_AT:
            for j in range(3):
                covariance[i, WINDOW_AT + j] -= share * PHt[i, j]
                covariance[WINDOW_AT + j, i] = covariance[i, WINDOW_AT + j]
    for i in range(3):
        for j in range(3):
            covariance[WINDOW_AT + i, WINDOW_AT + j] += share * (
                share * S[i, j] - HPs[i, j] - HPs[j, i]
            )


@kernel
def window_output(mean, covariance, PHt, S, residual):
    """Output of a complete window: z = -delta s.

    Args:
        mean: packed state (7+EXTRAS, 3).
        covariance: of its error (24, 24).
        PHt: (24, 3), filled with Sigma H^T.
        S: (3, 3), filled with H Sigma H^T.
        residual: (3,) [m/s], filled with -s_bar.
    """
    for i in range(3):
        residual[i] = -mean[WINDOW_ERROR, i]
        for j in range(covariance.shape[0]):
            PHt[j, i] = -covariance[j, WINDOW_AT + i]
        for j in range(3):
            S[i, j] = covariance[WINDOW_AT + i, WINDOW_AT + j]


@kernel
def restart_window(mean, covariance):
    """Begin the next window: s is zero again, and known."""
    mean[WINDOW_ERROR] = 0.0
    covariance[WINDOW_AT : WINDOW_AT + 3, :] = 0.0
    covariance[:, WINDOW_AT : WINDOW_AT + 3] = 0.0
