"""Velocities that a log lacks, by local quadratic fits to the positions.

Savitzky-Golay (Anal. Chem. 36, 1964), with the actual time stamps. A symmetric window has zero
phase; a window of the past has none for motions of constant acceleration.
"""

import math
from dataclasses import replace

import numpy as np
from scipy.ndimage import uniform_filter1d

from surefoot.sim.common.kernels import kernel
from surefoot.sim.log.log import Log

JOINT_WINDOW = 0.025
"""Window for joints [s]: passes nine tenths of the amplitude at 12 Hz and half at 30 Hz, from rows
at 400 to 500 Hz.
"""
RATE_WINDOW = 0.006
"""Averaging time of rates before they are differentiated [s]."""
REFERENCE_WINDOW = 0.06
"""Window for references [s]: motion capture has 60 to 120 Hz and stamps accurate to milliseconds.
It passes nine tenths of the amplitude at 5 Hz, half at 13 Hz and a tenth at 21 Hz. With 0.1 s, and
three quarters at 5 Hz, `trace` took the missing bounce of a trot for the scale of an encoder.
"""


def derivative(t: np.ndarray, x: np.ndarray, window: float, causal: bool) -> np.ndarray:
    """Time derivative (N, ...) of samples x (N, ...), in their unit per second, at t (N,) [s].

    The slope at t[k] of the least-squares quadratic through the rows within `window` seconds,
    centred on t[k] or, if `causal`, ending there.
    """
    return local_quadratic(t, x, window, causal)[1]


def local_quadratic(
    t: np.ndarray, x: np.ndarray, window: float, causal: bool = False
) -> np.ndarray:
    """Local least-squares quadratic through samples x (N, ...): value, slope and second derivative
    (3, N, ...).

    At each of t (N,) [s], from the rows within `window` seconds, centred on t[k] or, if `causal`,
    ending there. A window has at least three rows if the log has them; with two, the fit is a line.
    A row without a past (causal, at k = 0 or after a gap of 600 000 sample intervals) has no slope.
    """
    n = len(t)
    ahead = 0.0 if causal else 0.5 * window
    behind = window - ahead
    tolerance = 1e-6
    rows = np.arange(n)
    first = np.searchsorted(t, t - behind - tolerance, side="left")
    last = np.searchsorted(t, t + ahead + tolerance, side="right") - 1
    first = np.maximum(np.minimum(first, rows - (2 if causal else 1)), 0)
    if not causal:
        last = np.minimum(np.maximum(last, rows + 1), n - 1)
        # A one-sided window of two rows at either end is extended to three, to allow a quadratic.
        last = np.minimum(np.maximum(last, first + 2), n - 1)
        first = np.maximum(np.minimum(first, last - 2), 0)
    flat = np.ascontiguousarray(x, dtype=float).reshape(n, math.prod(x.shape[1:]))
    return _quadratics(t, flat, first, last, window).reshape(3, *x.shape)


@kernel
def _quadratics(t, x, first, last, scale):
    """Values, slopes and second derivatives (3, N, D) of local quadratics; lines through two rows,
    constants through one.

    Args:
        t: (N,) [s].
        x: (N, D), the samples.
        first: (N,), first row of each window.
        last: (N,), its last.
        scale: unit of time for the fit [s].
    """
    out = np.zeros((3, *x.shape))
    adjugate = np.zeros((3, 3))
    for k in range(len(t)):
        # Element by element: assigning a slice takes three seconds to compile.
        for d in range(x.shape[1]):
            out[0, k, d] = x[k, d]
        m1 = m2 = m3 = m4 = 0.0
        m0 = float(last[k] - first[k] + 1)
        for row in range(first[k], last[k] + 1):
            tau = (t[row] - t[k]) / scale
            m1 += tau
            m2 += tau**2
            m3 += tau**3
            m4 += tau**4
        # The adjugate of the normal matrix: its inverse times its determinant.
        adjugate[:] = 0.0
        if m0 >= 3.0:
            adjugate[0, 0], adjugate[1, 1] = m2 * m4 - m3 * m3, m0 * m4 - m2 * m2
            adjugate[2, 2] = m0 * m2 - m1 * m1
            adjugate[0, 1] = adjugate[1, 0] = m2 * m3 - m1 * m4
            adjugate[0, 2] = adjugate[2, 0] = m1 * m3 - m2 * m2
            adjugate[1, 2] = adjugate[2, 1] = m1 * m2 - m0 * m3
            scaled = m1 * adjugate[1, 0] + m2 * adjugate[1, 1] + m3 * adjugate[1, 2]
            if scaled <= 1e-12 * m0 * m2 * m4:
                continue  # a row of the window lies so far away that rounding decides
        elif m0 == 2.0:
            adjugate[0, 0], adjugate[1, 1] = m2, m0
            adjugate[0, 1] = adjugate[1, 0] = -m1
            scaled = m0 * m2 - m1 * m1
        else:
            continue
        for row in range(first[k], last[k] + 1):
            tau = (t[row] - t[k]) / scale
            for power in range(3):
                a, b, c = adjugate[power]
                share = (a + b * tau + c * tau**2) / scaled
                if power == 1:
                    share /= scale
                elif power == 2:
                    share *= 2.0 / scale**2
                for d in range(x.shape[1]):
                    # Differences from the row itself keep precision far from the origin.
                    out[power, k, d] += share * (x[row, d] - x[k, d])
    return out


class CausalDerivative:
    """`derivative` of the past, for a log that comes in pieces or row by row.

    Called with the next rows, t (N,) and x (N, D), it returns their derivatives (N, D),
    bit-identical to those of the whole log.
    """

    def __init__(self, window: float = JOINT_WINDOW):
        self._window = window
        self._t, self._x = np.zeros(0), None

    def __call__(self, t: np.ndarray, x: np.ndarray) -> np.ndarray:
        before = len(self._t)
        t = np.concatenate([self._t, t])
        x = x if self._x is None else np.concatenate([self._x, x])
        found = derivative(t, x, self._window, causal=True)[before:]
        # The next row needs the window before it, and at least two rows.
        kept = min(int(np.searchsorted(t, t[-1] - self._window - 1e-5)), len(t) - 3)
        self._t, self._x = t[max(kept, 0) :], x[max(kept, 0) :]
        return found


def joint_velocity(log: Log, causal: bool = False) -> np.ndarray:
    """Joint velocities (N, J) [rad/s]: the logged ones, else derived from q over 25 ms.

    The derivative is zero-phase; filters use the causal one, from row k and its past. Raises
    LogError where the log has no q.
    """
    if log.has("dq"):
        return log.dq
    log.require("q")
    what = f"joint velocity {causal}"
    return log.once(what, ["q"], lambda: derivative(log.t, log.q, JOINT_WINDOW, causal))


def steady_rate(t: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """Rates (N, ...) averaged over RATE_WINDOW, from which every acceleration of joints is taken:
    two ways would differ in noise, by which one effect would look better than another.
    """
    rows = max(1, round(RATE_WINDOW / np.median(np.diff(t))))
    return uniform_filter1d(rate, rows - 1 + rows % 2, axis=0)


def foot_velocity(log: Log) -> np.ndarray:
    """Velocities (N, L, 3) of the feet in I [m/s], relative to the IMU: the zero-phase derivative
    of the given positions over 25 ms.

    Raises LogError where the log does not give them.
    """
    log.require("foot")
    return log.once(
        "foot velocity", ["foot"], lambda: derivative(log.t, log.foot_I, JOINT_WINDOW, False)
    )


def reference_velocity(log: Log, causal: bool = False) -> np.ndarray:
    """Reference velocity (N, 3) of the IMU frame in G [m/s]: logged, else from ref_p.

    Raises LogError where the log has no reference.
    """
    if log.has("ref_v"):
        return log.ref_v
    log.require("reference")
    what = f"reference velocity {causal}"
    return log.once(
        what, ["reference"], lambda: derivative(log.t, log.ref_p, REFERENCE_WINDOW, causal)
    )


def with_velocities(log: Log, causal: bool = False) -> Log:
    """Add missing dq and ref_v where they can be derived, marked as derived."""
    columns: dict[str, np.ndarray] = {}
    derived = list(log.meta.derived)
    kind = "causal" if causal else "zero-phase"
    if log.has("q") and not log.has("dq"):
        velocity = joint_velocity(log, causal)
        columns |= {f"dq_{joint}": velocity[:, i] for i, joint in enumerate(log.joints)}
        derived.append(f"dq ({kind})")
    if log.has("reference") and not log.has("ref_v"):
        velocity = reference_velocity(log, causal)
        columns |= {f"ref_v_{axis}": velocity[:, i] for i, axis in enumerate("xyz")}
        derived.append(f"ref_v ({kind})")
    return replace(log, meta=replace(log.meta, derived=tuple(derived))).with_columns(columns)
