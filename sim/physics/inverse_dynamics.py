"""Inverse dynamics of a robot over many rows: the joint torques and base wrench of a motion.

MuJoCo's `mj_inverse` without contacts and joint limits, in one compiled loop. A floating base is
held at the origin with its axes along the world's, so that its force and moment result in B.
"""

import ctypes
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from llvmlite import binding
from numba import types

from surefoot.sim.common.kernels import kernel
from surefoot.sim.physics.inertia import LinkChange, change_links
from surefoot.sim.physics.stepper import mujoco_library
from surefoot.sim.robot import Robot
from surefoot.sim.robot.fixed_base import Machine
from surefoot.sim.robot.model_file import compiled_model


def _mujoco_function(name: str, *arguments: types.Type) -> Callable[..., None]:
    """A function of MuJoCo's library on a model and its data, callable from compiled code."""
    address = ctypes.cast(getattr(mujoco_library(), name), ctypes.c_void_p).value
    binding.add_symbol(name, address)
    return types.ExternalFunction(name, types.void(types.uintp, types.uintp, *arguments))


_mj_inverse = _mujoco_function("mj_inverseSkip", types.intc, types.intc)
_mj_kinematics = _mujoco_function("mj_kinematics")
_mj_comPos = _mujoco_function("mj_comPos")
_mj_comVel = _mujoco_function("mj_comVel")
_mj_rne = _mujoco_function("mj_rne", types.intc, types.uintp)
# What MuJoCo need not recompute: nothing, all that depends on positions, or on positions and rates.
_SKIP_NOTHING = int(mujoco.mjtStage.mjSTAGE_NONE)
_SKIP_POSITIONS = int(mujoco.mjtStage.mjSTAGE_POS)
_SKIP_VELOCITIES = int(mujoco.mjtStage.mjSTAGE_VEL)
_CHANGED_FIELDS = (
    *("body_pos", "body_quat", "body_mass"),
    *("body_ipos", "body_iquat", "body_inertia", "body_sameframe"),
)
"""Arrays of a model that `BodyChanges` modify."""


class BodyChanges(NamedTuple):
    """Deviation of a robot from its file: frames of its joints, each with all that hangs on it, and
    links.

    All frames are relative to the joint before, or the base; None where they are as in the file.

    Attributes:
        drawn: position of each joint's frame in the file (J, 3) [m].
        placed: its actual position (J, 3) [m].
        turn: its rotation from the file's (J, 3, 3).
        links: changes of the links' inertia.
    """

    drawn: np.ndarray | None = None
    placed: np.ndarray | None = None
    turn: np.ndarray | None = None
    links: tuple[LinkChange, ...] = ()


UNCHANGED_BODY = BodyChanges()


def body_changes(robot: Machine) -> BodyChanges:
    """Deviation of a machine's declared model from its file."""
    links = robot.extras.links
    if not isinstance(robot, Robot) or (
        np.array_equal(robot.legs.offset, robot.drawn.offset)
        and np.array_equal(robot.legs.rotation, robot.drawn.rotation)
    ):
        return BodyChanges(links=links)
    joints = len(robot.limbs.joints)
    drawn, placed = np.zeros((2, joints, 3))
    turn = np.tile(np.eye(3), (joints, 1, 1))
    for leg, chain in enumerate(robot.limbs.chains):
        there, here = robot.drawn, robot.legs
        for j, joint in enumerate(chain):
            drawn[joint], placed[joint] = there.offset[leg, j], here.offset[leg, j]
            turn[joint] = here.rotation[leg, j] @ there.rotation[leg, j].T
    return BodyChanges(drawn, placed, turn, links)


@dataclass(frozen=True)
class Dynamics:
    """A compiled model, scratch memory for it, and indices of its joints in canonical order.

    hung (J,): the child of the previous joint's body, or of the base, that carries the joint.
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
        changes: BodyChanges = UNCHANGED_BODY,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Wrench on the base (N, 6) [N, N m] in B about its origin, and joint torques (N, J) [N m].

        q, dq, ddq (N, J) in rad, rad/s, rad/s^2; base (N, 9), in B: angular velocity [rad/s],
        angular acceleration [rad/s^2] and specific force at the base's origin [m/s^2]; None for a
        base at rest and level, or for a fixed base (then the wrench is zero). changes: of the file.
        """
        motion = self._motion(q, dq, ddq, base)
        out = np.empty((len(q), self.model.nv))
        with self._changed(changes):
            _sweep(self._memory, *motion, out)
        return self._wrench(out), out[:, self.dof_adr]

    def rigid_bodies(
        self,
        q: np.ndarray,
        dq: np.ndarray,
        ddq: np.ndarray,
        base: np.ndarray | None = None,
        changes: BodyChanges = UNCHANGED_BODY,
    ) -> tuple[np.ndarray, np.ndarray]:
        """`inverse` without what the joints add: rotor inertia, damping, springs and dry friction.

        Four times as fast. `changes` do not affect what the joints add, so that the difference
        between two bodies is the same as that of `inverse`.

        Args:
            q: (N, J) [rad].
            dq: (N, J) [rad/s].
            ddq: (N, J) [rad/s^2].
            base: (N, 9) in B, as for `inverse`.
            changes: as for `inverse`.
        """
        motion = self._motion(q, dq, ddq, base)
        out = np.empty((len(q), self.model.nv))
        with self._changed(changes):
            _rigid_sweep(self._memory, *motion, out)
        return self._wrench(out), out[:, self.dof_adr]

    def derivatives(
        self,
        q: np.ndarray,
        dq: np.ndarray,
        ddq: np.ndarray,
        base: np.ndarray | None = None,
        changes: BodyChanges = UNCHANGED_BODY,
        step: float = 1e-5,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Forward differences of `inverse` with respect to each joint's angle, rate and
        acceleration.

        Returns wrenches (3, J, N, 6) and torques (3, J, N, J).

        Args:
            q: (N, J) [rad].
            dq: (N, J) [rad/s].
            ddq: (N, J) [rad/s^2].
            base: (N, 9) in B, as for `inverse`.
            changes: as for `inverse`.
            step: of the differences [rad, rad/s, rad/s^2].
        """
        motion = self._motion(q, dq, ddq, base)
        out = np.empty((3, len(self.dof_adr), len(q), self.model.nv))
        with self._changed(changes):
            _sweep_about(self._memory, *motion, self.qpos_adr, self.dof_adr, step, out)
        return self._wrench(out), out[..., self.dof_adr]

    def _motion(self, q, dq, ddq, base) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The motion in MuJoCo's coordinates: positions (N, nq), rates and accelerations (N,
        nv).
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
        return Q, V, A

    def _wrench(self, forces: np.ndarray) -> np.ndarray:
        return forces[..., :6] if self.floating else np.zeros((*forces.shape[:-1], 6))

    @contextmanager
    def _changed(self, changes: BodyChanges) -> Iterator[None]:
        """Context with the joints' frames and the links changed in the model."""
        model = self.model
        as_drawn = {name: getattr(model, name).copy() for name in _CHANGED_FIELDS}
        if changes.turn is not None:
            assert changes.drawn is not None  # the three go together
            assert changes.placed is not None
            frames = zip(self.hung, changes.drawn, changes.placed, changes.turn, strict=True)
            for body, drawn, placed, turn in frames:
                # Whatever is between this body and the joint rotates with it.
                model.body_pos[body] = placed - turn @ (drawn - model.body_pos[body])
                quat, before = np.empty(4), model.body_quat[body].copy()
                mujoco.mju_mat2Quat(quat, turn.ravel())
                mujoco.mju_mulQuat(model.body_quat[body], quat, before)
        change_links(model, model.dof_jntid[self.dof_adr], changes.links)
        try:
            yield
        finally:
            for name, values in as_drawn.items():
                getattr(model, name)[:] = values

    @property
    def _memory(self) -> tuple:
        """Addresses of model and data, and the input and output arrays of `data`."""
        model, d = self.model, self.data
        return model._address, d._address, d.qpos, d.qvel, d.qacc, d.qfrc_inverse


@lru_cache(maxsize=16)
def dynamics_of(file: Path, joint_names: tuple[str, ...]) -> Dynamics:
    """Dynamics of an unchanged MJCF file, for these joints."""
    model = compiled_model(file)
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
    """The topmost ancestor of a body, or itself, whose parent moves (has a joint) or is the
    world.
    """
    while (parent := int(model.body_parentid[body])) and not model.body_jntnum[parent]:
        body = parent
    return body


@kernel(nogil=True)
def _sweep(memory, Q, V, A, out):
    """Generalised forces of N motions.

    Args:
        memory: MuJoCo's model and data, and views of qpos, qvel, qacc and qfrc_inverse.
        Q: (N, nq), positions.
        V: (N, nv), velocities.
        A: (N, nv), accelerations.
        out: (N, nv), filled.
    """
    model, data, qpos, qvel, qacc, force = memory
    for k in range(len(Q)):
        qpos[:], qvel[:], qacc[:] = Q[k], V[k], A[k]
        _mj_inverse(model, data, _SKIP_NOTHING, 1)
        out[k] = force


@kernel(nogil=True)
def _rigid_sweep(memory, Q, V, A, out):
    """Generalised forces of N motions on the rigid bodies alone, by recursive Newton-Euler.

    Args:
        memory: as of `_sweep`.
        Q: (N, nq), positions.
        V: (N, nv), velocities.
        A: (N, nv), accelerations.
        out: (N, nv), filled.
    """
    model, data, qpos, qvel, qacc, _ = memory
    for k in range(len(Q)):
        qpos[:], qvel[:], qacc[:] = Q[k], V[k], A[k]
        _mj_kinematics(model, data)
        _mj_comPos(model, data)
        _mj_comVel(model, data)
        _mj_rne(model, data, 1, out.ctypes.data + k * out.strides[0])


@kernel(nogil=True)
def _sweep_about(memory, Q, V, A, qpos_adr, dof_adr, step, out):
    """Forward differences of the generalised forces of N motions by each joint.

    Args:
        memory: MuJoCo's model and data, and views of qpos, qvel, qacc and qfrc_inverse.
        Q: (N, nq), positions.
        V: (N, nv), velocities.
        A: (N, nv), accelerations.
        qpos_adr: (J,), place of each joint in qpos.
        dof_adr: (J,), place of each joint in qvel.
        step: of the differences [rad, rad/s, rad/s^2].
        out: (3, J, N, nv), filled: by angle, rate and acceleration.
    """
    model, data, qpos, qvel, qacc, force = memory
    here = np.empty(len(force))
    for k in range(len(Q)):
        qpos[:], qvel[:], qacc[:] = Q[k], V[k], A[k]
        _mj_inverse(model, data, _SKIP_NOTHING, 1)
        here[:] = force
        # From the least recomputation to the most.
        for j in range(len(dof_adr)):
            qacc[dof_adr[j]] += step
            _mj_inverse(model, data, _SKIP_VELOCITIES, 1)
            out[2, j, k] = (force - here) / step
            qacc[:] = A[k]
        for j in range(len(dof_adr)):
            qvel[dof_adr[j]] += step
            _mj_inverse(model, data, _SKIP_POSITIONS, 1)
            out[1, j, k] = (force - here) / step
            qvel[:] = V[k]
        for j in range(len(dof_adr)):
            qpos[qpos_adr[j]] += step
            _mj_inverse(model, data, _SKIP_NOTHING, 1)
            out[0, j, k] = (force - here) / step
            qpos[:] = Q[k]
