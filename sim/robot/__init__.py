"""Robot models from MJCF: legs, kinematics, home pose and catalog."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from surefoot.sim.robot.robot import DeclaredExtras, Robot

__all__ = ["DeclaredExtras", "Robot"]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    # Imported on first use, since the catalog needs neither MuJoCo nor the kernels.
    return getattr(import_module("surefoot.sim.robot.robot"), name)
