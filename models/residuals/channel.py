"""Interface of a residual channel: its columns, the readings it needs, residual and noise.

A channel of your own is one class, registered by the entry point group `surefoot.channels`:

    class Temperature(Channel):
        name = "temperature"
        unit = "K"
        needs = ("x_temperature",)

        def columns(self, limbs): ...
        def residual(self, inputs): ...
        def noise(self, sensors, rate, evenness): ...

It then appears in the residual table, in the attribution of effects, in noise floors, reports and
figures, like the bundled ones.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np

from surefoot.models.residuals.binning import Bins, ReferenceMotion, binned
from surefoot.models.residuals.feet import between_feet, leg_velocities
from surefoot.models.residuals.soft_ground import foot_sinking
from surefoot.models.residuals.torques import (
    DynamicsInputs,
    InverseDynamics,
    curvature,
    dynamics_inputs,
    inverse_dynamics,
)
from surefoot.sim.log import Log
from surefoot.sim.robot.feet import Feet, shown_feet
from surefoot.sim.robot.limbs import Limbs
from surefoot.sim.robot.machine import Machine
from surefoot.sim.sensors.streams import Sensors

OF_WALKS = ("contact", "reference")
"""Groups of columns that a machine on a fixed base does not need."""


@dataclass(frozen=True)
class Column:
    """One column of a residual table.

    Groups and kinds are local to a channel; other channels may use the same words.

    Attributes:
        name: unique in the table.
        unit: of the values.
        group: columns from one reading, which lose weight together where it is an outlier.
        kind: columns with the same noise level, which is estimated from all of them.
        leg: index of the foot whose stance or swing fills the column; None where it is no foot's.
    """

    name: str
    unit: str
    group: str
    kind: str
    leg: int | None = None


@dataclass(frozen=True)
class ResidualInputs:
    """Inputs of the residuals: a log under a model; the properties are computed on first use.

    Attributes:
        log: the log.
        robot: its model.
        motion: reference motion that readings are compared with.
    """

    log: Log
    robot: Machine
    motion: ReferenceMotion

    @cached_property
    def bins(self) -> Bins:
        """Bin means of the readings, with the sinkage of the feet on soft ground."""
        bins, robot = binned(self.log, self.robot, self.motion), self.robot.legged
        stands = self.log.has("q") and bins.standing.any() and self.motion.by_reference
        if robot is None or not (stands and robot.extras.softness):
            return bins
        depth, v_sole = foot_sinking(self.log, robot, self.motion, bins)
        return replace(bins, depth=depth, v_sole=v_sole)

    @cached_property
    def steps(self) -> DynamicsInputs:
        """Inputs of inverse dynamics."""
        steps, robot = dynamics_inputs(self.bins, self.robot), self.robot
        if robot.fixed and robot.dynamics is not None and self.log.has("q"):
            steps = replace(steps, curved=curvature(self.log, self.motion, robot.dynamics))
        return steps

    @cached_property
    def inverse_dynamics(self) -> InverseDynamics | None:
        """Inverse dynamics of the motion; None where the log has no torques, or the machine no
        model.
        """
        return inverse_dynamics(self.steps, self.robot) if self.log.has("tau") else None

    @cached_property
    def feet(self) -> Feet | None:
        """The feet, where the log shows them and any of them stands."""
        shown = shown_feet(self.log, self.robot.feet)
        return shown if shown is not None and self.bins.standing.any() else None

    @cached_property
    def link_jacobians(self) -> np.ndarray:
        """Derivatives (5, J, nv, K) of the generalised forces by each link's mass, centre and
        inertia, in the K needed bins, of a machine with a model.
        """
        assert self.robot.dynamics is not None
        return self.robot.dynamics.link_derivatives(*self.steps.motion)

    @cached_property
    def leg_velocities(self) -> np.ndarray | None:
        """Velocity of the body by each standing foot less the reference's (M, 3 L) [m/s] in I.

        Without a reference, the feet are compared with each other. None where no foot stands, or
        the log shows no feet.
        """
        if self.feet is None:
            return None
        v = leg_velocities(self.bins, self.feet)
        return v if self.motion.by_reference else between_feet(v)


class Channel:
    """A residual: readings of a log minus the model's prediction, as means over bins."""

    name: ClassVar[str]
    unit: ClassVar[str]
    label: ClassVar[str] = ""
    """Title in figures; by default the name without underscores."""
    needs: ClassVar[tuple[str, ...]]
    """Groups of columns that the channel needs, as for `Log.require`."""
    on_fixed_base: ClassVar[bool] = False
    """Whether a machine on a fixed base has it, without contacts and a reference."""
    on_given_feet: ClassVar[bool] = False
    """Whether a machine that is known by its feet alone has it (`sim.robot.machine`); the feet
    then replace joint angles.
    """
    imu_replaces_reference: ClassVar[bool] = False
    """Whether the IMU replaces the reference where a walk of a robot with a model has none."""
    on_level_ground: ClassVar[bool] = False
    """Whether it is valid on level ground only; its level is then evaluated on ground that no fit
    has seen.
    """
    masked_by: ClassVar[tuple[str, ...]] = ()
    """What invalidates the columns of a foot: that it "slid", or stood "elsewhere" than at its
    other steps. Columns that belong to no foot are masked when any foot did.
    """
    least_noise: ClassVar[float] = 1e-12
    """Resolution [unit]: the noise is never taken to be less."""
    of_events: ClassVar[bool] = False
    """Whether it is the time of an event, which a small change of the body does not move."""
    level_spread: ClassVar[Mapping[str, float]] = {}
    """Target of an effect -> standard deviation [unit] of the channel's level between robots, where
    it is known from simulated walks of several models.
    """
    evaluation_only: ClassVar[bool] = False
    """Whether the channel is used for evaluation only and never fitted."""

    def columns(self, limbs: Limbs) -> tuple[Column, ...]:
        """Its columns for a machine with these legs and joints; empty where it has no meaning."""
        raise NotImplementedError

    def residual(self, inputs: ResidualInputs) -> np.ndarray | None:
        """Values (M, columns), NaN where there is none; None where the log has none at all."""
        raise NotImplementedError

    def noise(self, sensors: Sensors, rate: float, evenness: float) -> float:
        """Standard deviation [unit] of a bin from sensor noise alone.

        Args:
            sensors: noise of the declared sensors.
            rate: of the log [Hz].
            evenness: standard deviation of the ground's height [m].
        """
        raise NotImplementedError

    def nuisance_regressors(self, inputs: ResidualInputs) -> Sequence[np.ndarray]:
        """Regressors of nuisance parameters of each log, (M, 1) or (M, columns), without bounds;
        what they are where the residual has no value does not matter.
        """
        return ()

    def is_available(self, log: Log, fixed: bool, level: bool, by_feet: bool = False) -> bool:
        """Whether a log has what it needs, on a `fixed` base or not, on `level` ground or not;
        `by_feet`: of a machine that is known by its feet alone.
        """
        if (fixed and not self.on_fixed_base) or (self.on_level_ground and not level):
            return False
        return not self.missing_groups(log, fixed, by_feet)

    def missing_groups(self, log: Log, fixed: bool, by_feet: bool = False) -> tuple[str, ...]:
        """Groups of columns that it needs and the log lacks, on a `fixed` base or not; `by_feet`:
        of a machine that is known by its feet alone.
        """
        needed = [g for g in self.needs if not (fixed and g in OF_WALKS)]
        if by_feet:
            needed = ["foot" if g == "q" else g for g in needed]
        by_imu = self.imu_replaces_reference and not (fixed or by_feet)
        if by_imu and not log.has("reference"):
            needed = ["imu", *(g for g in needed if g != "reference")]
        return tuple(g for g in needed if not log.has(g))

    def is_defined_for(self, log: Log, motion: ReferenceMotion) -> bool:
        """Whether it is defined for a log with this motion, which may not be from a reference."""
        if motion.by_reference:
            return True
        return log.has("imu") if self.imu_replaces_reference else "reference" not in self.needs
