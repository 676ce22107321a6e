"""Every estimator by name: those that come with surefoot, then those that users add."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

from surefoot.sim.common.errors import SurefootError, did_you_mean
from surefoot.sim.common.plugins import Registry
from surefoot.sim.common.sources import code_digest

if TYPE_CHECKING:  # names alone come without compiled kernels, which are slow to load
    from surefoot.scenarios.estimate.contract import Estimator

REQUIRED = ("name", "label", "description", "needs", "parameters", "start")
"""What a class must have to be an estimator: see `surefoot.scenarios.estimate.contract`."""

ESTIMATORS = Registry(
    "surefoot.estimators",
    {
        "coverage": "surefoot.scenarios.estimate.bundled:Coverage",
        "coverage_gml": "surefoot.scenarios.estimate.bundled:CoverageGml",
        "coverage_persistent": "surefoot.scenarios.estimate.bundled:CoveragePersistent",
        "velocity": "surefoot.scenarios.estimate.bundled:Velocity",
        "velocity_inflated": "surefoot.scenarios.estimate.bundled:VelocityInflated",
        "velocity_persistent": "surefoot.scenarios.estimate.bundled:VelocityPersistent",
        "leg": "surefoot.scenarios.estimate.bundled:Leg",
        "leg_slip": "surefoot.scenarios.estimate.bundled:LegSlip",
        "radar_leg": "surefoot.scenarios.estimate.bundled:RadarLeg",
        "imu": "surefoot.scenarios.estimate.bundled:Imu",
    },
    REQUIRED,
)
"""Name -> class."""


def estimator_named(name: str) -> Estimator:
    """The estimator of that name. Raises SurefootError naming those there are."""
    if name not in ESTIMATORS:
        hint = did_you_mean(name, ESTIMATORS)
        raise SurefootError(f"--filter {name}: unknown; choose {' | '.join(ESTIMATORS)}{hint}")
    found = ESTIMATORS[name]()
    if found.name != name:
        raise SurefootError(f"--filter {name}: its class calls itself {found.name}")
    return found


@dataclass(frozen=True)
class Traits:
    """What an estimator's class may say of itself, and what holds where it does not.

    color, line: matplotlib's "#RRGGBB" and "-", "--", ":" or "-."; chosen by the name where empty.
    drawn: False for one whose errors would hide the others'. variant: whether it is another
    estimator of the list with a change, which short comparisons leave out. perceptive: whether it
    uses exteroceptive sensors, so that it is not ranked with proprioceptive ones. floor: whether it
    is what every other must improve on, and is not ranked either. of_legs: whether its velocities
    come from the kinematics of the legs. proposed: the highest number of those that were run is
    the method with which the findings of an experiment compare the others; 0 for no such method.
    """

    color: str = ""
    line: str = ""
    drawn: bool = True
    variant: bool = False
    perceptive: bool = False
    floor: bool = False
    of_legs: bool = False
    proposed: int = 0


def traits(name: str) -> Traits:
    """The traits of an estimator; the defaults for one that is unknown or broken."""
    try:
        kind = ESTIMATORS.get(name)
    except SurefootError:
        kind = None
    names = [each.name for each in fields(Traits) if hasattr(kind, each.name)]
    return Traits(**{name: getattr(kind, name) for name in names})


AT_FIRST = 4
"""Estimators that a recording shows at first: more hide each other."""


def shown_at_first(names: Sequence[str]) -> tuple[str, ...]:
    """Of these estimators those that are proposed, then those that are no variants, then others, in
    their order."""
    ranked = sorted(names, key=lambda name: (not traits(name).proposed, traits(name).variant))
    return tuple(name for name in names if name in ranked[:AT_FIRST])


def estimator_code(name: str) -> str:
    """Digest of the code that an estimator is made of: what products of it are kept under."""
    return code_digest(ESTIMATORS[name])
