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
    from surefoot.estimator.filter import CoverageSettings, InvariantFilter, PersistentFilter
    from surefoot.estimator.leg import LegFilter
    from surefoot.estimator.metrics import align_first, nees
    from surefoot.estimator.updates.bias_states import PersistentError
    from surefoot.models.bootstrap import block_bootstrap_counts
    from surefoot.models.calibration.bias_model import BOUNDED_MEAN, estimate_bias_model
    from surefoot.models.calibration.regions import (
        BoundsError,
        Calibrator,
        Conformal,
        Region,
        conformal_quantile,
        least_rank,
        level_per_axis,
        mahalanobis,
    )
    from surefoot.models.observer.network import Architecture
    from surefoot.models.observer.predict import prediction_errors
    from surefoot.models.observer.samples import RATE as OBSERVER_RATE
    from surefoot.models.registry import ARCHITECTURES
    from surefoot.models.residuals.binning import BIN, ReferenceMotion, bin_mean
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
    from surefoot.scenarios.estimate.run import declared_model, estimated
    from surefoot.sim.common.copies import copy_corner, copy_row
    from surefoot.sim.common.errors import SurefootError, did_you_mean
    from surefoot.sim.common.gravity import GRAVITY, GRAVITY_G
    from surefoot.sim.common.kernels import kernel
    from surefoot.sim.common.limits import check_limit
    from surefoot.sim.common.quaternion import quaternion_from_matrix
    from surefoot.sim.common.series import white_noise
    from surefoot.sim.common.toml import Count, Level, NonNegative, Positive, read_toml, read_typed
    from surefoot.sim.effects import compensate_all, effect, known_effects
    from surefoot.sim.effects.base import AXES, Effect, Prior, Traced, with_columns
    from surefoot.sim.effects.body import FootRolling
    from surefoot.sim.effects.creep import Way, way_by_feet
    from surefoot.sim.effects.drive import DriveEffect
    from surefoot.sim.effects.readings import Offset, Scale
    from surefoot.sim.effects.timing import Delay
    from surefoot.sim.gait.options import Pattern
    from surefoot.sim.ground.terrain import Ground, HeightField, Patch, Strip
    from surefoot.sim.log import Log, joint_velocity, reference_velocity, with_velocities
    from surefoot.sim.log.derived import JOINT_WINDOW, derivative
    from surefoot.sim.physics.loads import STICTION_RATE
    from surefoot.sim.robot import Robot
    from surefoot.sim.robot.body_changes import LinkChange
    from surefoot.sim.robot.catalog import known_robots, robot_file
    from surefoot.sim.robot.legs import JOINTS
    from surefoot.sim.robot.limbs import Limbs
    from surefoot.sim.robot.machine import Machine, Modelled, machine_for_log
    from surefoot.sim.scenario import Ranges, Scenario, Segment
    from surefoot.sim.scenario_catalog import bundled_scenarios
    from surefoot.sim.sensors.stances import stance_phase
    from surefoot.sim.sensors.streams import Motion, Sensors, Streams
    from surefoot.sim.walking.dm_environment import WalkingEnvironment

__getattr__, __dir__ = lazy_names(globals())
