"""Causes that several rules find: another unit, other axes, a sign that changes on the way."""

from collections.abc import Sequence
from math import log, pi
from typing import Any

from surefoot.sim.importing.advice import Changes, entries
from surefoot.sim.importing.columns import UNITS
from surefoot.sim.plausibility.axes import AxesMatch
from surefoot.sim.plausibility.finding import Finding

NEAR = 1.2
"""Largest ratio of a stream's scale to that of the unit it is taken to be in."""
_WITHOUT_WORD = {
    "accel": {"ft/s^2": 0.3048, "cm/s^2": 1e-2, "mm/s^2": 1e-3},
    "gyro": {"mrad/s": 1e-3, "turns/s": 2.0 * pi},
    "ref_v": {"km/h": 1.0 / 3.6, "inches/s": 0.0254, "feet/s": 0.3048},
}
"""SI values of units that an import map has no word for, by kind of column."""


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


def in_other_axes(match: AxesMatch, kind: str, witness: str) -> Finding:
    """The finding for axes of a vector that do not measure what a witness says of them."""
    columns = tuple(f"{kind}_{'xyz'[i]}" for i in match.wrong)
    seen = f"correlation with {witness} {match.own_words}"
    return Finding(columns, seen, match.words, axes_put_right(match, kind))


def axes_put_right(match: AxesMatch, *kinds: str) -> Changes:
    """Changes of the map that correct each wrong axis of vectors of some kinds."""
    entry: dict[str, dict[str, Any]] = {}
    for kind in kinds:
        for i in match.wrong:
            axis, own = (f"{kind}_{'xyz'[k]}" for k in (match.order[i], i))
            of = {"of": own} if own != axis else {}
            entry[axis] = of | ({"sign": -1.0} if match.sign[i] < 0 else {})
    return {"columns": entry}


def of_changing_sign(column: str, since: float, expected: str) -> Finding:
    """The finding for a stream with another sign `since` some time [s]."""
    seen = f"at {since:.2f} s, relative to {expected}"
    return Finding((column,), seen, "its sign, or that of its angle, changes during the log")
