"""Regions of errors, and the methods that determine one from errors K apart.

Split conformal prediction for three axes: one bound per axis (`conformal`, `outer`), or one score
for all (`maxnorm`), whose finite-sample statement is joint by itself. The fourth method,
`scenario`, is in `surefoot.models.calibration.scenario_box`.

The length of the walk that a method needs is here as well: --help shows it, and this module imports
neither torch nor pandas.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from itertools import count
from typing import ClassVar

import numpy as np

from surefoot.models.calibration.mixing import LONGEST_LAG
from surefoot.models.registry import CALIBRATORS
from surefoot.sim.common.errors import SurefootError, check_known

CONFIDENCE = 0.95
"""Confidence of `scenario` bounds, over possible calibrations."""
OUTER_LEVEL = 0.99
"""Level of each axis' `outer` quantile. The paper sets the bounds of its biased regime "from outer
quantiles" without naming a level; this one needs 99 independent errors, 0.999 would need 999.
"""
ERROR_STEP = 0.01
"""Interval between an observer's errors [s]: 1 / RATE of `surefoot.models.observer.samples`, which
imports pandas; a --help that prints this length need not wait for it.
"""


class BoundsError(SurefootError):
    """Bounds that cannot be read or computed, or that belong to another observer."""


def level_per_axis(gamma: float) -> float:
    """gamma^(1/3), the level of each axis. Raises BoundsError unless 0 < gamma < 1."""
    if not 0 < gamma < 1:
        raise BoundsError(f"gamma {gamma:g}: must lie between 0 and 1")
    return gamma ** (1 / 3)


def rank(n: int, level: float) -> int:
    """k = ceil((n + 1) level): which of n sorted scores is the bound; none if more than n.

    In exact arithmetic on the level's shortest decimal form, so that 0.9 of 10 is 9 and not 10.
    """
    return math.ceil((n + 1) * Fraction(repr(float(level))))


def least_rank(level: float) -> int:
    """The least n whose rank(n, level) is no more than n."""
    exact = Fraction(repr(float(level)))
    return math.ceil(exact / (1 - exact))


def conformal_quantile(scores: np.ndarray, level: float) -> np.ndarray:
    """The k-th smallest of scores (N, D) by column, (D,), k = rank(N, level).

    Raises BoundsError where k > N.
    """
    k = rank(len(scores), level)
    if k > len(scores):
        raise BoundsError(
            f"{len(scores)} independent samples, a bound at level {level:.4f} needs "
            f"{least_rank(level)}"
        )
    return np.sort(scores, axis=0)[k - 1]


@dataclass(frozen=True, eq=False)
class Region:
    """A set of errors about zero: a box, or the ellipsoid e^T shape^-1 e <= 1 if `shape` is given.

    epsilon (3,) [m/s]: half widths of the box, or of the smallest box around the ellipsoid.
    """

    epsilon: np.ndarray
    shape: np.ndarray | None = None

    def contains(self, errors: np.ndarray) -> np.ndarray:
        """Mask (M,) of the errors (M, 3) inside the region."""
        if self.shape is None:
            return np.all(np.abs(errors) <= self.epsilon, axis=1)
        return mahalanobis(errors, self.shape) <= 1.0

    @property
    def volume(self) -> float:
        """Volume of the region [(m/s)^3]."""
        if self.shape is None:
            return float(np.prod(2 * self.epsilon))
        return float(4 / 3 * np.pi * np.sqrt(np.linalg.det(self.shape)))


class Calibrator:
    """A calibration method: `fit`, `conformalize`, `bounds`, called once each in that order.

    A method of your own is a subclass, registered by the entry point group "surefoot.calibrators".

    Attributes:
        label: what its bounds state, in a line of a table and of --help.
        fit_share: share of the log, from its beginning, given to `fit`; the rest goes to
            `conformalize`.
        confidence: of the statement, over possible calibrations; None where it is about their mean.
    """

    label: ClassVar[str]
    fit_share: ClassVar[float] = 0.0
    confidence: float | None = None
    epsilon: np.ndarray

    def __init__(self, gamma: float, confidence: float = CONFIDENCE):
        """A method that contains a further error with probability gamma.

        `confidence` is for those methods that state one. Raises BoundsError for gamma outside (0,
        1).
        """
        self.per_axis = level_per_axis(gamma)
        self.gamma = gamma

    @property
    def level(self) -> float:
        """Level at which the method's score is ranked."""
        return self.gamma

    def samples_needed(self) -> int:
        """Least number of independent errors that `conformalize` needs."""
        return least_rank(self.level)

    def fit(self, errors: np.ndarray) -> None:
        """Determine the score's shape from errors (n, 3) [m/s] that `conformalize` will not see."""

    def conformalize(self, errors: np.ndarray) -> None:
        """Determine the region's size from errors (N, 3) [m/s]. Raises BoundsError where N is too
        small.
        """
        raise NotImplementedError

    def bounds(self) -> Region:
        """The region: by default the box of half widths `epsilon`, set by `conformalize`."""
        return Region(self.epsilon)


class Conformal(Calibrator):
    """The paper's method: each axis at gamma^(1/3)."""

    label = "each axis at level gamma^(1/3): joint level gamma if the axes are independent"

    @property
    def level(self) -> float:
        return self.per_axis

    def conformalize(self, errors: np.ndarray) -> None:
        self.epsilon = conformal_quantile(np.abs(errors), self.level)


class Outer(Conformal):
    """Each axis at OUTER_LEVEL, or at gamma^(1/3) where that is more.

    The box contains far more than the gamma assumed by the filters, so that a persistent error
    seldom leaves it: NEES falls where errors persist, and accuracy where they do not.
    """

    label = (
        f"each axis at level {OUTER_LEVEL:g} or more: wider than gamma requires, for persistent "
        "errors"
    )

    @property
    def level(self) -> float:
        return max(OUTER_LEVEL, self.per_axis)


class MaxNorm(Calibrator):
    """The largest axis, each scaled by its root mean square."""

    label = "one score for all axes, the largest scaled error: a box of joint level gamma"
    fit_share = 0.25

    def fit(self, errors: np.ndarray) -> None:
        self.scale = np.sqrt(np.diag(errors.T @ errors / len(errors)))

    def conformalize(self, errors: np.ndarray) -> None:
        score = (np.abs(errors) / self.scale).max(axis=1)
        self.epsilon = conformal_quantile(score[:, None], self.level)[0] * self.scale


def mahalanobis(errors: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """e^T shape^-1 e (M,) of errors (M, 3)."""
    return np.einsum("mi,mi->m", errors @ np.linalg.inv(shape), errors)


def calibrator(method: str, gamma: float, confidence: float = CONFIDENCE) -> Calibrator:
    """The method of that name. Raises BoundsError where there is none, or gamma is out of range."""
    check_known("method", method, CALIBRATORS, BoundsError)
    return CALIBRATORS[method](gamma, confidence)


def errors_needed(how: Calibrator) -> int:
    """Least number of independent errors for a method, including those for `fit`."""
    if not 0.0 <= how.fit_share < 1.0:
        raise ValueError(f"fit_share must be from 0 to below 1, is {how.fit_share}")
    least = how.samples_needed()
    return next(m for m in count(least) if m - int(how.fit_share * m) >= least)


def walk_enough(gamma: float = 0.8) -> float:
    """Seconds of walk with a reference that suffice for conformal bounds and the slowest mixing.

    That is with K = LONGEST_LAG; a walk that mixes faster needs less. Raises BoundsError like
    `calibrator`.
    """
    return errors_needed(calibrator("conformal", gamma)) * LONGEST_LAG * ERROR_STEP
