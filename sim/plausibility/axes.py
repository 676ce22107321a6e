"""Two streams of vectors that should measure the same: whose axes, signs and sizes differ?"""

from dataclasses import dataclass
from itertools import permutations

import numpy as np

AXIS_NAMES = "xyz"
OTHER = 0.7
"""Correlation with another axis from which on that one is measured: that of clean walks with their
own axis is 0.8 (accelerometers) to 1, with others below 0.6 (roll and sway go together)."""
GAIN = 0.4
"""By which it must exceed that with its own axis: two that go together have 0.4 with each other."""
_ALIKE = 0.8
"""Correlation with its own axis from which on sizes are compared."""


@dataclass(frozen=True)
class AxesMatch:
    """How measured axes (3,) go with expected ones: `order` and `sign` of the best match, the
    correlation of each with its own axis (`own`) and with the matched one (`best`), and the slope
    of measured over expected there (`scale`)."""

    order: tuple[int, ...]
    sign: np.ndarray
    own: np.ndarray
    best: np.ndarray
    scale: np.ndarray

    @property
    def wrong(self) -> tuple[int, ...]:
        """Axes that measure another one, or with the other sign."""
        turned = (np.array(self.order) != np.arange(3)) | (self.sign < 0)
        wrong = turned & (self.best > OTHER) & (self.best - self.own > GAIN)
        return tuple(np.flatnonzero(wrong).tolist())

    @property
    def alike(self) -> bool:
        """Whether the axes that move measure what they say."""
        return not self.wrong and bool(np.median(self.own) > 0.5)

    @property
    def words(self) -> str:
        """What the wrong axes are, as "x is -y"."""
        signs = {1.0: "", -1.0: "-"}
        return ", ".join(
            f"{AXIS_NAMES[i]} is {signs[float(self.sign[i])]}{AXIS_NAMES[self.order[i]]}"
            for i in self.wrong
        )

    @property
    def scaled(self) -> float:
        """Common factor of the axes that are alike; NaN where none is."""
        alike = self.best > _ALIKE
        return float(np.median(self.scale[alike])) if alike.any() else float("nan")


def match_axes(measured: np.ndarray, expected: np.ndarray) -> AxesMatch:
    """Match the axes of measured (M, 3) to those of expected (M, 3), by their motion alone."""
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


def lag_of(late: np.ndarray, witness: np.ndarray, step: float, most: float) -> tuple[float, float]:
    """By how much [s] `late` (M, D) comes after `witness` (M, D), both a row every `step`, at most
    `most`; and their mean correlation then. Each column counts alike, whatever its size."""
    reach = min(round(most / step), len(late) // 3)
    rows = len(late) - 2 * reach
    shifts = np.arange(-reach, reach + 1)
    # Each stretch of `late` by its own mean and size: those of all rows would favour a stretch that
    # moves more, and turn the top of slow motion by half a step.
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


def _standardised(x: np.ndarray) -> np.ndarray:
    """Columns of (M, D) with mean 0 and size 1; 0 for one that rests."""
    x = x - x.mean(axis=0)
    return x / np.maximum(x.std(axis=0), 1e-12)
