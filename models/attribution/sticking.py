"""Bins in which a joint with dry friction nearly stands still, where its rate says little."""

from collections.abc import Sequence

import numpy as np

from surefoot.models.attribution.evidence import LogUnderModel
from surefoot.models.residuals.binning import bin_mean
from surefoot.models.residuals.layout import Layout
from surefoot.models.residuals.torques import dilate
from surefoot.sim.effects import Effect
from surefoot.sim.log import joint_velocity
from surefoot.sim.physics.leg_loads import STICTION_RATE
from surefoot.sim.robot.limbs import Limbs

DRY = ("coulomb_friction", "load_friction")
"""Effects that are dry friction."""
SLOW = 0.5
"""Share of a joint's RMS rate below which it is slow, at most: small slides never reach
STICTION_RATE.
"""


def sticks(cases: Sequence[LogUnderModel], effects: Sequence[Effect], layout: Layout) -> np.ndarray:
    """Entries (M, W) of the residual table in which a machine on a fixed base may stick.

    A joint that sticks has any friction up to its dry one, and how narrow the transition is differs
    between drives. These torques tell a fit a little, but not whether an effect is missing.

    Args:
        cases: the logs.
        effects: found and declared; the model's file may have friction as well.
        layout: of the table.
    """
    return np.concatenate([_of_case(case, effects, layout) for case in cases])


def _of_case(case: LogUnderModel, effects: Sequence[Effect], layout: Layout) -> np.ndarray:
    out = np.zeros((len(case.motion.t), layout.width), dtype=bool)
    if not (case.fixed and case.log.has("q")):
        return out
    rate, mean = joint_velocity(case.log), bin_mean(case.motion)
    slow = np.minimum(STICTION_RATE, SLOW * np.sqrt(np.mean(rate**2, axis=0)))
    still = mean((np.abs(rate) < slow).astype(float)) > 0.0
    for joint in _with_dry_friction(case, effects):
        column = f"torque_{joint}"
        if column in layout.names:
            at = case.log.joints.index(joint)
            # The residual is smoothed over three bins.
            out[:, layout.names.index(column)] = dilate(still[:, at])
    return out


def _with_dry_friction(case: LogUnderModel, effects: Sequence[Effect]) -> set[str]:
    """Names of the joints that have dry friction, by the effects or by the model's file."""
    limbs: Limbs = case.robot.limbs
    found = {joint for e in effects if e.name in DRY for joint in e.members(limbs)}
    dynamics = case.robot.dynamics
    if dynamics is None:
        return found
    dry = dynamics.model.dof_frictionloss[dynamics.dof_adr] > 0.0
    return found | {joint for joint, has in zip(limbs.joints, dry, strict=True) if has}
