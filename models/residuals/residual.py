"""The table of residuals of a log under a model: every channel's columns, bin by bin."""

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from surefoot.models.residuals.binning import ReferenceMotion, binned
from surefoot.models.residuals.channel import ResidualInputs
from surefoot.models.residuals.feet import HALFWAY, level_ground
from surefoot.models.residuals.foot_loads import foot_loads
from surefoot.models.residuals.layout import Layout, layout_for
from surefoot.models.residuals.registry import channels
from surefoot.models.residuals.soft_ground import foot_sinking
from surefoot.models.residuals.torques import inverse_dynamics, steps_of
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot
from surefoot.sim.robot.fixed_base import Machine


@dataclass(frozen=True)
class ResidualTable:
    """A log's residuals (M, W), and what they were computed from: what derivatives need again."""

    layout: Layout
    inputs: ResidualInputs
    table: np.ndarray

    @property
    def t(self) -> np.ndarray:
        """Mean time of each bin (M,) [s]."""
        return self.inputs.motion.t


def residual(log: Log, robot: Machine, motion: ReferenceMotion) -> ResidualTable:
    """Residuals of the log's readings under the declared model `robot`."""
    layout, inputs = layout_for(robot.limbs), residual_inputs(log, robot, motion)
    return ResidualTable(layout, inputs, filled(layout, inputs))


def filled(
    layout: Layout, inputs: ResidualInputs, names: Collection[str] | None = None
) -> np.ndarray:
    """The table (M, W) with the residuals of these channels, of all where none are named."""
    table = np.full((len(inputs.bins.t), layout.width), np.nan)
    for name, columns in layout.channels.items():
        if names is None or name in names:
            values = channels()[name].residual(inputs)
            if values is not None:
                table[:, columns] = values
    return table


def residual_inputs(log: Log, robot: Machine, motion: ReferenceMotion) -> ResidualInputs:
    """What the channels' residuals are computed from."""
    bins = binned(log, robot, motion)
    steps, needed = steps_of(bins, robot), None
    if np.isfinite(bins.tau).any():
        needed = inverse_dynamics(steps, robot)
    stands = log.has("q") and bins.standing.any()
    if isinstance(robot, Robot) and stands and robot.extras.softness:
        load = foot_loads(log, robot, motion, bins, steps)
        depth, v_sole = foot_sinking(log, robot, motion, bins, load)
        bins = replace(bins, depth=depth, v_sole=v_sole)
        steps = replace(steps, sunk=HALFWAY * depth)
    return ResidualInputs(log, robot, motion, bins, steps, needed)


def with_ground(motion: ReferenceMotion, log: Log, robot: Machine) -> ReferenceMotion:
    """The reference motion, knowing whether heights of feet mean anything."""
    if not isinstance(robot, Robot) or not log.has("q") or not motion.standing.any():
        return motion
    return replace(motion, level=level_ground(binned(log, robot, motion), robot))
