"""Comparison of streams that should measure the same: order, signs, scales and delays."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import log, pi
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from surefoot.sim.common.series import interpolate_rows
from surefoot.sim.importing.advice import Changes, entries, scaled
from surefoot.sim.importing.columns import UNITS
from surefoot.sim.importing.streams import with_short_gaps
from surefoot.sim.plausibility.finding import Finding
from surefoot.sim.plausibility.limits import HARDLY, LIKELY, MENDED, SCALED, SURELY

NEAR = 1.2
"""Largest ratio of a stream's scale to that of the unit it is taken to be in."""
_FEWEST_ROWS = 10
"""Least number of rows for a delay."""
_TURNED = 0.1
"""Least share of a correlation before and after a sign changes."""
_INVERTED = 0.5
"""Scale, relative to the other columns', below which one of the opposite sign is a vibration that a
filter inverts: a moving average passes 0.22 of it at most.
"""
_WITHOUT_WORD = {
    "accel": {"ft/s^2": 0.3048, "cm/s^2": 1e-2, "mm/s^2": 1e-3},
    "gyro": {"mrad/s": 1e-3, "turns/s": 2.0 * pi},
    "ref_v": {"km/h": 1.0 / 3.6, "inches/s": 0.0254, "feet/s": 0.3048},
}
"""SI values of units that an import map has no word for, by kind of column."""


@dataclass(frozen=True)
class AxesMatch:
    """Match of D measured columns, such as three axes, with expected ones.

    Attributes:
        order: expected column that matches each measured one best (D,).
        sign: of the match (D,).
        paired: correlation of each column with its own (D,).
        best: correlation with the matched one (D,).
        scale: slope of measured over expected for the match (D,).
        parts: names of the columns (D,), such as x, y, z.
    """

    order: np.ndarray
    sign: np.ndarray
    paired: np.ndarray
    best: np.ndarray
    scale: np.ndarray
    parts: Sequence[str]

    @classmethod
    def of(cls, axes: np.ndarray) -> "AxesMatch":
        """The match for measured = axes @ expected, a signed permutation (3, 3)."""
        return match_axes(axes.T, np.eye(3))

    @property
    def axes(self) -> np.ndarray:
        """The match as a signed permutation (D, D): measured = axes @ expected."""
        return np.eye(len(self.order))[self.order] * self.sign[:, None]

    @property
    def exchanged(self) -> np.ndarray:
        """Mask (D,) of the columns that match another than their own."""
        return self.order != np.arange(len(self.order))

    @property
    def surely(self) -> np.ndarray:
        """Mask (D,) of the columns that surely measure what they should."""
        return self.paired > SURELY

    @property
    def wrong(self) -> tuple[int, ...]:
        """Columns that measure another one, or with the opposite sign: what they match leaves less
        than MENDED of what their own leaves, and is not small, as a vibration that a slow filter
        inverts.
        """
        turned, sure = self.exchanged | (self.sign < 0), self.best > LIKELY
        clearer = 1.0 - self.best**2 < MENDED * (1.0 - np.maximum(self.paired, 0.0) ** 2)
        small = self.scale < _INVERTED * np.median(self.scale[sure]) if sure.any() else ~sure
        return tuple(np.flatnonzero(turned & sure & clearer & ~small).tolist())

    @property
    def alike(self) -> bool:
        """Whether all columns that move are the expected ones."""
        return not self.wrong and bool(np.median(self.paired) > HARDLY)

    @property
    def words(self) -> str:
        """The wrong columns in words, such as "x is -y"."""
        if not self.exchanged[list(self.wrong)].any():
            return "wrong sign"
        minus = {i: "-" * int(self.sign[i] < 0) for i in self.wrong}
        part = self.parts
        return ", ".join(f"{part[i]} is {s}{part[self.order[i]]}" for i, s in minus.items())

    def corrected(self, *kinds: str) -> Changes:
        """Changes of the map that correct each wrong column of some kinds."""
        entry: dict[str, dict[str, Any]] = {}
        for kind in kinds:
            for i in self.wrong:
                column, own = (f"{kind}_{self.parts[k]}" for k in (self.order[i], i))
                of = {"of": own} if own != column else {}
                entry[column] = of | ({"sign": -1.0} if self.sign[i] < 0 else {})
        return {"columns": entry}

    def finding(self, kind: str, witness: str) -> Finding:
        """The finding for columns of a kind that do not measure what a witness says of them."""
        columns = tuple(f"{kind}_{self.parts[i]}" for i in self.wrong)
        seen = f"correlation with {witness} {self.paired[list(self.wrong)].max():.2f} at most"
        return Finding(columns, seen, self.words, self.corrected(kind))


def match_axes(
    measured: np.ndarray, expected: np.ndarray, parts: Sequence[str] = "xyz"
) -> AxesMatch:
    """Match the columns of `measured` (M, D) to those of `expected` (M, D), by their variation
    alone; `parts` are their names.
    """
    a, b = measured - measured.mean(axis=0), expected - expected.mean(axis=0)
    sizes = np.linalg.norm(a, axis=0)[:, None] * np.linalg.norm(b, axis=0)[None]
    both = a.T @ b
    alike = both / np.where(sizes > 0, sizes, np.inf)
    rows, order = linear_sum_assignment(np.abs(alike) + 1e-9 * np.eye(len(alike)), maximize=True)
    matched = alike[rows, order]
    power = np.sum(b**2, axis=0)[order]
    scale = both[rows, order] / np.where(power > 0, power, np.inf)
    sign = np.where(matched < 0, -1.0, 1.0)
    return AxesMatch(order, sign, np.diag(alike), np.abs(matched), np.abs(scale), parts)


def in_another_unit(
    kind: str, columns: Sequence[str], factor: float, otherwise: str
) -> tuple[str, Changes]:
    """Cause, and changes of the map, of columns of a kind that are `factor` times their SI values.

    `otherwise` is the cause where no unit is near to that.
    """
    factor, (si, *_) = max(factor, 1e-9), UNITS[kind]
    sizes = UNITS[kind] | _WITHOUT_WORD.get(kind, {})
    unit = min(sizes, key=lambda one: abs(log(factor * sizes[one])))
    if unit == si or abs(log(factor * sizes[unit])) > log(NEAR):
        return otherwise, {}
    return f"in {unit}, not {si}", entries(columns, unit=unit) if unit in UNITS[kind] else {}


def of_scale(
    columns: Sequence[str], factors: np.ndarray, expected: str, otherwise: str, error: np.ndarray
) -> Iterator[Finding]:
    """The findings for rates that are `factors` (D,) times the expected ones: with a factor that
    most of them have, or with one of their own.

    Args:
        columns: their names.
        factors: (D,).
        expected: name of these.
        otherwise: cause of a common factor that is that of no unit.
        error: (D,) of the factors; what lies between samples makes them smaller, never larger.
    """
    typical = float(np.median(factors))
    together = np.abs(factors / typical - 1.0) < 2.0 * SCALED
    as_expected = -SCALED - np.median(error) < typical - 1.0 < SCALED
    common = 1.0 if as_expected or 2 * together.sum() <= len(columns) else typical
    for column, factor, unsure in zip(columns, factors.tolist(), error, strict=True):
        if abs(factor / common - 1.0) > 2.0 * SCALED + unsure:
            changes = scaled(column, factor / common)
            yield Finding((column,), f"{factor:.3g} times {expected}", "scaled", changes)
        elif common != 1.0:
            cause, changes = in_another_unit("gyro", (column,), common, otherwise)
            yield Finding((column,), f"{common:.3g} times {expected}", cause, changes)


def angle_between(a: np.ndarray, b: np.ndarray) -> float:
    """Angle between two vectors (3,) [deg]."""
    size = max(float(np.linalg.norm(a) * np.linalg.norm(b)), 1e-9)
    return float(np.degrees(np.arccos(np.clip(a @ b / size, -1.0, 1.0))))


def misread(
    kind: str,
    parts: Sequence[str],
    at: np.ndarray,
    x: np.ndarray,
    expected: np.ndarray,
    witness: str,
) -> tuple[list[Finding], AxesMatch]:
    """The findings for columns of a kind that change their sign on the way, are other columns, or
    have the opposite sign; and the match of those that do not change, 0 for the others.

    Args:
        kind: of the columns, such as dq.
        parts: their names (D,).
        at: times (M,) [s].
        x: (M, D), what they read.
        expected: (M, D), what they should.
        witness: name of that.
    """
    found, steady = [], x.copy()
    for i, part in enumerate(parts):
        turn = _changes_sign(x[:, i], expected[:, i])
        if turn is not None:
            seen = f"at {at[turn]:.2f} s, relative to {witness}"
            cause = "its sign, or that of its angle, changes during the log"
            found.append(Finding((f"{kind}_{part}",), seen, cause))
            steady[:, i] = 0.0
    match = match_axes(steady, expected, parts)
    return found + ([match.finding(kind, witness)] if match.wrong else []), match


def _changes_sign(x: np.ndarray, expected: np.ndarray) -> int | None:
    """Row from which x (M,) has the other sign relative to what is expected (M,); None if it has
    the same throughout.
    """
    # Clip outliers: an angle that changes its sign jumps.
    most = [np.quantile(np.abs(y), 0.95) for y in (x, expected)]
    a, b = (np.clip(y, -m, m) for y, m in zip((x, expected), most, strict=True))
    both = np.cumsum(a * b)
    k = int(np.argmax(np.abs(both) + np.abs(both[-1] - both)))
    before, after = both[k], both[-1] - both[k]
    whole = np.linalg.norm(a) * np.linalg.norm(b)
    least = min(abs(before), abs(after))
    turns = before * after < 0.0 and least > _TURNED * whole
    return k if turns and abs(before - after) > LIKELY * whole else None


def lag_of(
    lagging: np.ndarray, witness: np.ndarray, step: float, most: float
) -> tuple[float, float]:
    """Delay [s] of `lagging` (M, D) relative to `witness` (M, D), and their mean correlation at it.

    Rows are `step` apart, and the delay is at most `most` in size. Columns have equal weight.
    """
    reach = min(round(most / step), len(lagging) // 3)
    rows = len(lagging) - 2 * reach
    shifts = np.arange(-reach, reach + 1)
    # Standardise each window of `lagging` by itself: a common mean and size would favour windows
    # with more motion, and shift the maximum for slow motion by half a step.
    b = _standardised(witness[reach : reach + rows])
    scores = [
        float(np.mean(_standardised(lagging[first : first + rows]) * b)) for first in shifts + reach
    ]
    k = int(np.argmax(scores))
    if k in (0, len(scores) - 1):
        return 0.0, scores[reach]
    before, top, after = scores[k - 1 : k + 2]
    bend = before - 2.0 * top + after
    part = 0.5 * (before - after) / bend if bend else 0.0
    return step * float(shifts[k] + part), top


def delay_between(t: np.ndarray, lagging: np.ndarray, witness: np.ndarray, most: float) -> float:
    """Delay [s], at most `most`, of `lagging` (N, D) relative to `witness` (N, D), at t (N,) [s];
    0 where they do not correlate.
    """
    if len(t) < _FEWEST_ROWS:
        return 0.0
    t = with_short_gaps(t, 2.0 * most)
    step = float(np.median(np.diff(t)))
    even = np.arange(t[0], t[-1], step)
    a, b = (interpolate_rows(even, t, x) for x in (lagging, witness))
    delay, alike = lag_of(a, b, step, most + step)
    return delay if alike > HARDLY else 0.0


def number_words(values: Sequence[float] | np.ndarray) -> str:
    """Numbers with two decimals."""
    return ", ".join(f"{x:.2f}" for x in values)


def _standardised(x: np.ndarray) -> np.ndarray:
    """Columns of (M, D) with mean 0 and standard deviation 1; 0 for a constant one."""
    x = x - x.mean(axis=0)
    return x / np.maximum(x.std(axis=0), 1e-12)
