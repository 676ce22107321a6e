"""Every estimator by name: those that come with surefoot, then those that users add."""

from __future__ import annotations

from typing import TYPE_CHECKING

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.plugins import Registry
from surefoot.sim.common.sources import sources_digest

if TYPE_CHECKING:  # names alone come without compiled kernels, which are slow to load
    from surefoot.scenarios.estimate.contract import Estimator

REQUIRED = ("name", "label", "description", "needs", "parameters", "start")
"""What a class must have to be an estimator: see `surefoot.scenarios.estimate.contract`."""

_BUNDLED = "surefoot.scenarios.estimate.bundled"
ESTIMATORS = Registry(
    "surefoot.estimators",
    {
        "coverage": f"{_BUNDLED}:Coverage",
        "coverage_gml": f"{_BUNDLED}:CoverageGml",
        "coverage_persistent": f"{_BUNDLED}:CoveragePersistent",
        "velocity": f"{_BUNDLED}:Velocity",
        "velocity_inflated": f"{_BUNDLED}:VelocityInflated",
        "velocity_persistent": f"{_BUNDLED}:VelocityPersistent",
        "leg": f"{_BUNDLED}:Leg",
        "leg_slip": f"{_BUNDLED}:LegSlip",
        "radar_leg": f"{_BUNDLED}:RadarLeg",
        "imu": f"{_BUNDLED}:Imu",
    },
    REQUIRED,
)
"""Name -> class."""


def estimator_named(name: str) -> Estimator:
    """The estimator of that name. Raises SurefootError naming those there are."""
    if name not in ESTIMATORS:
        raise SurefootError(f"--filter {name}: unknown; choose {' | '.join(ESTIMATORS)}")
    found = ESTIMATORS[name]()
    if found.name != name:
        raise SurefootError(f"--filter {name}: its class calls itself {found.name}")
    return found


def estimator_code(name: str) -> str:
    """Digest of the code that an estimator is made of: what products of it are kept under."""
    return sources_digest(ESTIMATORS[name].__module__)
