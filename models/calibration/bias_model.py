"""Variance components of an observer's error: persistent and mixing part, and time constant.

The model of the errors of axis i is

    e_i(t) = b_i(t) + m_i(t),     cov(b_i(t), b_i(t + s)) = c_i exp(-s / tau),

with b the persistent part, a zero-mean first-order Gauss-Markov process with one tau for all axes,
and m the mixing part, which decorrelates within a block of MIXING_BLOCK seconds. The means of
blocks are then y_k = b_k + n_k with n white of variance s_i. The likelihood of c_i, s_i and tau is
that of a scalar Kalman filter (Harvey, Forecasting, Structural Time Series Models and the Kalman
Filter, 1989, ch. 3.4), and is maximised over a grid of tau, where tau = inf is a constant part.
Several sequences, or long blocks of one, are independent realisations of b.

A fitted b does not describe the difference between courses: its tau is that of changes within a
course, and with a tau of seconds it averages out over minutes, which the mean error of a course
need not. So b varies about a constant c, different for each course. Its variance is that of the
measured course means, plus one further course as far off as b is within a course: a few courses
are weak evidence for others, and the ground of one section may be all of the next course. The share
of a course's mean that b explains is subtracted, all of it where tau is infinite.

The mean is zero and not estimated: what all sequences share is persistent as well.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from surefoot.models.calibration.regions import conformal_quantile, level_per_axis
from surefoot.sim.common.errors import SurefootError

MIXING_BLOCK = 0.5
"""Averaging time of the mixing part [s]: a trot's stride, with which errors repeat."""
BOUNDED_MEAN = 0.25
"""Time over which the mean is bounded by `epsilon` [s]: half a stride, at which a trot's legs
swap.
"""
LEAST = 20
"""Least number of blocks from which the persistent part can be identified."""
TAUS = np.append(np.geomspace(2.0, 500.0, 21), np.inf)
"""Grid of time constants [s]. Shorter ones cannot be separated from the mixing part."""
RATIOS = np.append(0.0, np.geomspace(1e-5, 1e4, 91))
"""Grid of c / s."""
LEAST_STD = 1e-4
"""Least standard deviation of the prior [m/s], which keeps it definite without a persistent
part.
"""


@dataclass(frozen=True, eq=False)
class BiasModel:
    """Model of the persistent part of an observer's error, and bounds of the rest, all in I.

    Attributes:
        covariance: prior of b in an unseen sequence (3, 3) [m^2/s^2]. Its variances are c nu / (nu
            - 2), Student's predictive variance after nu draws (at most doubled); its correlations
            are those found, with three uncorrelated draws added.
        course: prior of the constant about which b varies, likewise; may be zero (3, 3) [m^2/s^2].
        time_constant: tau [s], may be inf.
        epsilon: bounds of the mean of `window` successive mixing errors at the joint level (3,)
            [m/s].
        within: that mean's covariance times `window` (3, 3) [m^2/s^2].
        max_error: largest single mixing error (3,) [m/s].
        window: number of errors in the mean.
        variance: c (3,) [m^2/s^2].
        nu: effective number of draws of b.
    """

    covariance: np.ndarray
    course: np.ndarray
    time_constant: float
    epsilon: np.ndarray
    within: np.ndarray
    max_error: np.ndarray
    window: int
    variance: np.ndarray
    nu: float

    def __post_init__(self):
        """Raises ValueError where a value is no number of its kind."""
        for name, shape in _SHAPES.items():
            value = getattr(self, name)
            sound = np.greater(value, 0) if name == "time_constant" else np.isfinite(value)
            if np.shape(value) != shape or not sound.all():
                raise ValueError(f"persistent.{name} is not {shape} finite numbers")
        for name in ("covariance", "within"):
            np.linalg.cholesky(getattr(self, name))
        if np.linalg.eigvalsh(self.course)[0] < -1e-12:
            raise ValueError("persistent.course is no covariance")
        if not (np.all(self.epsilon > 0) and np.all(self.max_error > 0)):
            raise ValueError("persistent.epsilon and max_error must be > 0")
        if not (isinstance(self.window, int) and self.window > 0):
            raise ValueError("persistent.window must be whole and positive")

    def turned(self, R: np.ndarray) -> BiasModel:
        """The same in the frame that R (3, 3) maps ours to; bounds become those of the enclosing
        box.

        c remains that of the calibrated axes.
        """
        return replace(
            self,
            covariance=R @ self.covariance @ R.T,
            course=R @ self.course @ R.T,
            within=R @ self.within @ R.T,
            epsilon=np.abs(R) @ self.epsilon,
            max_error=np.abs(R) @ self.max_error,
        )

    @classmethod
    def from_plain(cls, values: dict[str, Any]) -> BiasModel:
        """From JSON, where an infinite time constant is null. Raises TypeError, KeyError or
        ValueError where it is not complete.
        """
        known = {k: x for k, x in values.items() if k not in _OF_0_1_0}
        known["max_error"] = known.pop("reach")  # its name in the file
        for name in _SHAPES:
            value = np.array(known[name], dtype=float)  # null becomes nan
            known[name] = np.where(np.isnan(value), np.inf, value)
        known["time_constant"] = float(known["time_constant"])
        return cls(**known)


_OF_0_1_0 = ("interval", "time_constant_interval", "sequences", "blocks")
"""What files of surefoot 0.1.0 have besides."""
_SHAPES = dict.fromkeys(("epsilon", "max_error", "variance"), (3,))
_SHAPES |= {"time_constant": ()}
_SHAPES |= dict.fromkeys(("covariance", "course", "within"), (3, 3))


def long_enough(errors: np.ndarray, dt: float) -> bool:
    """Whether a sequence of errors (N, 3) every dt [s] has enough blocks for a persistent part."""
    return len(errors) // round(MIXING_BLOCK / dt) >= LEAST


def estimate_bias_model(
    errors: np.ndarray | Sequence[np.ndarray], dt: float, gamma: float
) -> BiasModel:
    """Estimate the persistent part of errors (N, 3) [m/s] every dt [s], of one sequence or several.

    gamma is the joint level of `epsilon`. Raises SurefootError where there are fewer than LEAST
    blocks, or too few windows for a bound.
    """
    sequences = [errors] if isinstance(errors, np.ndarray) else list(errors)
    size = max(1, round(MIXING_BLOCK / dt))
    means = [block_means(part, size) for part in sequences]
    blocks = sum(map(len, means))
    if blocks < LEAST:
        raise SurefootError(
            f"{blocks} blocks of {MIXING_BLOCK:g} s; the persistent part needs {LEAST}"
        )
    y, fresh = np.concatenate(means), np.concatenate([np.arange(len(m)) == 0 for m in means])
    ratio, variance, tau = _fit(y, fresh, size * dt)
    nu = sum(1.0 + (0.0 if math.isinf(tau) else len(m) * size * dt / tau) for m in means)
    phi = math.exp(-size * dt / tau)
    correlation = _correlation(y, fresh, phi, nu)
    std = np.maximum(np.sqrt(_next_draw(variance, nu)), LEAST_STD)
    of_course = np.sqrt(_course_variance(sequences, dt, variance, tau))
    mixing = [
        _mixing(part, mean, size, ratio, phi) for part, mean in zip(sequences, means, strict=True)
    ]
    # The smoothed part removes some of the mixing part's variance; rescale by the fitted one.
    left = np.concatenate([block_means(part, size) for part in mixing])
    scale = np.sqrt(_innovations(y, fresh, ratio, phi)[0] / np.mean(left**2, axis=0))
    mixing = [part * scale for part in mixing]
    length = max(1, round(BOUNDED_MEAN / dt))
    windows = np.concatenate([block_means(part, length) for part in mixing])
    return BiasModel(
        covariance=correlation * np.outer(std, std),
        course=correlation * np.outer(of_course, of_course),
        time_constant=tau,
        epsilon=conformal_quantile(np.abs(windows), level_per_axis(gamma)),
        within=windows.T @ windows / len(windows) * length,
        max_error=np.abs(np.concatenate(mixing)).max(axis=0),
        window=length,
        variance=variance,
        nu=float(nu),
    )


def block_means(x: np.ndarray, size: int) -> np.ndarray:
    """Means (N // size, D) of x (N, D) over whole blocks of `size`."""
    count = len(x) // size
    return x[: count * size].reshape(count, size, x.shape[1]).mean(axis=1)


def _fit(y, fresh, step: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Maximum-likelihood c / s (3,), c (3,) and tau."""
    phi = np.exp(-step / TAUS)[:, None, None]
    s, likelihood = _innovations(y[:, :, None], fresh, RATIOS, phi)
    by_tau = likelihood.max(axis=2).sum(axis=1)
    # Without a persistent part all tau are equivalent; prefer the longest as the simplest.
    best = len(TAUS) - 1 - int(np.argmax(by_tau[::-1]))
    at, c = likelihood[best].argmax(axis=1), RATIOS * s
    return RATIOS[at], c[best, range(3), at], float(TAUS[best])


def _innovations(y, fresh, ratio, phi):
    """Maximum-likelihood s, the variance of n, for c / s = ratio, and the log-likelihood there.

    Args:
        y: (K, 3, ...) [m/s], means of the errors over blocks.
        fresh: (K,) bool, whether a sequence begins at the block.
        ratio: c / s, of a shape that broadcasts with a row of y, as that of the result does.
        phi: correlation of the persistent part between successive blocks, likewise.
    """
    b = p = squares = logs = np.float64(0.0)
    for means, begins in zip(y, fresh, strict=True):
        b, p = (0.0, ratio) if begins else (phi * b, phi * phi * p + (1.0 - phi * phi) * ratio)
        f, v = p + 1.0, means - b
        squares, logs = squares + v * v / f, logs + np.log(f)
        b, p = b + p / f * v, p / f
    s = squares / len(y) + 1e-300
    return s, -0.5 * (len(y) * np.log(s) + logs)


def _next_draw(variance, nu: float):
    """Predictive variance of a next draw after nu draws (Student), at most doubled."""
    return np.maximum(variance * nu / (nu - 2.0) if nu > 4.0 else 2.0 * variance, 0.0)


def _course_variance(sequences, dt: float, variance, tau: float) -> np.ndarray:
    """Variance (3,) of the constant about which b varies; see the module."""
    explained, squares = 0.0, variance.copy()
    for part in sequences:
        x = len(part) * dt / tau
        # Variance of a Gauss-Markov process's mean over x time constants, relative to its own.
        explained += 1.0 if x < 1e-6 else 2.0 * (x + math.expm1(-x)) / x**2
        squares = squares + np.mean(part, axis=0) ** 2
    nu = len(sequences) + 1.0
    explained /= len(sequences)
    return np.maximum(_next_draw(squares / nu, nu) - _next_draw(variance, nu) * explained, 0.0)


def _correlation(y, fresh, phi: float, nu: float) -> np.ndarray:
    """Correlations (3, 3) of the persistent part, from lagged pairs of block means."""
    lagged = np.zeros((3, 3))
    for part in np.split(y, np.flatnonzero(fresh)[1:]):
        # Weighted sums over all pairs of different blocks, in one pass with a decaying sum.
        before = np.zeros(3)
        for row in part:
            lagged += np.outer(before, row)
            before = phi * (before + row)
    weight = np.sqrt(np.maximum(np.diag(lagged), 1e-300))
    correlation = 0.5 * (lagged + lagged.T) / np.outer(weight, weight)
    correlation = np.clip(correlation, -1.0, 1.0) * nu / (nu + 3.0)
    np.fill_diagonal(correlation, 1.0)
    values, vectors = np.linalg.eigh(correlation)
    correlation = vectors * np.maximum(values, 0.05) @ vectors.T
    return correlation / np.sqrt(np.outer(np.diag(correlation), np.diag(correlation)))


def _mixing(errors, means, size: int, ratio, phi: float) -> np.ndarray:
    """One sequence's errors (N, 3) without the smoothed persistent part.

    Args:
        errors: (N, 3) [m/s].
        means: (K, 3) [m/s], their means over blocks.
        size: rows in a block.
        ratio: (3,), c / s of each axis.
        phi: correlation of the persistent part between successive blocks.
    """
    if len(means) == 0:
        return errors - errors.mean(axis=0)
    smooth = _smoothed(means, ratio, phi)
    at = (np.arange(len(means)) + 0.5) * size - 0.5
    rows = np.arange(len(errors))
    return errors - np.column_stack([np.interp(rows, at, smooth[:, i]) for i in range(3)])


def _smoothed(y, ratio, phi: float) -> np.ndarray:
    """Mean (K, 3) of b given all block means of a sequence (Rauch-Tung-Striebel smoother)."""
    b, p, ahead, p_ahead = (np.zeros(y.shape) for _ in range(4))
    p_ahead[0] = ratio
    for k in range(len(y)):
        if k > 0:
            ahead[k] = phi * b[k - 1]
            p_ahead[k] = phi * phi * p[k - 1] + (1.0 - phi * phi) * ratio
        gain = p_ahead[k] / (p_ahead[k] + 1.0)
        b[k], p[k] = ahead[k] + gain * (y[k] - ahead[k]), p_ahead[k] * (1.0 - gain)
    for k in range(len(y) - 2, -1, -1):
        later = p_ahead[k + 1]
        gain = np.divide(phi * p[k], later, where=later > 0.0, out=np.zeros_like(later))
        b[k] += gain * (b[k + 1] - ahead[k + 1])
    return b
