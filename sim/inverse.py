"""Inverse dynamics of a robot over many rows: the joint torques and base wrench of a motion.

MuJoCo's `mj_inverse` without contacts and joint stops, as one compiled loop. A floating base is
held at the origin with its axes along the world's, so that its force and moment come out in B.
"""

import ctypes
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import mujoco
import numpy as np
from llvmlite import binding
from numba import njit, types

from sim.stride import library

binding.add_symbol("mj_inverse", ctypes.cast(library().mj_inverse, ctypes.c_void_p).value)
_mj_inverse = types.ExternalFunction("mj_inverse", types.void(types.uintp, types.uintp))


@dataclass(frozen=True)
class Dynamics:
    """A compiled model, scratch memory for it, and where its joints are in canonical order.

    hung (J,): the body that hangs on the one before the joint's, or on the base, and carries it.
    """

    model: mujoco.MjModel
    data: mujoco.MjData
    qpos_adr: np.ndarray  # (J,)
    dof_adr: np.ndarray  # (J,)
    hung: np.ndarray  # (J,)
    floating: bool

    def inverse(
        self,
        q: np.ndarray,
        dq: np.ndarray,
        ddq: np.ndarray,
        base: np.ndarray | None = None,
        shift: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Wrench on the base (N, 6) [N, N m] in B about its origin, and joint torques (N, J) [N m].

        q, dq, ddq (N, J) in rad, rad/s, rad/s^2; base (N, 9), in B: angular velocity [rad/s],
        angular acceleration [rad/s^2] and specific force at the base's origin [m/s^2]; None where
        it stands still and level, or where there is none (then the wrench is zero). shift (J, 3)
        [m]: how far each joint, with all that hangs on it, is from where the file has it, in the
        frame of the joint before.
        """
        n, model = len(q), self.model
        Q = np.tile(model.qpos0, (n, 1))
        V, A = np.zeros((n, model.nv)), np.zeros((n, model.nv))
        Q[:, self.qpos_adr], V[:, self.dof_adr], A[:, self.dof_adr] = q, dq, ddq
        if self.floating:
            Q[:, :7] = [0, 0, 0, 1, 0, 0, 0]
            if base is not None:
                V[:, 3:6], A[:, 3:6] = base[:, :3], base[:, 3:6]
                A[:, :3] = base[:, 6:] + model.opt.gravity
        out, data = np.empty((n, model.nv)), self.data
        as_drawn = model.body_pos.copy()
        if shift is not None:
            model.body_pos[self.hung] += shift
        _sweep(
            model._address, data._address, data.qpos, data.qvel, data.qacc, data.qfrc_inverse,
            Q, V, A, out,
        )  # fmt: skip
        model.body_pos[:] = as_drawn
        wrench = out[:, :6] if self.floating else np.zeros((n, 6))
        return wrench, out[:, self.dof_adr]


@lru_cache(maxsize=16)
def dynamics_of(file: Path, joint_names: tuple[str, ...]) -> Dynamics:
    """The dynamics of an MJCF file as it is, seen at these joints."""
    model = mujoco.MjModel.from_xml_path(str(file))
    flags = mujoco.mjtDisableBit
    model.opt.disableflags |= flags.mjDSBL_CONTACT | flags.mjDSBL_LIMIT
    joints = [model.joint(name) for name in joint_names]
    return Dynamics(
        model,
        mujoco.MjData(model),
        np.array([joint.qposadr[0] for joint in joints]),
        np.array([joint.dofadr[0] for joint in joints]),
        np.array([_hung(model, int(joint.bodyid[0])) for joint in joints]),
        bool(model.jnt_type[0] == mujoco.mjtJoint.mjJNT_FREE),
    )


def _hung(model: mujoco.MjModel, body: int) -> int:
    """The first body above this one, or it, whose parent moves: has a joint, or is the world."""
    while (parent := int(model.body_parentid[body])) and not model.body_jntnum[parent]:
        body = parent
    return body


@njit(cache=True, nogil=True)
def _sweep(model, data, qpos, qvel, qacc, force, Q, V, A, out):
    for k in range(len(Q)):
        qpos[:], qvel[:], qacc[:] = Q[k], V[k], A[k]
        _mj_inverse(model, data)
        out[k] = force
