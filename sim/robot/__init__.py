"""Robot models from MJCF: legs, kinematics, home pose and catalog."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from surefoot.sim.robot.robot import DeclaredExtras, Robot

__all__ = ["DeclaredExtras", "Robot"]
# Imported on first use, since the catalog needs neither MuJoCo nor the kernels.
_LATE = {
    "DeclaredExtras": "surefoot.sim.robot.robot:DeclaredExtras",
    "Robot": "surefoot.sim.robot.robot:Robot",
}


def __getattr__(name: str) -> Any:
    if name not in _LATE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, attribute = _LATE[name].split(":")
    return getattr(import_module(module), attribute)
