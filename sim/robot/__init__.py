"""Robot models from MJCF: legs, kinematics, home pose and catalog.

Imported on first use, since the catalog needs neither MuJoCo nor the kernels.
"""

# ruff: noqa: F401
from typing import TYPE_CHECKING

from surefoot.lazy import lazy_names

if TYPE_CHECKING:
    from surefoot.sim.robot.robot import DeclaredExtras, Robot

__getattr__, __dir__ = lazy_names(globals())
