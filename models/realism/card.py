"""The realism card: one number a row, of a measured walk and of simulated ones in its manner."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from typing import Literal

import numpy as np

from surefoot.models.realism.quantities import QUANTITIES, Quantity
from surefoot.models.realism.walk_view import WalkView
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.files import bundled
from surefoot.sim.common.toml import Positive, read_typed
from surefoot.sim.effects.carry import BodyScale, growth

DRAWS = 400
"""Of the stride bootstrap."""
INTERVAL = (2.5, 97.5)
"""Percentiles of a 95 % interval."""

CARD_DIMENSIONS = {
    "share": (0, 0, 0),
    "ratio": (0, 0, 0),
    "m": (0, 1, 0),
    "s": (0, 0, 1),
    "m/s": (0, 1, -1),
    "m/s^2": (0, 1, -2),
    "rad/s": (0, 0, -1),
    "Hz": (0, 0, -1),
}
"""Unit of a quantity -> powers of weight, leg length and stride period that it grows by."""

Verdict = Literal["like", "unlike", "undecided"]


@dataclass(frozen=True)
class Tolerance:
    """How far simulated may be from measured: in the quantity's unit, or as a share of the measured
    value. Why, in words."""

    within: Positive
    reason: str
    relative: bool = False


@cache
def tolerances() -> dict[str, Tolerance]:
    """Of every quantity, by its name."""
    return read_typed(
        bundled("surefoot.models.realism", "tolerances.toml"), dict[str, Tolerance], "tolerances"
    )


@dataclass(frozen=True)
class Row:
    """A quantity of both walks, with 95 % intervals by drawing strides anew, in `unit`.

    verdict: "like" where the difference's whole interval is within the tolerance, "unlike" where
    all of it is beyond, else "undecided".
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

    def as_dict(self) -> dict[str, float | str]:
        return asdict(self)


@dataclass(frozen=True)
class Card:
    """rows: of what both have; missing: quantity -> why one of them has not."""

    rows: tuple[Row, ...]
    missing: dict[str, str]

    @property
    def counts(self) -> dict[str, int]:
        """Rows of each verdict."""
        said = [row.verdict for row in self.rows]
        return {word: said.count(word) for word in ("like", "unlike", "undecided")}


def realism_card(
    measured: WalkView,
    simulated: Sequence[WalkView],
    rng: np.random.Generator,
    scales: tuple[BodyScale, BodyScale] | None = None,
) -> Card:
    """The card of a measured walk beside simulated ones, whose strides are taken together.

    Args:
        measured: the walk of the log.
        simulated: walks in its manner.
        rng: draws strides anew.
        scales: of the measured robot and of the simulated one where it is another; what was
            measured, and the tolerances, are carried to it (`sim.effects.carry`).
    """
    rows, missing = [], {}
    for quantity in QUANTITIES:
        grown = growth(CARD_DIMENSIONS[quantity.unit], *scales) if scales else 1.0
        try:
            rows.append(_row(quantity, measured, simulated, rng, grown))
        except SurefootError as error:
            missing[quantity.name] = str(error)
    return Card(tuple(rows), missing)


def _row(
    quantity: Quantity,
    measured: WalkView,
    simulated: Sequence[WalkView],
    rng: np.random.Generator,
    grown: float,
) -> Row:
    """A row, what was measured and its absolute tolerance times `grown`.

    Args:
        quantity: of the row.
        measured: the walk of the log.
        simulated: walks in its manner.
        rng: draws strides anew.
        grown: by how much the quantity is larger on the simulated robot.
    """
    real, real_draws = estimate(quantity, [measured], rng)
    real, real_draws = grown * real, grown * real_draws
    made, made_draws = estimate(quantity, simulated, rng)
    one = tolerances()[quantity.name]
    within = one.within * (abs(real) if one.relative else grown)
    low, high = _interval(made_draws - real_draws)
    return Row(
        quantity.name,
        quantity.unit,
        real,
        *_interval(real_draws),
        made,
        *_interval(made_draws),
        made - real,
        low,
        high,
        within,
        _verdict(low, high, within),
        one.reason,
    )


def _interval(draws: np.ndarray) -> tuple[float, float]:
    low, high = np.percentile(draws, INTERVAL)
    return float(low), float(high)


def estimate(
    quantity: Quantity, walks: Sequence[WalkView], rng: np.random.Generator
) -> tuple[float, np.ndarray]:
    """The number of some walks together, and what it is for strides drawn anew (DRAWS,).

    Values of one stride, of all its legs, are drawn together. Raises SurefootError where a walk
    cannot give it, or gives too little to draw from.
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
    everything = np.concatenate(values)
    return quantity.statistic(everything), _drawn(everything, groups, quantity.statistic, rng)


def _drawn(
    values: np.ndarray,
    groups: Sequence[np.ndarray],
    statistic: Callable[[np.ndarray], float],
    rng: np.random.Generator,
) -> np.ndarray:
    picks = rng.integers(len(groups), size=(DRAWS, len(groups)))
    return np.array([statistic(values[np.concatenate([groups[i] for i in p])]) for p in picks])


def _verdict(low: float, high: float, within: float) -> Verdict:
    if -within <= low and high <= within:
        return "like"
    return "unlike" if low > within or high < -within else "undecided"
