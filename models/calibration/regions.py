"""Regions that errors lie in: how each method makes one from errors that stand K apart.

Split conformal in three forms for three axes: a bound an axis (`conformal`, `bonferroni`), or one
score for all (`maxnorm`, `ellipsoid`), whose finite-sample statement is joint by itself. The fifth
method, `scenario`, is in `models.calibration.scenario_box`. fit -> conformalize -> predict, in our
words:
`fit` looks at errors of its own and fixes the score's shape, `conformalize` turns other errors
into a Region, and `Region.around` puts it about predictions.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from surefoot.models.calibration.bounds import BoundsError
from surefoot.models.calibration.scenario_box import least_samples, scenario_box

METHODS = {
    "conformal": "an axis at a time at gamma^(1/3): joint if the axes were independent",
    "bonferroni": "an axis at a time at 1 - (1 - gamma)/3: joint whatever their dependence",
    "maxnorm": "one score, the largest of the scaled axes: a joint box",
    "ellipsoid": "one score, the Mahalanobis norm: an ellipsoid; filters take the box around it",
    "scenario": "the smallest box after discarding: joint, with a confidence over calibrations",
}
SHAPED = ("maxnorm", "ellipsoid")
"""Methods whose score has a shape, which errors of their own must fix."""


@dataclass(frozen=True, eq=False)
class Region:
    """A set of errors about zero: a box, or the ellipsoid e^T shape^-1 e <= 1 where one is given.

    epsilon (3,), m/s: half widths of the box, or of the smallest box around the ellipsoid.
    """

    epsilon: np.ndarray
    shape: np.ndarray | None = None

    def contains(self, errors: np.ndarray) -> np.ndarray:
        """Which of errors (M, 3) it holds, (M,) bool."""
        if self.shape is None:
            return np.all(np.abs(errors) <= self.epsilon, axis=1)
        return mahalanobis(errors, self.shape) <= 1.0

    @property
    def volume(self) -> float:
        """(m/s)^3."""
        if self.shape is None:
            return float(np.prod(2 * self.epsilon))
        return float(4 / 3 * np.pi * np.sqrt(np.linalg.det(self.shape)))

    @property
    def box(self) -> Region:
        """The smallest box around it: what the filters' update takes. It holds at least as much."""
        return Region(self.epsilon)

    def around(self, v_I: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper (M, 3) velocities of the box about predictions v_I (M, 3)."""
        return v_I - self.epsilon, v_I + self.epsilon


def fit(method: str, errors: np.ndarray) -> np.ndarray | None:
    """The score's shape, from errors (n, 3) that `conformalize` will not see: their second moment.

    Only its diagonal for `maxnorm`; None for the methods that need no shape.
    """
    check_method(method)
    if method not in SHAPED:
        return None
    moment = errors.T @ errors / len(errors)
    return moment if method == "ellipsoid" else np.diag(np.diag(moment))


def conformalize(
    method: str,
    shape: np.ndarray | None,
    errors: np.ndarray,
    gamma: float,
    confidence: float = 0.95,
) -> Region:
    """The region that holds a further error with probability gamma, from errors (N, 3).

    `shape` is what `fit` gave; `confidence` is that of `scenario` alone. Raises BoundsError where
    N is less than `samples_needed`.
    """
    needed = samples_needed(method, gamma, confidence)
    if len(errors) < needed:
        raise BoundsError(f"{len(errors)} independent samples, gamma {gamma:g} needs {needed}")
    if method == "scenario":
        return Region(scenario_box(errors, gamma, confidence))
    level = level_of(method, gamma)
    if shape is None:
        return Region(conformal_bounds(np.abs(errors), level))
    if method == "maxnorm":
        scale = np.sqrt(np.diag(shape))
        radius = conformal_bounds((np.abs(errors) / scale).max(axis=1)[:, None], level)[0]
        return Region(radius * scale)
    square = conformal_bounds(mahalanobis(errors, shape)[:, None], level)[0]
    return Region(np.sqrt(square * np.diag(shape)), square * shape)


def samples_needed(method: str, gamma: float, confidence: float = 0.95) -> int:
    """Least number of independent errors with which `method` gives a finite region."""
    if method == "scenario":
        return least_samples(gamma, confidence)
    return least_rank(level_of(method, gamma))


def level_of(method: str, gamma: float) -> float:
    """Level at which the method's score is ranked. Raises BoundsError for gamma outside (0, 1)."""
    check_method(method)
    per_axis = level_per_axis(gamma)
    if method == "conformal":
        return per_axis
    return 1 - (1 - gamma) / 3 if method == "bonferroni" else gamma


def level_per_axis(gamma: float) -> float:
    """gamma^(1/3), the level of each axis. Raises BoundsError unless 0 < gamma < 1."""
    if not 0 < gamma < 1:
        raise BoundsError(f"--gamma {gamma:g}: must lie between 0 and 1")
    return gamma ** (1 / 3)


def rank(n: int, level: float) -> int:
    """k = ceil((n + 1) level): which of n sorted scores is the bound; more than n means none is.

    In exact arithmetic on the level's shortest decimal form, so that 0.9 of 10 is 9 and not 10.
    """
    return math.ceil((n + 1) * Fraction(repr(float(level))))


def least_rank(level: float) -> int:
    """The least n whose rank(n, level) is no more than n."""
    exact = Fraction(repr(float(level)))
    return math.ceil(exact / (1 - exact))


def conformal_bounds(scores: np.ndarray, level: float) -> np.ndarray:
    """The k-th smallest of scores (N, D) by column, (D,), k = rank(N, level) <= N."""
    k = rank(len(scores), level)
    return np.sort(scores, axis=0)[k - 1]


def mahalanobis(errors: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """e^T shape^-1 e (M,) of errors (M, 3)."""
    return np.einsum("mi,mi->m", errors @ np.linalg.inv(shape), errors)


def check_method(method: str) -> None:
    """Raise BoundsError for a method that is none."""
    if method not in METHODS:
        raise BoundsError(f"--method {method}: choose {' | '.join(METHODS)}")
