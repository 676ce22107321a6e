"""Inverse dynamics of a robot over many rows: the joint torques and base wrench of a motion.

MuJoCo's `mj_inverse` in one compiled loop, without contacts, joint limits, equality constraints,
and inertia and dry friction of tendons. It omits steps that the result does not need, which makes
it twice as fast: there is no mass matrix, and dry friction has a closed form. A floating base is
held at the origin with its axes along the world's, so that force and moment are in B.
"""

from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from numba import types

from surefoot.sim.common.copies import copy_row
from surefoot.sim.common.kernels import kernel, mujoco_function
from surefoot.sim.robot.body_changes import BodyChanges, bodies_changed
from surefoot.sim.robot.model_file import compiled_model

_mj_kinematics = mujoco_function("mj_kinematics")
_mj_comPos = mujoco_function("mj_comPos")
_mj_tendon = mujoco_function("mj_tendon")
_mj_comVel = mujoco_function("mj_comVel")
_mj_passive = mujoco_function("mj_passive")
_mj_fwdVelocity = mujoco_function("mj_fwdVelocity")
_mj_rne = mujoco_function("mj_rne", types.intc, types.uintp)
_mj_rnePostConstraint = mujoco_function("mj_rnePostConstraint")
_mj_objectAcceleration = mujoco_function(
    "mj_objectAcceleration", types.intc, types.intc, types.uintp, types.intc
)
_mj_jacBodyCom = mujoco_function("mj_jacBodyCom", types.uintp, types.uintp, types.intc)
_BODY = int(mujoco.mjtObj.mjOBJ_BODY)


@dataclass(frozen=True)
class Dynamics:
    """A compiled model, scratch memory for it, and indices of its joints in canonical order.

    hung (J,): the child of the previous joint's body, or of the base, that carries the joint.
    changes: of the model's file.
    """

    model: mujoco.MjModel
    data: mujoco.MjData
    qpos_adr: np.ndarray  # (J,)
    dof_adr: np.ndarray  # (J,)
    hung: np.ndarray  # (J,)
    floating: bool
    changes: BodyChanges

    def inverse(
        self, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray, base: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Wrench on the base (N, 6) [N, N m] in B about its origin, and joint torques (N, J) [N m].

        q, dq, ddq (N, J) in rad, rad/s, rad/s^2; base (N, 9), in B: angular velocity [rad/s],
        angular acceleration [rad/s^2] and specific force at the base's origin [m/s^2]; None for a
        base at rest and level, or for a fixed base (then the wrench is zero).
        """
        motion = self._motion(q, dq, ddq, base)
        out = np.empty((len(q), self.model.nv))
        with self._changed():
            _sweep(self._memory, *motion, out)
        return self.parted(out)

    def derivatives(
        self,
        q: np.ndarray,
        dq: np.ndarray,
        ddq: np.ndarray,
        base: np.ndarray | None = None,
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
            step: of the differences [rad, rad/s, rad/s^2].
        """
        motion = self._motion(q, dq, ddq, base)
        out = np.empty((3, len(self.dof_adr), len(q), self.model.nv))
        with self._changed():
            _sweep_about(self._memory, *motion, self.qpos_adr, self.dof_adr, step, out)
        return self.parted(out)

    def link_derivatives(
        self, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray, base: np.ndarray | None = None
    ) -> np.ndarray:
        """Derivatives (5, J, nv, N) of the generalised forces by each link's mass, centre of mass
        (x, y, z) and inertia, as in a LinkChange; `parted` splits them.

        All from one sweep, since only the force on the link itself changes.

        Args:
            q: (N, J), as for `inverse`.
            dq: (N, J).
            ddq: (N, J).
            base: (N, 9) or None.
        """
        motion, model, d = self._motion(q, dq, ddq, base), self.model, self.data
        # Rows last, so that the joints that carry nothing of a link take no memory.
        out = np.zeros((5, len(self.dof_adr), model.nv, len(q)))
        bodies = model.jnt_bodyid[model.dof_jntid[self.dof_adr]]
        with self._changed():
            _sweep_links(self._memory, bodies, model.body_mass, d.xmat, d.cvel, *motion, out)
        return out

    def parted(self, forces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Wrench on the base (..., 6) and joint torques (..., J) of forces (..., nv)."""
        wrench = forces[..., :6] if self.floating else np.zeros((*forces.shape[:-1], 6))
        return wrench, forces[..., self.dof_adr]

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

    def _changed(self) -> AbstractContextManager[None]:
        """Context with the joints' frames and the links changed in the model."""
        joints = self.model.dof_jntid[self.dof_adr]
        return bodies_changed(self.model, joints, self.hung, self.changes)

    @property
    def _memory(self) -> "_Memory":
        model, d = self.model, self.data
        where = model._address, d._address, model.ntendon > 0
        state = d.qpos, d.qvel, d.qacc, d.qfrc_passive
        return _Memory(*where, *state, model.dof_armature, *_dry_friction(model))


class _Memory(NamedTuple):
    """Arrays that a sweep reads and writes.

    Attributes:
        model: address of MuJoCo's model.
        data: address of its data.
        tendons: whether the model has tendons.
        qpos: (nq,), view of the data, as are `qvel`, `qacc` and `passive` (nv,).
        qvel: velocities.
        qacc: accelerations.
        passive: forces of springs and dampers.
        rotor: inertia of the rotors (nv,).
        dry: dry friction (nv,).
        stiff: dry friction per acceleration (nv,), below its limit.
        lead: acceleration with the same friction as a velocity of one (nv,) [1/s].
    """

    model: int
    data: int
    tendons: bool
    qpos: np.ndarray
    qvel: np.ndarray
    qacc: np.ndarray
    passive: np.ndarray
    rotor: np.ndarray
    dry: np.ndarray
    stiff: np.ndarray
    lead: np.ndarray


def _dry_friction(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Dry friction of each degree of freedom: limit, force per acceleration, and acceleration per
    velocity, (nv,) each.

    As a constraint of MuJoCo, friction is the force a + b v over R within its limit, where a is the
    acceleration, v the velocity, R = (1 - d) / d of the inverse inertia, d the impedance at rest,
    and b the damping of a reference that is critically damped (MuJoCo documentation, "Computation",
    on constraints).
    """
    least, most = mujoco.mjMINIMP, mujoco.mjMAXIMP
    d, d_most = np.clip(model.dof_solimp[:, 0], least, most), model.dof_solimp[:, 1]
    R = np.maximum((1.0 - d) / d * model.dof_invweight0, mujoco.mjMINVAL)
    time, direct = model.dof_solref[:, 0], -model.dof_solref[:, 1]
    b = np.where(time > 0.0, 2.0 / np.maximum(time, 2.0 * model.opt.timestep), direct)
    return model.dof_frictionloss, 1.0 / R, b / np.clip(d_most, least, most)


def dynamics_of(file: Path, joint_names: tuple[str, ...], changes: BodyChanges) -> Dynamics:
    """Dynamics of a model's file with these changes, for these joints."""
    return replace(_as_drawn(file, joint_names), changes=changes)


@lru_cache(maxsize=16)
def _as_drawn(file: Path, joint_names: tuple[str, ...]) -> Dynamics:
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
        BodyChanges(),
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
        memory: a _Memory.
        Q: (N, nq), positions.
        V: (N, nv), velocities.
        A: (N, nv), accelerations.
        out: (N, nv), filled.
    """
    for k in range(len(Q)):
        _take_motion(memory, Q[k], V[k], A[k])
        _fill_forces(memory, out[k])


@kernel(nogil=True)
def _sweep_about(memory, Q, V, A, qpos_adr, dof_adr, step, out):
    """Forward differences of the generalised forces of N motions by each joint.

    Args:
        memory: a _Memory.
        Q: (N, nq), positions.
        V: (N, nv), velocities.
        A: (N, nv), accelerations.
        qpos_adr: (J,), place of each joint in qpos.
        dof_adr: (J,), place of each joint in qvel.
        step: of the differences [rad, rad/s, rad/s^2].
        out: (3, J, N, nv), filled: by angle, rate and acceleration.
    """
    # In order of increasing recomputation.
    varied = (
        (memory.qacc, dof_adr, A, out[2]),
        (memory.qvel, dof_adr, V, out[1]),
        (memory.qpos, qpos_adr, Q, out[0]),
    )
    here, there = np.empty(len(memory.qvel)), np.empty(len(memory.qvel))
    for k in range(len(Q)):
        _take_motion(memory, Q[k], V[k], A[k])
        _fill_forces(memory, here)
        for kind in range(3):
            state, places, motion, slopes = varied[kind]
            for j in range(len(places)):
                state[places[j]] += step
                if kind == 2:
                    _take_positions(memory)
                if kind >= 1:
                    _take_velocities(memory)
                _fill_forces(memory, there)
                for i in range(len(there)):
                    slopes[j, k, i] = (there[i] - here[i]) / step
                copy_row(motion[k], state)


@kernel(nogil=True)
def _sweep_links(memory, bodies, masses, xmat, cvel, Q, V, A, out):
    """Derivatives of the generalised forces of N motions by mass, centre and inertia of links.

    A point with the acceleration a takes a force a per unit of mass. Shifted along e, it gains the
    acceleration of e, which is fixed to the link.

    Args:
        memory: a _Memory.
        bodies: (J,), of the links.
        masses: of all bodies (B,) [kg].
        xmat: their attitudes (B, 9), as in MuJoCo.
        cvel: their velocities (B, 6), as in MuJoCo.
        Q: (N, nq), positions.
        V: (N, nv), velocities.
        A: (N, nv), accelerations.
        out: (5, J, nv, N), zeros; filled for the degrees of freedom that carry a link.
    """
    model, data, nv = memory.model, memory.data, V.shape[1]
    moved = np.empty(6)  # angular acceleration, and acceleration of the centre of mass
    shift, turn = np.empty((3, nv)), np.empty((3, nv))  # Jacobians of that centre and the body
    for k in range(len(Q)):
        _take_motion(memory, Q[k], V[k], A[k])
        _mj_rnePostConstraint(model, data)
        for j, body in enumerate(bodies):
            _mj_objectAcceleration(model, data, _BODY, body, moved.ctypes.data, 0)
            _mj_jacBodyCom(model, data, shift.ctypes.data, turn.ctypes.data, body)
            spin, a = moved[:3], moved[3:]
            w, mass, R = cvel[body], masses[body], xmat[body]
            for dof in range(nv):
                by_shift, by_turn = shift[:, dof], turn[:, dof]
                if not (by_shift.any() or by_turn.any()):
                    continue
                out[0, j, dof, k] = _dot(by_shift, a)
                out[4, j, dof, k] = _dot(by_turn, spin)
                for axis in range(3):
                    e = (mass * R[axis], mass * R[3 + axis], mass * R[6 + axis])
                    lag, swing = _cross(spin, e), _cross(w, _cross(w, e))
                    force = _dot(by_shift, lag) + _dot(by_shift, swing)
                    out[1 + axis, j, dof, k] = force + _dot(by_turn, _cross(e, a))


@kernel(nogil=True)
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel(nogil=True)
def _cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@kernel(nogil=True)
def _take_motion(memory, q, v, a):
    """Bring a motion (nq,), (nv,), (nv,) into memory, and what depends on it up to date."""
    copy_row(q, memory.qpos)
    copy_row(v, memory.qvel)
    copy_row(a, memory.qacc)
    _take_positions(memory)
    _take_velocities(memory)


@kernel(nogil=True)
def _take_positions(memory):
    """Bring what depends on positions up to date."""
    _mj_kinematics(memory.model, memory.data)
    _mj_comPos(memory.model, memory.data)
    _mj_tendon(memory.model, memory.data)


@kernel(nogil=True)
def _take_velocities(memory):
    """Bring what depends on positions and velocities up to date."""
    if memory.tendons:
        _mj_fwdVelocity(memory.model, memory.data)  # with their rates, and more
    else:
        _mj_comVel(memory.model, memory.data)
        _mj_passive(memory.model, memory.data)


@kernel(nogil=True)
def _fill_forces(memory, force):
    """Fill in the generalised forces (nv,) of the motion in memory."""
    _mj_rne(memory.model, memory.data, 1, force.ctypes.data)
    for i in range(len(force)):
        a, v, most = memory.qacc[i], memory.qvel[i], memory.dry[i]
        rubbed = (a + memory.lead[i] * v) * memory.stiff[i]
        force[i] += memory.rotor[i] * a - memory.passive[i] + min(max(rubbed, -most), most)
