"""The realism card: a measured walk and simulated ones compared, one quantity a row."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np

from surefoot.models.realism.quantities import QUANTITIES, Quantity
from surefoot.models.realism.walk_view import WalkView
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.files import bundled
from surefoot.sim.common.toml import Positive, read_typed
from surefoot.sim.effects.carry import DIMENSIONS, BodyScale, growth

DRAWS = 400
"""Resamples of the bootstrap over strides."""
INTERVAL = (2.5, 97.5)
"""Percentiles of a 95 % interval."""

CARD_DIMENSIONS = DIMENSIONS | {
    "share": (0, 0, 0),
    "m/s": (0, 1, -1),
    "m/s^2": (0, 1, -2),
    "rad/s": (0, 0, -1),
    "Hz": (0, 0, -1),
}
"""Unit of a quantity -> the powers of weight, leg length and stride period that it scales with.
Rates and accelerations are those of the motion, and scale, unlike an IMU's errors.
"""

Verdict = Literal["like", "unlike", "undecided"]


@dataclass(frozen=True)
class Tolerance:
    """Largest accepted difference between the simulated and the measured value.

    Attributes:
        within: in the quantity's unit or, if `relative`, as a share of the measured value.
        reason: for this size.
        relative: whether `within` is a share.
    """

    within: Positive
    reason: str
    relative: bool = False


@cache
def tolerances() -> dict[str, Tolerance]:
    """Name of a quantity -> its tolerance, from tolerances.toml."""
    return read_typed(
        bundled("surefoot.models.realism", "tolerances.toml"), dict[str, Tolerance], "tolerances"
    )


@dataclass(frozen=True)
class Row:
    """One quantity of the measured and the simulated walks, in `unit`, with 95 % bootstrap
    intervals.

    The verdict is "like" if the whole interval of the difference is within the tolerance, "unlike"
    if all of it is outside, else "undecided".
    """

    quantity: str
    unit: str
    measured: float
    measured_low: float
    measured_high: float
    simulated: float
    simulated_low: float
    simulated_high: float
    difference: float
    difference_low: float
    difference_high: float
    tolerance: float
    verdict: Verdict
    reason: str


@dataclass(frozen=True)
class Card:
    """A realism card.

    Attributes:
        rows: one for each quantity.
        missing: quantity -> why a log lacks it.
    """

    rows: tuple[Row, ...]
    missing: dict[str, str]

    @property
    def counts(self) -> dict[str, int]:
        """Rows of each verdict."""
        verdicts = [row.verdict for row in self.rows]
        return {word: verdicts.count(word) for word in ("like", "unlike", "undecided")}


def realism_card(
    measured: WalkView,
    simulated: Sequence[WalkView],
    rng: np.random.Generator,
    scales: tuple[BodyScale, BodyScale] | None = None,
) -> Card:
    """Compare a measured walk with simulated ones, whose strides are pooled.

    Args:
        measured: the measured walk.
        simulated: walks in the same style.
        rng: for the bootstrap over strides.
        scales: of the measured and of the simulated robot, if they are different robots; the
            measured values and absolute tolerances are then scaled to the latter
            (`sim.effects.carry`).
    """
    rows, missing = [], {}
    for quantity in QUANTITIES:
        scale = growth(CARD_DIMENSIONS[quantity.unit], *scales) if scales else 1.0
        try:
            rows.append(_row(quantity, measured, simulated, rng, scale))
        except SurefootError as error:
            missing[quantity.name] = str(error)
    return Card(tuple(rows), missing)


def _row(
    quantity: Quantity,
    measured: WalkView,
    simulated: Sequence[WalkView],
    rng: np.random.Generator,
    scale: float,
) -> Row:
    """One row of the card.

    Args:
        quantity: of the row.
        measured: the measured walk.
        simulated: walks in the same style.
        rng: for the bootstrap over strides.
        scale: factor from the measured to the simulated robot, for the measured value and the
            absolute tolerance.
    """
    value, draws = estimate(quantity, [measured], rng)
    value, draws = scale * value, scale * draws
    simulated_value, simulated_draws = estimate(quantity, simulated, rng)
    tolerance = tolerances()[quantity.name]
    within = tolerance.within * (abs(value) if tolerance.relative else scale)
    low, high = _interval(simulated_draws - draws)
    return Row(
        quantity.name,
        quantity.unit,
        value,
        *_interval(draws),
        simulated_value,
        *_interval(simulated_draws),
        simulated_value - value,
        low,
        high,
        within,
        _verdict(low, high, within),
        tolerance.reason,
    )


def _interval(draws: np.ndarray) -> tuple[float, float]:
    low, high = np.percentile(draws, INTERVAL)
    return float(low), float(high)


def estimate(
    quantity: Quantity, walks: Sequence[WalkView], rng: np.random.Generator
) -> tuple[float, np.ndarray]:
    """The quantity over all walks together, and over resampled strides (DRAWS,).

    The values within one stride, of all legs, are resampled together. Raises SurefootError where a
    walk lacks the columns, or has too few strides to resample.
    """
    values, groups = [], []
    rows = 0
    for walk in walks:
        found, times = quantity.values(walk)
        stride = walk.stride_of(times)
        groups += [rows + np.flatnonzero(stride == k) for k in np.unique(stride)]
        values.append(found)
        rows += len(found)
    if len(groups) < 2:
        raise SurefootError("the walk is too short to tell how much it varies")
    everything, statistic = np.concatenate(values), quantity.statistic
    picks = rng.integers(len(groups), size=(DRAWS, len(groups)))
    draws = [statistic(everything[np.concatenate([groups[i] for i in p])]) for p in picks]
    return float(statistic(everything)), np.array(draws)


def _verdict(low: float, high: float, within: float) -> Verdict:
    if -within <= low and high <= within:
        return "like"
    return "unlike" if low > within or high < -within else "undecided"
