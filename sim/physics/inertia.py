"""Bodies' inertia: given one by one in a spec, and changed in a compiled model."""

from collections.abc import Sequence
from typing import NamedTuple

import mujoco
import numpy as np


class LinkChange(NamedTuple):
    """What the link that a joint moves has beyond its file."""

    joint: int  # index
    mass: float = 0.0  # kg, at the link's centre of mass
    com: tuple[float, float, float] = (0.0, 0.0, 0.0)  # m, in the frame of the link's body
    inertia: float = 0.0  # kg m^2, about every axis through the centre of mass


def with_own_inertia(spec: mujoco.MjSpec, body: str) -> mujoco.MjsBody:
    """The body, its mass and inertia given by numbers of its own as compiled, so that they can be
    changed; the other bodies keep theirs."""
    part, built = spec.body(body), spec.compile().body(body)
    if spec.compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE:
        # The other bodies keep the inertia of their geoms, as the file asks.
        for other in spec.bodies:
            other.explicitinertial = False
        spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO
    part.explicitinertial = True
    part.mass = float(built.mass[0])
    part.ipos, part.iquat, part.inertia = built.ipos, built.iquat, built.inertia
    part.fullinertia = [np.nan, 0, 0, 0, 0, 0]
    return part


def change_links(
    model: mujoco.MjModel, joint_ids: np.ndarray, changes: Sequence[LinkChange]
) -> None:
    """Change masses, centres of mass and inertias of a compiled model, in place.

    Args:
        model: edited.
        joint_ids: (J,), of the joints that changes count.
        changes: of the links that joints move.
    """
    for change in changes:
        body = model.jnt_bodyid[joint_ids[change.joint]]
        model.body_mass[body] += change.mass
        model.body_ipos[body] += change.com
        model.body_inertia[body] += change.inertia
