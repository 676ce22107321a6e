"""Gears whose dry friction grows with the torque that they transmit.

The friction of a joint is that of its file plus a share of its motor's torque, in every time step.
The shares are kept in the model as numbers of their own, since MuJoCo has no such friction.
"""

from collections.abc import Sequence
from typing import NamedTuple

import mujoco
import numpy as np


class Gears(NamedTuple):
    """Dry friction of the gears of J joints.

    Attributes:
        share: of the motor's torque that is lost (J,), from 0 to 1.
        dry: friction without load (J,) [N m, N].
    """

    share: np.ndarray
    dry: np.ndarray


def share_of_load(spec: mujoco.MjSpec, joint: str) -> float:
    """Share of its motor's torque that a joint's gear loses."""
    known = spec.numeric(_name(joint))
    return float(known.data[0]) if known else 0.0


def set_share_of_load(spec: mujoco.MjSpec, joint: str, share: float) -> None:
    """Let a joint's gear lose a share of its motor's torque."""
    known = spec.numeric(_name(joint))
    if known:
        known.data = [share]
    elif share:
        spec.add_numeric(name=_name(joint), data=[share])


def gears_of(model: mujoco.MjModel, joint_names: Sequence[str]) -> Gears:
    """The gears of a compiled model."""
    numbers = {model.numeric(i).name: model.numeric(i).data for i in range(model.nnumeric)}
    shares = [float(numbers[_name(j)][0]) if _name(j) in numbers else 0.0 for j in joint_names]
    dofs = [int(model.joint(joint).dofadr[0]) for joint in joint_names]
    return Gears(np.array(shares), model.dof_frictionloss[dofs].copy())


def _name(joint: str) -> str:
    return f"load_friction_{joint}"
