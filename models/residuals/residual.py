"""Table of residuals of a log under a model: the columns of every channel, by bin."""

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from surefoot.models.residuals.binning import ReferenceMotion, binned, reference_motion
from surefoot.models.residuals.channel import ResidualInputs
from surefoot.models.residuals.contact_timing import within_windows
from surefoot.models.residuals.feet import ground_normals, leg_velocities, level_ground
from surefoot.models.residuals.layout import Layout, layout_for
from surefoot.models.residuals.registry import channels
from surefoot.models.residuals.without_reference import motion_without_reference
from surefoot.sim.log import Log
from surefoot.sim.robot.feet import shown_feet
from surefoot.sim.robot.machine import Machine


@dataclass(frozen=True)
class ResidualTable:
    """Residuals of a log, and what their derivatives need again.

    Attributes:
        layout: of the table.
        inputs: from which it was computed.
        table: residuals (M, W).
        names: of the channels that were computed.
    """

    layout: Layout
    inputs: ResidualInputs
    table: np.ndarray
    names: tuple[str, ...]

    @property
    def t(self) -> np.ndarray:
        """Mean time of each bin (M,) [s]."""
        return self.inputs.motion.t


def residual(
    log: Log, robot: Machine, motion: ReferenceMotion, names: Collection[str] | None = None
) -> ResidualTable:
    """Residuals of a log's readings under the model `robot`.

    `names` selects the channels, by default all.
    """
    layout, inputs = layout_for(robot.limbs), ResidualInputs(log, robot, motion)
    asked = tuple(layout.channels if names is None else names)
    return ResidualTable(layout, inputs, filled(layout, inputs, asked), asked)


def filled(layout: Layout, inputs: ResidualInputs, names: Collection[str]) -> np.ndarray:
    """The table (M, W) with the residuals of these channels; NaN in the others."""
    table = np.full((len(inputs.motion.t), layout.width), np.nan)
    for name, columns in layout.channels.items():
        if name in names and channels()[name].is_defined_for(inputs.log, inputs.motion):
            values = channels()[name].residual(inputs)
            if values is not None:
                np.copyto(table[:, columns], values, casting="same_kind")  # no complex numbers
    return table


def motion_under_model(log: Log, robot: Machine, fixed: bool) -> ReferenceMotion:
    """Reference motion of a log, with stances and swings as they are under this model.

    Without a reference, the motion by IMU and legs.
    """
    if fixed or robot.fixed:
        return reference_motion(log, robot.limbs, fixed)
    if not log.has("reference"):
        return motion_without_reference(log, robot)
    motion = reference_motion(log, robot.limbs)
    return within_windows(motion, log, robot) if motion.standing.any() else motion


def with_ground(motion: ReferenceMotion, log: Log, robot: Machine) -> ReferenceMotion:
    """Detect whether the ground is level, so that heights of feet can be compared, and its normal
    where it slopes.

    A staircase rises as a slope does, but its treads are level: the slope's normal is taken only if
    the feet then move less over the ground.
    """
    feet = shown_feet(log, robot.feet)
    if feet is None or not (motion.by_reference and motion.standing.any()):
        return motion
    bins = binned(log, robot, motion)
    if level_ground(bins, feet):
        return replace(motion, level=True)
    slope = ground_normals(bins, feet)
    sloping = replace(
        motion,
        normal_G=np.column_stack([np.interp(log.t, bins.t, component) for component in slope.T]),
    )
    moves = [
        np.nanmedian(np.abs(leg_velocities(binned(log, robot, one), feet)))
        for one in (motion, sloping)
    ]
    return sloping if moves[1] < moves[0] else motion
