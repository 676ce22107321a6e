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
from surefoot.sim.robot.body_changes import UNCHANGED_BODY, BodyChanges, bodies_changed
from surefoot.sim.robot.model_file import compiled_model

_mj_kinematics = mujoco_function("mj_kinematics")
_mj_comPos = mujoco_function("mj_comPos")
_mj_tendon = mujoco_function("mj_tendon")
_mj_comVel = mujoco_function("mj_comVel")
_mj_passive = mujoco_function("mj_passive")
_mj_fwdVelocity = mujoco_function("mj_fwdVelocity")
_mj_rne = mujoco_function("mj_rne", types.intc, types.uintp)


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
    changes: BodyChanges = UNCHANGED_BODY

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
        motion, model = self._motion(q, dq, ddq, base), self.model
        # Rows last, so that the joints that carry nothing of a link take no memory.
        out = np.zeros((5, len(self.dof_adr), model.nv, len(q)))
        bodies = model.jnt_bodyid[model.dof_jntid[self.dof_adr]]
        with self._changed():
            _sweep_links(self._memory, self._tree, *motion, bodies, out)
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

    @property
    def _tree(self) -> "_Tree":
        model, d = self.model, self.data
        return _Tree(
            *(model.body_parentid, model.body_rootid, model.body_dofadr, model.body_dofnum),
            *(model.body_mass, model.opt.gravity, d.subtree_com, d.xipos, d.xmat),
            *(d.cdof, d.cdof_dot, d.cvel),
        )


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


class _Tree(NamedTuple):
    """Bodies of a model and their motion in its data, named as in MuJoCo."""

    parent: np.ndarray  # (B,)
    root: np.ndarray  # (B,)
    dofadr: np.ndarray  # (B,)
    dofnum: np.ndarray  # (B,)
    mass: np.ndarray  # (B,)
    gravity: np.ndarray  # (3,)
    subtree_com: np.ndarray  # (B, 3)
    xipos: np.ndarray  # (B, 3)
    xmat: np.ndarray  # (B, 9)
    cdof: np.ndarray  # (nv, 6)
    cdof_dot: np.ndarray  # (nv, 6)
    cvel: np.ndarray  # (B, 6)


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


def dynamics_of(
    file: Path, joint_names: tuple[str, ...], changes: BodyChanges = UNCHANGED_BODY
) -> Dynamics:
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
    qpos, qvel, qacc = memory.qpos, memory.qvel, memory.qacc
    here, there = np.empty(len(qvel)), np.empty(len(qvel))
    for k in range(len(Q)):
        _take_motion(memory, Q[k], V[k], A[k])
        _fill_forces(memory, here)
        # In order of increasing recomputation.
        for j in range(len(dof_adr)):
            qacc[dof_adr[j]] += step
            _fill_forces(memory, there)
            _difference(there, here, step, out[2, j, k])
            copy_row(A[k], qacc)
        for j in range(len(dof_adr)):
            qvel[dof_adr[j]] += step
            _take_velocities(memory)
            _fill_forces(memory, there)
            _difference(there, here, step, out[1, j, k])
            copy_row(V[k], qvel)
        for j in range(len(dof_adr)):
            qpos[qpos_adr[j]] += step
            _take_positions(memory)
            _take_velocities(memory)
            _fill_forces(memory, there)
            _difference(there, here, step, out[0, j, k])
            copy_row(Q[k], qpos)


@kernel(nogil=True)
def _sweep_links(memory, tree, Q, V, A, bodies, out):
    """Derivatives of the generalised forces of N motions by mass, centre and inertia of links.

    A point with the acceleration a takes a force a per unit of mass. Shifted along e, it gains the
    acceleration of e, which is fixed to the link.

    Args:
        memory: a _Memory.
        tree: a _Tree.
        Q: (N, nq), positions.
        V: (N, nv), velocities.
        A: (N, nv), accelerations.
        bodies: (J,), of the links.
        out: (5, J, nv, N), added to.
    """
    moved = np.empty((len(tree.parent), 6))  # accelerations, about the tree's centre of mass
    for k in range(len(Q)):
        _take_motion(memory, Q[k], V[k], A[k])
        _fill_accelerations(memory, tree, moved)
        for j, body in enumerate(bodies):
            centre, mass, R = tree.root[body], tree.mass[body], tree.xmat[body]
            p = _minus(tree.xipos[body], tree.subtree_com[centre])
            w, v = _halves(tree.cvel[body])
            spin, rise = _halves(moved[body])
            # a = rise + spin x p + w x (v + w x p)
            a = _plus(_plus(rise, _cross(spin, p)), _cross(w, _plus(v, _cross(w, p))))
            _add_wrench(tree, body, _cross(p, a), a, out[0, j, :, k])
            for axis in range(3):
                e = (mass * R[axis], mass * R[3 + axis], mass * R[6 + axis])
                gained = _plus(_cross(spin, e), _cross(w, _cross(w, e)))
                moment = _plus(_cross(e, a), _cross(p, gained))
                _add_wrench(tree, body, moment, gained, out[1 + axis, j, :, k])
            _add_wrench(tree, body, spin, (0.0, 0.0, 0.0), out[4, j, :, k])


@kernel(nogil=True)
def _fill_accelerations(memory, tree, moved):
    """Spatial accelerations (B, 6) of the bodies as MuJoCo has them: gravity is an acceleration of
    the world upwards.
    """
    for i in range(3):
        moved[0, i], moved[0, 3 + i] = 0.0, -tree.gravity[i]
    for body in range(1, len(moved)):
        copy_row(moved[tree.parent[body]], moved[body])
        first = tree.dofadr[body]
        for dof in range(first, first + tree.dofnum[body]):
            for i in range(6):
                moved[body, i] += tree.cdof_dot[dof, i] * memory.qvel[dof]
                moved[body, i] += tree.cdof[dof, i] * memory.qacc[dof]


@kernel(nogil=True)
def _add_wrench(tree, body, moment, force, out):
    """Add the share of each degree of freedom that carries a body in a wrench on it.

    Args:
        tree: a _Tree.
        body: its index.
        moment: (3,) about the centre of mass of the tree, in world axes [N m].
        force: (3,) in world axes [N].
        out: (nv,), added to.
    """
    while body:
        first = tree.dofadr[body]
        for dof in range(first, first + tree.dofnum[body]):
            for i in range(3):
                out[dof] += tree.cdof[dof, i] * moment[i] + tree.cdof[dof, 3 + i] * force[i]
        body = tree.parent[body]


@kernel(nogil=True)
def _halves(x):
    return (x[0], x[1], x[2]), (x[3], x[4], x[5])


@kernel(nogil=True)
def _minus(a, b):
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@kernel(nogil=True)
def _plus(a, b):
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@kernel(nogil=True)
def _cross(a, b):
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@kernel(nogil=True)
def _difference(there, here, step, out):
    """(there - here) / step, all (nv,), into out."""
    for i in range(len(out)):
        out[i] = (there[i] - here[i]) / step


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
