"""Gaits by name: phase of each foot, duty factor, and stride period.

A gait of your own is a class with these attributes, registered by the entry point group
`surefoot.gaits`; a scenario selects it by `[gait] pattern = "NAME"`.
"""

from dataclasses import dataclass

import numpy as np

from surefoot.sim.common.errors import SurefootError, check_known
from surefoot.sim.common.plugins import Registry


@dataclass(frozen=True)
class Pattern:
    """A gait.

    Attributes:
        phase: of FL, FR, RL and RR: delay of the touchdown, as a share of the stride.
        duty: least duty factor.
        period: of the stride, relative to the trot's.
        sway: how far the centre of pressure moves from below the body to the middle of the standing
            feet, from 0 to 1; optional in a class of your own.
    """

    phase: tuple[float, float, float, float]
    duty: float
    period: float = 1.0
    sway: float = 0.0


# Alexander, "The gaits of bipedal and quadrupedal animals", IJRR 1984: relative phases and duty
# factors. A walk is a lateral sequence: each hind foot lands before the fore foot of its side.
# Without sway, the foot diagonal to the swinging one would bear no load.
_BUNDLED = {
    "trot": Pattern((0.0, 0.5, 0.5, 0.0), 0.0),
    "walk": Pattern((0.0, 0.5, 0.75, 0.25), 0.78, 1.6, 0.5),
    "pace": Pattern((0.0, 0.5, 0.0, 0.5), 0.6, 0.7),
}


def _check(pattern: Pattern) -> None:
    """Raise SurefootError for an invalid gait."""
    phase = np.asarray(pattern.phase, dtype=float)
    if phase.shape != (4,) or not ((phase >= 0.0) & (phase < 1.0)).all():
        raise SurefootError("phase must be four numbers from 0 to below 1")
    duty, period, sway = pattern.duty, pattern.period, getattr(pattern, "sway", 0.0)
    if not (0.0 <= duty <= 0.9 and 0.1 <= period <= 10.0 and 0.0 <= sway <= 1.0):
        raise SurefootError("duty must be from 0 to 0.9, period from 0.1 to 10, sway from 0 to 1")


PATTERNS = Registry("surefoot.gaits", _BUNDLED, ("phase", "duty", "period"), _check)
"""Name -> gait."""


def pattern_named(name: str) -> Pattern:
    """The gait of that name. Raises SurefootError naming the known ones."""
    check_known("pattern", name, PATTERNS)
    return PATTERNS[name]
