"""Finds the four legs of any 12-joint quadruped by its kinematic tree, not by its names."""

from dataclasses import dataclass

import mujoco
import numpy as np

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.log.schema import JOINTS, LEGS
from surefoot.sim.robot.kinematics import Legs

__all__ = ["JOINTS", "LEGS", "LegTree", "find_legs"]


@dataclass(frozen=True)
class LegTree:
    """The legs of one model in the order FL, FR, RL, RR; joints hip, thigh, calf."""

    base_body: int
    joint_ids: np.ndarray  # (4, 3)
    foot_geoms: np.ndarray  # (4,)
    foot_radius: np.ndarray  # (4,) m
    constants: Legs


def find_legs(model: mujoco.MjModel, name: str) -> LegTree:
    """Legs, feet and their constants. Raises SurefootError saying what could not be found."""
    base = _floating_base(model, name)
    chains = [_chain_to(model, joint, base) for joint in _last_hinges(model)]
    if len(chains) != 4 or any(len(chain) != 3 for chain in chains):
        lengths = [len(chain) for chain in chains]
        raise SurefootError(
            f"robot {name}: expected four legs of three hinges each below the floating base, "
            f"found chains of {lengths} hinges"
        )
    ordered = _order_by_place(model, base, chains, name)
    feet = [
        _foot_geom(model, chain[-1], leg, name) for chain, leg in zip(ordered, LEGS, strict=True)
    ]
    return LegTree(
        base_body=base,
        joint_ids=np.array(ordered),
        foot_geoms=np.array(feet),
        foot_radius=model.geom_size[feet, 0].copy(),
        constants=_constants(model, base, ordered, feet),
    )


def _floating_base(model: mujoco.MjModel, name: str) -> int:
    free = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE)
    if len(free) != 1:
        raise SurefootError(f"robot {name}: expected one free joint (the base), found {len(free)}")
    return int(model.jnt_bodyid[free[0]])


def _last_hinges(model: mujoco.MjModel) -> list[int]:
    """Hinges with no hinge below them, one at the end of each leg."""
    hinges = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_HINGE)
    hinges = [joint for joint in hinges if not _is_spring(model, joint)]
    above: set[int] = set()
    for joint in hinges:
        body = model.body_parentid[model.jnt_bodyid[joint]]
        while body > 0:
            above.add(int(body))
            body = model.body_parentid[body]
    return [int(j) for j in hinges if int(model.jnt_bodyid[j]) not in above]


def _chain_to(model: mujoco.MjModel, last: int, base: int) -> list[int]:
    chain: list[int] = []
    body = int(model.jnt_bodyid[last])
    while body not in (0, base):
        start, count = model.body_jntadr[body], model.body_jntnum[body]
        own = [j for j in range(start, start + count) if not _is_spring(model, j)]
        chain = own + chain
        body = int(model.body_parentid[body])
    return chain


def _is_spring(model: mujoco.MjModel, joint: int) -> bool:
    """Whether a joint gives where its leg does not turn: a slide, or a second hinge about the axis
    of the one before it on its body."""
    if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE:
        return True
    same = joint > 0 and model.jnt_bodyid[joint - 1] == model.jnt_bodyid[joint]
    return bool(same and np.array_equal(model.jnt_axis[joint - 1], model.jnt_axis[joint]))


def _order_by_place(
    model: mujoco.MjModel, base: int, chains: list[list[int]], name: str
) -> list[list[int]]:
    """FL, FR, RL, RR by where each leg's thigh joint sits about the four legs' centre."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    R = data.xmat[base].reshape(3, 3)
    places = np.array([R.T @ (data.xanchor[chain[1]] - data.xpos[base]) for chain in chains])
    centred = places - places.mean(axis=0)
    ordered = []
    for front, left in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        match = np.flatnonzero((front * centred[:, 0] > 0) & (left * centred[:, 1] > 0))
        if len(match) != 1:
            raise SurefootError(
                f"robot {name}: cannot distinguish front, rear, left and right legs; the base's x "
                "axis must point forward and y left"
            )
        ordered.append(chains[match[0]])
    return ordered


def _foot_geom(model: mujoco.MjModel, last_joint: int, leg: str, name: str) -> int:
    """The colliding sphere farthest from the knee, on the last link or a body fixed to it."""
    knee_body = int(model.jnt_bodyid[last_joint])
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    knee = data.xanchor[last_joint]
    best, reach = -1, 0.0
    for geom in range(model.ngeom):
        body = int(model.geom_bodyid[geom])
        while body > knee_body:
            body = int(model.body_parentid[body])
        sphere = model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_SPHERE
        collides = model.geom_contype[geom] or model.geom_conaffinity[geom]
        distance = float(np.linalg.norm(data.geom_xpos[geom] - knee))
        if body == knee_body and sphere and collides and distance > reach:
            best, reach = geom, distance
    if best < 0:
        raise SurefootError(
            f"robot {name}: leg {leg} has no colliding sphere for a foot; add a sphere geom at its "
            "end"
        )
    return best


def _constants(model: mujoco.MjModel, base: int, chains: list[list[int]], feet: list[int]) -> Legs:
    offset, rotation = np.zeros((4, 3, 3)), np.zeros((4, 3, 3, 3))
    foot = np.zeros((4, 3))
    for leg, chain in enumerate(chains):
        previous = base
        for j, joint in enumerate(chain):
            body = int(model.jnt_bodyid[joint])
            rotation[leg, j], offset[leg, j] = _between(model, previous, body)
            previous = body
        R, p = _between(model, previous, int(model.geom_bodyid[feet[leg]]))
        foot[leg] = p + R @ model.geom_pos[feet[leg]]
    joints = np.array(chains)
    return Legs(
        offset=offset,
        rotation=rotation,
        axis=model.jnt_axis[joints].copy(),
        anchor=model.jnt_pos[joints].copy(),
        q_zero=model.qpos0[model.jnt_qposadr[joints]].copy(),
        foot=foot,
    )


def _between(model: mujoco.MjModel, ancestor: int, body: int) -> tuple[np.ndarray, np.ndarray]:
    """Pose of `body` in the frame of `ancestor` with every joint between at its zero."""
    R, p = np.eye(3), np.zeros(3)
    while body != ancestor:
        R_step = np.empty(9)
        mujoco.mju_quat2Mat(R_step, model.body_quat[body])
        R_step = R_step.reshape(3, 3)
        p = model.body_pos[body] + R_step @ p
        R = R_step @ R
        body = int(model.body_parentid[body])
    return R, p
