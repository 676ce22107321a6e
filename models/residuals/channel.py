"""The contract of a residual channel: its columns, what it reads, its residual and its noise.

A channel of one's own is one class, offered by the entry point group `surefoot.channels`:

    class Temperature(Channel):
        name = "temperature"
        unit = "K"
        needs = ("x_temperature",)

        def columns(self, limbs): ...
        def residual(self, inputs): ...
        def noise(self, sensors, rate, evenness): ...

From then on it stands in the residual table, in what effects may explain, in noise floors, reports
and figures, beside those that come with surefoot.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np

from surefoot.models.residuals.binning import Bins, ReferenceMotion, binned
from surefoot.models.residuals.feet import HALFWAY, between_feet, leg_velocities
from surefoot.models.residuals.foot_loads import foot_loads
from surefoot.models.residuals.soft_ground import foot_sinking
from surefoot.models.residuals.torques import InverseDynamics, Steps, inverse_dynamics, steps_of
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot
from surefoot.sim.robot.fixed_base import Machine
from surefoot.sim.robot.limbs import Limbs
from surefoot.sim.sensors.streams import Sensors

OF_WALKS = ("contact", "reference")
"""Groups of columns that a machine on a fixed base does without."""


@dataclass(frozen=True)
class Column:
    """One column of a residual table.

    name: unlike any other of the table; unit; group: columns that one reading fills, and that lose
    weight together where it is an outlier; kind: columns whose noise is of one size, estimated from
    all of them; leg: index of the foot whose stance or swing fills it, None where that is no foot.
    Groups and kinds are the channel's own: other channels may use the same words.
    """

    name: str
    unit: str
    group: str
    kind: str
    leg: int | None = None


@dataclass(frozen=True)
class ResidualInputs:
    """What residuals are computed from: a log under a model.

    motion: what readings are compared with. All else is computed when it is first asked for.
    """

    log: Log
    robot: Machine
    motion: ReferenceMotion

    @cached_property
    def bins(self) -> Bins:
        """Means of readings over bins, and how deep feet are in ground that gives."""
        bins, stands = self._readings, self.log.has("q") and self._readings.standing.any()
        stands = stands and self.motion.by_reference
        if not (isinstance(self.robot, Robot) and stands and self.robot.extras.softness):
            return bins
        known = self.log, self.robot, self.motion, bins
        load = foot_loads(*known, steps_of(bins, self.robot))
        depth, v_sole = foot_sinking(*known, load)
        return replace(bins, depth=depth, v_sole=v_sole)

    @cached_property
    def steps(self) -> Steps:
        """What inverse dynamics takes."""
        steps, depth = steps_of(self.bins, self.robot), self.bins.depth
        return steps if depth is None else replace(steps, sunk=HALFWAY * depth)

    @cached_property
    def inverse_dynamics(self) -> InverseDynamics | None:
        """What the motion takes, where the log has torques."""
        return inverse_dynamics(self.steps, self.robot) if self.log.has("tau") else None

    @cached_property
    def leg_velocities(self) -> np.ndarray | None:
        """Velocity of the body by each standing foot minus the reference's, or without one against
        other feet's, (M, 3 L) [m/s] in I; None where no foot stands, or the log has no angles."""
        if not (self.log.has("q") and self.bins.standing.any()):
            return None
        assert isinstance(self.robot, Robot)
        v = leg_velocities(self.bins, self.robot)
        return v if self.motion.by_reference else between_feet(v)

    @cached_property
    def _readings(self) -> Bins:
        return binned(self.log, self.robot, self.motion)

    def of_body(self, robot: Machine, needed: InverseDynamics | None) -> "ResidualInputs":
        """The same means of readings under a model of another body, whose inverse dynamics are
        known."""
        other = replace(self, robot=robot)
        vars(other).update(bins=self.bins, steps=self.steps, inverse_dynamics=needed)
        return other


class Channel:
    """A residual: readings of a log minus what the model predicts, in means over bins."""

    name: ClassVar[str]
    unit: ClassVar[str]
    label: ClassVar[str] = ""
    """Title in figures; the name without underscores where it is empty."""
    needs: ClassVar[tuple[str, ...]]
    """Groups of a log's columns, as of `Log.require`, without which it has no values."""
    on_fixed_base: ClassVar[bool] = False
    """Whether a machine on a fixed base has it, without contacts and a reference."""
    imu_serves: ClassVar[bool] = False
    """Whether the IMU takes the reference's part where a walk has none."""
    on_level_ground: ClassVar[bool] = False
    """Whether it means anything on level ground alone; its level is then judged on ground that no
    fit has seen."""
    masked_by: ClassVar[tuple[str, ...]] = ()
    """What of a foot makes its columns worthless: that it "slid", or stood "elsewhere" than at its
    other steps. Columns of no foot are masked when any foot did."""
    least_noise: ClassVar[float] = 1e-12
    """[unit] that no log resolves: noise is never taken to be less."""
    of_events: ClassVar[bool] = False
    """Whether it is a time of an event: a small change of the body leaves it as it is."""
    known_to: ClassVar[Mapping[str, float]] = {}
    """Target of an effect -> [unit, standard deviation] to which the level in which the effect
    shows is known on walks of the model, where that is known from models of several robots."""
    judges: ClassVar[bool] = False
    """Whether no fit sees it: it says what effects that others found are worth."""
    chained: ClassVar[bool] = False
    """Whether `jacobians` writes down how its columns change with readings. Others are
    differenced."""

    def columns(self, limbs: Limbs) -> tuple[Column, ...]:
        """Its columns for a machine with these legs and joints; none where it has no meaning."""
        raise NotImplementedError

    def residual(self, inputs: ResidualInputs) -> np.ndarray | None:
        """Values (M, its columns), NaN where there is none; None where the log has none at all."""
        raise NotImplementedError

    def noise(self, sensors: Sensors, rate: float, evenness: float) -> float:
        """Standard deviation [unit] of a bin by sensors' noise alone.

        Args:
            sensors: noise of the declared sensors.
            rate: of the log, Hz.
            evenness: standard deviation of the ground's height, m.
        """
        raise NotImplementedError

    def free(self, inputs: ResidualInputs) -> Sequence[np.ndarray]:
        """What is fitted to each log by itself, (M, 1) or (M, its columns), each of any size."""
        return ()

    def fills(self, log: Log, fixed: bool, level: bool) -> bool:
        """Whether a log can fill it; of a `fixed` base or not, on `level` ground or not."""
        if (fixed and not self.on_fixed_base) or (self.on_level_ground and not level):
            return False
        return not self.lacking(log, fixed)

    def lacking(self, log: Log, fixed: bool) -> tuple[str, ...]:
        """Groups of columns that it would need and a log of a `fixed` base, or not, lacks."""
        needed = [g for g in self.needs if not (fixed and g in OF_WALKS)]
        if self.imu_serves and not fixed and not log.has("reference"):
            needed = ["imu", *(g for g in needed if g != "reference")]
        return tuple(g for g in needed if not log.has(g))

    def answers(self, log: Log, motion: ReferenceMotion) -> bool:
        """Whether it means anything of a log beside this motion, which may be no reference's."""
        if motion.by_reference:
            return True
        return log.has("imu") if self.imu_serves else "reference" not in self.needs
