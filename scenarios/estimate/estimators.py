"""Registry of the estimators: the bundled ones, then those of plug-ins."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

from surefoot.sim.common.errors import SurefootError, check_known
from surefoot.sim.common.plugins import Registry
from surefoot.sim.common.sources import code_digest

if TYPE_CHECKING:  # names alone come without compiled kernels, which are slow to load
    from surefoot.scenarios.estimate.contract import Estimator

REQUIRED = ("name", "description", "needs", "parameters", "start")
"""Members that an estimator's class must have; see `surefoot.scenarios.estimate.contract`."""

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


def check_filter(name: str) -> None:
    """Raise SurefootError, naming the known estimators, for another name."""
    check_known("filter", name, ESTIMATORS)


def estimator_named(name: str) -> Estimator:
    """The estimator of that name. Raises SurefootError like `check_filter`."""
    check_filter(name)
    kind = ESTIMATORS[name]
    with ESTIMATORS.running(name):
        return kind()


@dataclass(frozen=True)
class Traits:
    """Optional members of an estimator's class, with their defaults.

    Attributes:
        color: matplotlib's "#RRGGBB"; chosen by the name if empty.
        line: matplotlib's "-", "--", ":" or "-."; chosen by the name if empty.
        drawn: False if its errors would hide the others' in plots.
        variant: whether it is a variation of another estimator, omitted in short comparisons.
        perceptive: whether it uses exteroceptive sensors, and so is not ranked with the others.
        floor: whether it is the baseline for all others, and so is not ranked either.
        rejecting: name of the same filter with a test that rejects slipping feet, if any.
        of_legs: whether its velocities come from leg kinematics.
        proposed: the method with the highest value among those run is compared with the others in
            the findings of an experiment; 0 for no such method.
    """

    color: str = ""
    line: str = ""
    drawn: bool = True
    variant: bool = False
    perceptive: bool = False
    floor: bool = False
    rejecting: str = ""
    of_legs: bool = False
    proposed: int = 0


def traits(name: str) -> Traits:
    """Traits of an estimator; the defaults for one that is unknown or broken."""
    try:
        kind = ESTIMATORS.get(name)
    except SurefootError:
        kind = None
    names = [each.name for each in fields(Traits) if hasattr(kind, each.name)]
    return Traits(**{name: getattr(kind, name) for name in names})


AT_FIRST = 4
"""Number of estimators that a recording shows initially; more would hide each other."""


def shown_at_first(names: Sequence[str]) -> tuple[str, ...]:
    """Select among these estimators, in their order: proposed ones first, then those that are no
    variants, then others.
    """
    ranked = sorted(names, key=lambda name: (not traits(name).proposed, traits(name).variant))
    return tuple(name for name in names if name in ranked[:AT_FIRST])


def estimator_code(name: str) -> str:
    """Digest of an estimator's code, under which its products are cached."""
    return code_digest(ESTIMATORS[name])
