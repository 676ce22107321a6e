"""Changes of a robot's bodies: their frames, masses and inertias, in a spec or a compiled model."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

import mujoco
import numpy as np

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.quaternion import matrix_from_quaternion
from surefoot.sim.robot.kinematics import Legs


class LinkChange(NamedTuple):
    """Deviation of a joint's link from the model's file."""

    joint: int  # index
    mass: float = 0.0  # kg, at the link's centre of mass
    com: tuple[float, float, float] = (0.0, 0.0, 0.0)  # m, in the frame of the link's body
    inertia: float = 0.0  # kg m^2, about every axis through the centre of mass


class BodyChanges(NamedTuple):
    """Deviation of a robot from its file: of the frames of its legs' joints, each with everything
    attached, and of links.
    """

    frames: tuple[Legs, ...] = ()  # legs as in the file and as they are; empty without legs
    links: tuple[LinkChange, ...] = ()  # changes of their inertia


_CHANGED_FIELDS = (
    *("body_pos", "body_quat", "body_mass"),
    *("body_ipos", "body_iquat", "body_inertia", "body_sameframe"),
)
"""Arrays of a model that `BodyChanges` modify."""


@contextmanager
def bodies_changed(
    model: mujoco.MjModel, joint_ids: np.ndarray, hung: np.ndarray, changes: BodyChanges
) -> Iterator[None]:
    """Context with the frames of joints and the links changed in a compiled model.

    Args:
        model: changed, and restored.
        joint_ids: (J,), of the joints that the changes index.
        hung: (J,), the bodies that are placed: as of `Dynamics`.
        changes: of frames and links.
    """
    as_drawn = {name: getattr(model, name).copy() for name in _CHANGED_FIELDS}
    for leg, joint in np.ndindex(changes.frames[0].joints.shape if changes.frames else (0, 0)):
        (drawn, R_drawn), (placed, R_placed) = (
            (legs.offset[leg, joint], legs.rotation[leg, joint]) for legs in changes.frames
        )
        if not (np.array_equal(drawn, placed) and np.array_equal(R_drawn, R_placed)):
            body, turn = hung[changes.frames[0].joints[leg, joint]], R_placed @ R_drawn.T
            # All bodies between this one and the joint rotate with it.
            model.body_pos[body] = placed - turn @ (drawn - model.body_pos[body])
            quat, before = np.empty(4), model.body_quat[body].copy()
            mujoco.mju_mat2Quat(quat, turn.ravel())
            mujoco.mju_mulQuat(model.body_quat[body], quat, before)
    for change in changes.links:
        body = model.jnt_bodyid[joint_ids[change.joint]]
        model.body_mass[body] += change.mass
        model.body_ipos[body] += change.com
        # MuJoCo would ignore the position of a centre of mass that was at the body's origin.
        model.body_sameframe[body] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE
        model.body_inertia[body] += change.inertia
    try:
        yield
    finally:
        for name, values in as_drawn.items():
            getattr(model, name)[:] = values


def with_own_inertia(spec: mujoco.MjSpec, body: str) -> mujoco.MjsBody:
    """The body with its compiled mass and inertia given explicitly, so that they can be changed.

    Other bodies are unaffected.
    """
    part, built = spec.body(body), spec.compile().body(body)
    if spec.compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE:
        # The other bodies keep the inertia of their geoms, as in the file.
        for other in spec.bodies:
            other.explicitinertial = False
        spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_AUTO
    part.explicitinertial = True
    part.mass = float(built.mass[0])
    part.ipos, part.iquat, part.inertia = built.ipos, built.iquat, built.inertia
    part.fullinertia = [np.nan, 0, 0, 0, 0, 0]
    return part


def take_off_ball(body: mujoco.MjsBody, mass: float, place: np.ndarray, radius: float) -> None:
    """Subtract a ball of `mass` [kg] and `radius` [m] at `place` (3,) [m] from a body with explicit
    inertia, by the parallel-axis theorem.

    Raises SurefootError where the body is too light.
    """
    R = matrix_from_quaternion(body.iquat)
    about = R @ np.diag(body.inertia) @ R.T + body.mass * _of_point(body.ipos)
    about -= mass * (_of_point(place) + 0.4 * radius**2 * np.eye(3))
    left = body.mass - mass
    center = (body.mass * body.ipos - mass * place) / max(left, 1e-9)
    inertia, axes = np.linalg.eigh(about - left * _of_point(center))
    # For any body, the largest principal moment is less than the sum of the others.
    if left <= 0 or inertia[0] <= 0 or inertia[2] > inertia[0] + inertia[1]:
        raise SurefootError(f"body {body.name}: too light to give a foot of {mass:.2g} kg")
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, (axes * np.sign(np.linalg.det(axes))).ravel())
    body.mass, body.ipos, body.iquat, body.inertia = left, center, quat, inertia


def _of_point(place: np.ndarray) -> np.ndarray:
    """Inertia (3, 3) about the origin of a unit mass at a place (3,)."""
    return place @ place * np.eye(3) - np.outer(place, place)
