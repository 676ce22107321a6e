"""What authors of plug-ins import: contracts, base classes and the parts that they build on.

The guides and examples of plug-ins use these names and those of `surefoot` alone. Each is imported
when it is first used, so that a plug-in needs only what its own kind needs.
"""

# ruff: noqa: F401
from typing import TYPE_CHECKING

from surefoot.lazy import lazy_names

if TYPE_CHECKING:
    from surefoot.estimator.core.state import FilterNoise, NavState
    from surefoot.estimator.evaluation.trajectory import Trajectory, reference
    from surefoot.estimator.filter import InvariantFilter, PersistentFilter
    from surefoot.estimator.leg import LegFilter
    from surefoot.models.calibration.conformal import (
        BoundsError,
        conformal_quantile,
        least_rank,
        level_per_axis,
    )
    from surefoot.models.calibration.regions import Calibrator, Region
    from surefoot.models.observer.network import Architecture
    from surefoot.models.residuals.binning import BIN, bin_mean
    from surefoot.models.residuals.channel import Channel, Column, ResidualInputs
    from surefoot.scenarios.estimate.contract import (
        Beginning,
        Estimator,
        Learnt,
        Needs,
        Parameter,
        Sample,
        Stream,
        Update,
        check_sample,
        measured,
        samples,
    )
    from surefoot.scenarios.estimate.estimators import Traits
    from surefoot.scenarios.estimate.run import estimated
    from surefoot.sim.common.copies import copy_corner, copy_row
    from surefoot.sim.common.errors import SurefootError
    from surefoot.sim.common.gravity import GRAVITY
    from surefoot.sim.common.kernels import kernel
    from surefoot.sim.common.quaternion import quaternion_from_matrix
    from surefoot.sim.effects import effect
    from surefoot.sim.effects.base import Effect, with_columns
    from surefoot.sim.effects.body import FootRolling
    from surefoot.sim.effects.targets import AXES
    from surefoot.sim.gait.patterns import Pattern
    from surefoot.sim.ground.terrain import Ground, HeightField, Patch, Strip
    from surefoot.sim.log import Log
    from surefoot.sim.robot import Robot
    from surefoot.sim.robot.catalog import robot_file
    from surefoot.sim.robot.legs import JOINTS
    from surefoot.sim.robot.limbs import Limbs
    from surefoot.sim.scenario import Ranges, Scenario, Segment
    from surefoot.sim.sensors.streams import Sensors, Streams
    from surefoot.sim.walking.dm_environment import WalkingEnvironment

_HOMES = {
    "estimator.core.state": ("FilterNoise", "NavState"),
    "estimator.evaluation.trajectory": ("Trajectory", "reference"),
    "estimator.filter": ("InvariantFilter", "PersistentFilter"),
    "estimator.leg": ("LegFilter",),
    "models.calibration.conformal": (
        "BoundsError",
        "conformal_quantile",
        "least_rank",
        "level_per_axis",
    ),
    "models.calibration.regions": ("Calibrator", "Region"),
    "models.observer.network": ("Architecture",),
    "models.residuals.binning": ("BIN", "bin_mean"),
    "models.residuals.channel": ("Channel", "Column", "ResidualInputs"),
    "scenarios.estimate.contract": (
        "Beginning",
        "Estimator",
        "Learnt",
        "Needs",
        "Parameter",
        "Sample",
        "Stream",
        "Update",
        "check_sample",
        "measured",
        "samples",
    ),
    "scenarios.estimate.estimators": ("Traits",),
    "scenarios.estimate.run": ("estimated",),
    "sim.common.copies": ("copy_corner", "copy_row"),
    "sim.common.errors": ("SurefootError",),
    "sim.common.gravity": ("GRAVITY",),
    "sim.common.kernels": ("kernel",),
    "sim.common.quaternion": ("quaternion_from_matrix",),
    "sim.effects": ("effect",),
    "sim.effects.base": ("Effect", "with_columns"),
    "sim.effects.body": ("FootRolling",),
    "sim.effects.targets": ("AXES",),
    "sim.gait.patterns": ("Pattern",),
    "sim.ground.terrain": ("Ground", "HeightField", "Patch", "Strip"),
    "sim.log": ("Log",),
    "sim.robot": ("Robot",),
    "sim.robot.catalog": ("robot_file",),
    "sim.robot.legs": ("JOINTS",),
    "sim.robot.limbs": ("Limbs",),
    "sim.scenario": ("Ranges", "Scenario", "Segment"),
    "sim.sensors.streams": ("Sensors", "Streams"),
    "sim.walking.dm_environment": ("WalkingEnvironment",),
}
__getattr__, __dir__ = lazy_names(globals(), _HOMES)
