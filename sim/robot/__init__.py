"""Robot models from MJCF: legs, kinematics, home pose and catalogue.

Imported on first use, since the catalogue needs neither MuJoCo nor the kernels.
"""

# ruff: noqa: F401
from typing import TYPE_CHECKING

from surefoot.lazy import lazy_names

if TYPE_CHECKING:
    from surefoot.sim.robot.robot import DeclaredExtras, Robot

__getattr__, __dir__ = lazy_names(globals())
