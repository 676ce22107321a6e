"""Comparison of two vector streams that should measure the same: axes, signs and scales."""

from dataclasses import dataclass
from itertools import permutations

import numpy as np

from surefoot.sim.importing.streams import with_short_gaps

GYRO, ACCEL, REF_P, REF_V = (
    tuple(f"{kind}_{a}" for a in "xyz") for kind in ("gyro", "accel", "ref_p", "ref_v")
)
OTHER = 0.7
"""Correlation with another axis from which that axis is taken to be measured: clean walks have 0.8
(accelerometers) to 1 with their own axis, below 0.6 with others (roll and sway are correlated).
"""
GAIN = 0.4
"""Least excess over the correlation with its own axis; correlated axes have 0.4 with each other."""
_FEWEST_ROWS = 10
"""Least number of rows for a delay."""
_MEASURE_ALIKE = 0.5
"""Correlation below which two streams do not measure the same, at any delay."""
_ALIKE = 0.8
"""Correlation with its own axis from which scales are compared."""


@dataclass(frozen=True)
class AxesMatch:
    """Match of three measured axes with expected ones.

    Attributes:
        order: expected axis that matches each measured one best.
        sign: of the match (3,).
        own: correlation of each axis with its own (3,).
        best: correlation with the matched one (3,).
        scale: slope of measured over expected for the match (3,).
    """

    order: tuple[int, ...]
    sign: np.ndarray
    own: np.ndarray
    best: np.ndarray
    scale: np.ndarray

    @classmethod
    def of(cls, axes: np.ndarray) -> "AxesMatch":
        """The match for measured = axes @ expected, a signed permutation (3, 3)."""
        order = np.abs(axes).argmax(axis=1)
        sign = axes[range(3), order]
        return cls(tuple(order.tolist()), sign, np.diag(axes), np.ones(3), np.ones(3))

    @property
    def wrong(self) -> tuple[int, ...]:
        """Axes that measure another one, or with the opposite sign."""
        turned = (np.array(self.order) != np.arange(3)) | (self.sign < 0)
        wrong = turned & (self.best > OTHER) & (self.best - self.own > GAIN)
        return tuple(np.flatnonzero(wrong).tolist())

    @property
    def alike(self) -> bool:
        """Whether all axes that move are the expected ones."""
        return not self.wrong and bool(np.median(self.own) > 0.5)

    @property
    def words(self) -> str:
        """The wrong axes in words, such as "x is -y"."""
        return ", ".join(
            f"{'xyz'[i]} is {'-' * bool(self.sign[i] < 0)}{'xyz'[self.order[i]]}"
            for i in self.wrong
        )

    @property
    def scaled(self) -> float:
        """Common scale factor of the axes that correlate well; NaN where none does."""
        alike = self.best > _ALIKE
        return float(np.median(self.scale[alike])) if alike.any() else float("nan")


def match_axes(measured: np.ndarray, expected: np.ndarray) -> AxesMatch:
    """Match the axes of `measured` (M, 3) to those of `expected` (M, 3), by their variation
    alone.
    """
    a, b = measured - measured.mean(axis=0), expected - expected.mean(axis=0)
    sizes = np.linalg.norm(a, axis=0)[:, None] * np.linalg.norm(b, axis=0)[None]
    both = a.T @ b
    alike = both / np.where(sizes > 0, sizes, np.inf)

    def total(order: tuple[int, ...]) -> float:
        return float(np.abs(alike[range(3), order]).sum()) + 1e-9 * (order == (0, 1, 2))

    order = max(permutations(range(3)), key=total)
    matched = alike[range(3), order]
    power = np.sum(b**2, axis=0)[list(order)]
    scale = both[range(3), order] / np.where(power > 0, power, np.inf)
    sign = np.where(matched < 0, -1.0, 1.0)
    return AxesMatch(tuple(order), sign, np.diag(alike).copy(), np.abs(matched), np.abs(scale))


def angle_between(a: np.ndarray, b: np.ndarray) -> float:
    """Angle between two vectors (3,) [deg]."""
    size = max(float(np.linalg.norm(a) * np.linalg.norm(b)), 1e-9)
    return float(np.degrees(np.arccos(np.clip(a @ b / size, -1.0, 1.0))))


def lag_of(late: np.ndarray, witness: np.ndarray, step: float, most: float) -> tuple[float, float]:
    """Delay [s] of `late` (M, D) relative to `witness` (M, D), and their mean correlation at it.

    Rows are `step` apart, and the delay is at most `most` in size. Columns have equal weight.
    """
    reach = min(round(most / step), len(late) // 3)
    rows = len(late) - 2 * reach
    shifts = np.arange(-reach, reach + 1)
    # Standardise each window of `late` by itself: a common mean and size would favour windows with
    # more motion, and shift the maximum for slow motion by half a step.
    b = _standardised(witness[reach : reach + rows])
    scores = [
        float(np.mean(_standardised(late[first : first + rows]) * b)) for first in shifts + reach
    ]
    k = int(np.argmax(scores))
    if k in (0, len(scores) - 1):
        return 0.0, scores[reach]
    before, top, after = scores[k - 1 : k + 2]
    bend = before - 2.0 * top + after
    part = 0.5 * (before - after) / bend if bend else 0.0
    return step * float(shifts[k] + part), top


def delay_between(t: np.ndarray, late: np.ndarray, witness: np.ndarray, most: float) -> float:
    """Delay [s], at most `most`, of `late` (N, D) relative to `witness` (N, D), at t (N,) [s];
    0 where they do not correlate.
    """
    if len(t) < _FEWEST_ROWS:
        return 0.0
    t = with_short_gaps(t, 2.0 * most)
    step = float(np.median(np.diff(t)))
    even = np.arange(t[0], t[-1], step)
    a, b = (np.column_stack([np.interp(even, t, one) for one in x.T]) for x in (late, witness))
    delay, alike = lag_of(a, b, step, most + step)
    return delay if alike > _MEASURE_ALIKE else 0.0


def _standardised(x: np.ndarray) -> np.ndarray:
    """Columns of (M, D) with mean 0 and standard deviation 1; 0 for a constant one."""
    x = x - x.mean(axis=0)
    return x / np.maximum(x.std(axis=0), 1e-12)
