"""Units in which a stream may have been logged."""

from collections.abc import Sequence
from math import log, pi

from surefoot.sim.importing.advice import Changes, entries
from surefoot.sim.importing.columns import UNITS

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
