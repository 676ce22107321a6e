"""The balance of torques of a chain of hinges, integrated over short windows.

Accelerations from readings fail where torques jolt from row to row. Integrated against a window
w(t) that starts and ends at zero the balance needs none: with the momentum p = M(q) dq,

    int w tau dt = int w (c(q, dq) + g(q) - dM/dt dq) dt - int dw/dt p dt + sizes times terms

It is linear in what a chain of links with parallel axes shows of its masses: each link's first
moment in the plane about its own hinge, and its inertia about it, the links beyond counted as
points at the next hinge (Khalil and Dombre, "Modeling, Identification and Control of Robots",
2002, base parameters). A link's mass itself does not show.
"""

from dataclasses import dataclass, replace

import mujoco
import numpy as np

from surefoot.sim.effects import compensate_all, effect, known_effects
from surefoot.sim.effects.contact import STICTION_RATE
from surefoot.sim.effects.targets import AXES
from surefoot.sim.log import Log
from surefoot.sim.physics.inertia import LinkChange
from surefoot.sim.physics.inverse_dynamics import body_changes, dynamics_of
from surefoot.sim.robot.fixed_base import FixedBase

SizeKey = tuple[str, str]
"""What a size is of, and of which joint or the link that it moves."""
UNITS_OF_TERMS = {
    **{f"first moment {axis}": "kg m" for axis in AXES},
    "inertia about the hinge": "kg m^2",
    "rotor inertia": "kg m^2",
    "dry friction": "N m",
    "viscous friction": "N m s/rad",
}
CHANGES = ("link_mass", "link_com", "encoder_offset")
"""Effects that an owner may find changed, beside dry friction."""
_STEP = 1e-3
"""m and kg m^2, by which links are changed for terms that are linear in the change."""
_SHOWS = 1e-6
"""N m per unit; rounding leaves less."""
_ALONG = 1e-6
"""s, by which the machine is moved along its motion for the rate of change of its inertia."""


@dataclass(frozen=True)
class WindowRows:
    """A log's balance, averaged over N windows, of J joints.

    t (N,) s: middles; rest (N, J) N m: measured torque less the declared model's; terms: name and
    target -> (N, J), torque per unit of its size; changes: effect and target -> (N, J), the same
    of what an owner may find changed.
    """

    joints: tuple[str, ...]
    t: np.ndarray
    rest: np.ndarray
    terms: dict[SizeKey, np.ndarray]
    changes: dict[SizeKey, np.ndarray]

    @property
    def zeros(self) -> np.ndarray:
        """Torque (J, N, J) per rad that each joint's angle reads too much."""
        return np.stack([self.changes["encoder_offset", joint] for joint in self.joints])


@dataclass(frozen=True)
class Windows:
    """Windows on a log's rows: weights (N, rows) of a mean, and of a mean rate of change."""

    t: np.ndarray
    mean: np.ndarray
    rate: np.ndarray


def windows(t: np.ndarray, length: float) -> Windows:
    """Hann windows of a length [s], each beginning in the middle of the one before, on rows at t
    [s]. Integrals are by trapezoids, and the rate's by parts, so that stamps may be uneven."""
    middles = np.arange(t[0] + 0.5 * length, t[-1] - 0.5 * length, 0.5 * length)
    x = (t - middles[:, None]) / length
    w = np.where(np.abs(x) < 0.5, 1.0 + np.cos(2.0 * np.pi * x), 0.0)
    halves = 0.5 * np.diff(t), 0.5 * np.diff(w, axis=1)
    span, change = (np.insert(h, 0, 0.0, -1) + np.insert(h, h.shape[-1], 0.0, -1) for h in halves)
    mean, rate = w * span, -change
    whole = mean.sum(axis=1, keepdims=True)
    return Windows(middles, mean / whole, rate / whole)


def window_rows(log: Log, machine: FixedBase, length: float) -> WindowRows:
    """The balance of one log through windows of a length [s].

    A joint whose torque is always zero has no drive. Raises LogError where the log lacks q, dq or
    tau.
    """
    log.require("q", "dq", "tau")
    through = windows(log.t, length)
    rigid = rigid_torque(log, machine, through)
    terms: dict[SizeKey, np.ndarray] = {}
    for j, joint in enumerate(log.joints):
        for name, change, size in _link_steps(machine, j):
            changed = rigid_torque(log, _with_link(machine, change), through)
            terms[name, joint] = (changed - rigid) / size
        # The first hinge's rotor turns as its link does.
        if j and np.ptp(log.tau[:, j]) > 0.0:
            terms["rotor inertia", joint] = _only(through.rate @ log.dq, j)
        terms["dry friction", joint] = _only(through.mean @ np.tanh(log.dq / STICTION_RATE), j)
        terms["viscous friction", joint] = _only(through.mean @ log.dq, j)
    changes: dict[SizeKey, np.ndarray] = {}
    for name in CHANGES:
        for target in known_effects()[name].single_targets(machine.limbs):
            size = known_effects()[name].step_of(target)
            known, changed = compensate_all([effect(name, target, size)], log, machine)
            assert isinstance(changed, FixedBase)
            # Along the axis of a hinge a mass may lie anywhere.
            term = (rigid_torque(known, changed, through) - rigid) / size
            if np.abs(term).max() > _SHOWS:
                changes[name, target] = term
    for joint in log.joints:
        changes["coulomb_friction", joint] = terms["dry friction", joint]
    return WindowRows(log.joints, through.t, through.mean @ log.tau - rigid, terms, changes)


def rigid_torque(log: Log, machine: FixedBase, through: Windows) -> np.ndarray:
    """Mean torque (N, J) [N m] in each window that the machine's masses ask for."""
    dynamics, changes = dynamics_of(machine.file, machine.joint_names), body_changes(machine)
    q, dq, still = log.q, log.dq, np.zeros_like(log.q)

    def torque(q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
        return dynamics.inverse(q, dq, ddq, changes=changes)[1]

    def momentum(q: np.ndarray) -> np.ndarray:
        return torque(q, still, dq) - torque(q, still, still)

    later, earlier = momentum(q + _ALONG * dq), momentum(q - _ALONG * dq)
    slow = torque(q, dq, still) - (later - earlier) / (2.0 * _ALONG)
    return through.mean @ slow + through.rate @ momentum(q)


def _link_steps(machine: FixedBase, j: int) -> list[tuple[str, LinkChange, float]]:
    """What shows of the link that joint j moves: name, a change of it alone, and its size."""
    model = dynamics_of(machine.file, machine.joint_names).model
    joint = model.joint(machine.joint_names[j]).id
    body = model.jnt_bodyid[joint]
    mass, place = model.body_mass[body], model.body_ipos[body] - model.jnt_pos[joint]
    steps = [("inertia about the hinge", LinkChange(j, inertia=_STEP), _STEP)]
    for a in range(3):
        if abs(model.jnt_axis[joint, a]) < 0.5:
            # Its inertia about the hinge stays.
            inertia = -mass * (2.0 * place[a] * _STEP + _STEP**2)
            along = tuple(_STEP * np.eye(3)[a])
            change = LinkChange(j, com=along, inertia=inertia)
            steps.append((f"first moment {AXES[a]}", change, mass * _STEP))
    return steps


def as_published(machine: FixedBase, joint: str) -> dict[str, float]:
    """What shows of a link as its file has it: name of the size -> value."""
    model = dynamics_of(machine.file, machine.joint_names).model
    hinge = model.joint(joint).id
    body = model.jnt_bodyid[hinge]
    across = np.abs(model.jnt_axis[hinge]) < 0.5
    place = np.where(across, model.body_ipos[body] - model.jnt_pos[hinge], 0.0)
    moment = model.body_mass[body] * place
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, model.body_iquat[body])
    about = turn.reshape(3, 3).T @ model.jnt_axis[hinge]
    inertia = about**2 @ model.body_inertia[body] + model.body_mass[body] * place @ place
    for beyond in np.flatnonzero(model.body_parentid == body):
        at = np.where(across, model.body_pos[beyond] - model.jnt_pos[hinge], 0.0)
        moment = moment + model.body_subtreemass[beyond] * at
        inertia += model.body_subtreemass[beyond] * at @ at
    shows = {f"first moment {AXES[a]}": float(moment[a]) for a in range(3) if across[a]}
    return {"inertia about the hinge": float(inertia), **shows}


def _with_link(machine: FixedBase, change: LinkChange) -> FixedBase:
    links = (*machine.extras.links, change)
    return replace(machine, extras=replace(machine.extras, links=links))


def _only(x: np.ndarray, j: int) -> np.ndarray:
    """The column j of (N, J), zero in the others."""
    return np.where(np.arange(x.shape[1]) == j, x, 0.0)
