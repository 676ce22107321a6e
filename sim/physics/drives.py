"""Springs of joints and feet, and gears whose dry friction grows with the load; MuJoCo has neither.

A motor keeps its joint's name, its rotor (the joint's armature) and its encoder; the link follows
by a second hinge about the same axis, with a spring and damping. A foot becomes a separate body
that slides relative to its link on springs. The friction of a geared joint is that of its file plus
a share of its motor's torque, in every time step; the shares are kept in the model as numbers of
their own.
"""

from collections.abc import Sequence
from typing import NamedTuple

import mujoco
import numpy as np

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.robot import Robot
from surefoot.sim.robot.body_changes import take_off_ball, with_own_inertia
from surefoot.sim.robot.legs import LEGS, posed

RELAXATION = 0.001
"""Damping over stiffness [s]: at 20 Hz the loss factor is 0.13, as for rubber and gear trains."""
INERTIA = 0.002**2
"""Inertia added to a spring's own motion, over its stiffness [s^2]: the squared time step. MuJoCo
integrates stiffness explicitly; without it, stiff springs would oscillate between their ends and
diverge. At 10 Hz it takes 2 % of the spring's force.
"""
ROTOR_SHARE = 0.05
"""Armature of a motor whose file has none, as a share of the inertia that its joint moves. Without
inertia, a motor would follow its torque instantly, and its rate would be as rough as the torque.
"""
FOOT_SHARE = 0.02
"""Mass of a sprung foot, as a share of its leg's effective mass at the foot: a light pad, whose
mass is subtracted from the link that carries it.
"""


class Springs(NamedTuple):
    """Indices of springs among a model's degrees of freedom; -1 where there is none.

    Attributes:
        joints: (J,).
        feet: (L, 3), along x, y, z of the base in the home pose.
        axes: these axes in the frame of the leg's last link (L, 3, 3).
    """

    joints: np.ndarray
    feet: np.ndarray
    axes: np.ndarray

    def any(self) -> bool:
        return bool((self.joints >= 0).any() or (self.feet >= 0).any())


def add_joint_spring(spec: mujoco.MjSpec, joint: str, compliance: float) -> None:
    """Put a spring of `compliance` [rad/(N m)] between a joint's motor and its link, in series with
    an existing one.
    """
    if not compliance:
        return
    spring, motor = spec.joint(f"{joint}_spring"), spec.joint(joint)
    if spring is None:
        if not motor.armature:
            model = spec.compile()
            moved = 1.0 / model.dof_invweight0[model.joint(joint).dofadr[0]]
            motor.armature = ROTOR_SHARE * moved
        hinge = mujoco.mjtJoint.mjJNT_HINGE
        spring = _plain_joint(motor.parent, f"{joint}_spring", hinge, motor.axis, motor.pos)
    _soften(spring, compliance)


def add_foot_springs(
    spec: mujoco.MjSpec, robot: Robot, leg: int, axes: Sequence[int], compliance: float
) -> None:
    """Put springs of `compliance` [m/N] between a foot and its link.

    Args:
        spec: of the robot, edited.
        robot: as declared.
        leg: index of the foot.
        axes: of the base in the home pose: 0 to 2 for x, y, z.
        compliance: of each, in series with an existing one.
    """
    if not compliance:
        return
    body = spec.body(f"{LEGS[leg]}_sliding_foot") or _sliding_foot(spec, robot, leg)
    for axis in axes:
        name = _foot_spring(leg, axis)
        spring = spec.joint(name)
        if spring is None:
            slide = mujoco.mjtJoint.mjJNT_SLIDE
            spring = _plain_joint(body, name, slide, np.eye(3)[axis], np.zeros(3))
        _soften(spring, compliance)


def springs_of(model: mujoco.MjModel, joint_names: Sequence[str]) -> Springs:
    """The springs of a compiled model."""
    joints = {model.joint(j).name: int(model.jnt_dofadr[j]) for j in range(model.njnt)}
    data = posed(model)
    axes = np.tile(np.eye(3), (len(LEGS), 1, 1))
    for leg, name in enumerate(LEGS):
        foot = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, f"{name}_sliding_foot")
        if foot >= 0:
            link = int(model.joint(joint_names[3 * leg + 2]).bodyid[0])
            axes[leg] = data.xmat[link].reshape(3, 3).T @ data.xmat[foot].reshape(3, 3)
    feet = [[joints.get(_foot_spring(leg, a), -1) for a in range(3)] for leg in range(len(LEGS))]
    return Springs(
        joints=np.array([joints.get(f"{joint}_spring", -1) for joint in joint_names]),
        feet=np.array(feet),
        axes=axes,
    )


def share_moved_at_once(
    model: mujoco.MjModel, springs: Springs, qpos: np.ndarray, motors: np.ndarray
) -> float:
    """Share of a rigid leg's inertia that a motor moves within a time step; the least of all
    joints.

    In a time step dt a motor moves its rotor and, through a spring of stiffness k, only r a / (r +
    a), a = k dt^2, of the inertia r behind it. 1 where no joint has a spring.

    Args:
        model: compiled.
        springs: of the model.
        qpos: (nq,) of the standing robot.
        motors: (J,) degrees of freedom of the joints.
    """
    elastic = np.flatnonzero(springs.joints >= 0)
    if not len(elastic):
        return 1.0
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    inertia = np.empty((model.nv, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    rigid = np.setdiff1d(np.arange(model.nv), springs.joints[elastic])
    moved = np.zeros(model.nv)
    moved[rigid] = 1.0 / np.diag(np.linalg.inv(inertia[np.ix_(rigid, rigid)]))
    motor, spring = motors[elastic], springs.joints[elastic]
    rotor = model.dof_armature[motor]
    rest = moved[motor] - rotor
    drawn = model.jnt_stiffness[model.dof_jntid[spring]] * model.opt.timestep**2
    return float(((rotor + rest * drawn / (rest + drawn)) / moved[motor]).min())


def foot_parts(spec: mujoco.MjSpec, leg: str) -> tuple[mujoco.MjsGeom, mujoco.MjsSite]:
    """The sphere of a foot, and the site of its touch sensor, which moves with it.

    Raises SurefootError for a foot of another shape.
    """
    site = spec.site(f"sole_{leg}")
    spheres = [g for g in site.parent.geoms if g.type == mujoco.mjtGeom.mjGEOM_SPHERE]
    if not spheres:
        raise SurefootError(f"effects of feet need spheres for feet, and foot {leg} is none")
    return min(spheres, key=lambda g: float(np.linalg.norm(g.pos - site.pos))), site


def _foot_spring(leg: int, axis: int) -> str:
    return f"{LEGS[leg]}_foot_spring_{'xyz'[axis]}"


def _sliding_foot(spec: mujoco.MjSpec, robot: Robot, leg: int) -> mujoco.MjsBody:
    """Move a foot's sphere and site to a body of their own."""
    geom, site = foot_parts(spec, LEGS[leg])
    link, model = site.parent, spec.compile()
    data = robot.at_home(model)
    base, of_link = (data.body(name).xmat.reshape(3, 3) for name in (robot.base_name, link.name))
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, (of_link.T @ base).ravel())
    foot = link.add_body(name=f"{LEGS[leg]}_sliding_foot", pos=geom.pos, quat=quat)
    mass, radius = FOOT_SHARE * robot.inertial[3], geom.size[0]
    # Relative to what the last joint moves: in many files the foot is a shell without a joint or
    # much mass.
    lower = spec.joint(robot.joint_names[robot.limbs.chains[leg][-1]]).parent
    place_G = data.body(link.name).xpos + data.body(link.name).xmat.reshape(3, 3) @ geom.pos
    moved = data.body(lower.name)
    place = moved.xmat.reshape(3, 3).T @ (place_G - moved.xpos)
    take_off_ball(with_own_inertia(spec, lower.name), mass, place, radius)
    # Explicit inertia or the geom's, as in the file.
    foot.explicitinertial, foot.mass = True, mass
    foot.inertia = np.full(3, 0.4 * mass * radius**2)
    # Otherwise the body's own position and rotation would be applied twice.
    foot.ipos, foot.iquat = np.zeros(3), [1.0, 0.0, 0.0, 0.0]
    sphere = foot.add_geom(**{name: getattr(geom, name) for name in _OF_GEOM}, mass=mass)
    place = foot.add_site(**{name: getattr(site, name) for name in _OF_SITE})
    names = geom.name, site.name
    for part in (geom, site):
        spec.delete(part)
    sphere.name, place.name = names
    return foot


_OF_GEOM = (
    *("type", "size", "contype", "conaffinity", "condim", "priority", "friction", "solmix"),
    *("solref", "solimp", "margin", "gap", "group", "rgba", "material"),
)
_OF_SITE = ("type", "size", "group", "rgba")


def _plain_joint(
    body: mujoco.MjsBody, name: str, kind: mujoco.mjtJoint, axis: np.ndarray, place: np.ndarray
) -> mujoco.MjsJoint:
    """A joint without any of the file's defaults.

    Args:
        body: that it moves.
        name: of the joint.
        kind: hinge or slide.
        axis: in the body's frame.
        place: its anchor in the body's frame [m].
    """
    joint = body.add_joint(name=name, type=kind, axis=axis, pos=place)
    joint.limited = joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE
    joint.armature = joint.frictionloss = 0.0
    joint.stiffness[:], joint.damping[:] = 0.0, 0.0
    return joint


def _soften(spring: mujoco.MjsJoint, compliance: float) -> None:
    """Add `compliance` [rad/(N m) or m/N] to a spring, in series."""
    before = 1.0 / spring.stiffness[0] if spring.stiffness[0] else 0.0
    spring.stiffness[0] = 1.0 / (before + compliance)
    spring.damping[0] = RELAXATION * spring.stiffness[0]
    spring.armature = INERTIA * spring.stiffness[0]


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
    known = spec.numeric(_name(joint)) or spec.add_numeric(name=_name(joint))
    known.data = [share]


def gears_of(model: mujoco.MjModel, joint_names: Sequence[str]) -> Gears:
    """The gears of a compiled model."""
    numbers = {model.numeric(i).name: model.numeric(i).data for i in range(model.nnumeric)}
    shares = [float(numbers[_name(j)][0]) if _name(j) in numbers else 0.0 for j in joint_names]
    dofs = [int(model.joint(joint).dofadr[0]) for joint in joint_names]
    return Gears(np.array(shares), model.dof_frictionloss[dofs].copy())


def _name(joint: str) -> str:
    return f"load_friction_{joint}"
