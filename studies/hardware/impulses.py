"""Torque balance of a chain of hinges, integrated over short windows.

Accelerations cannot be derived from readings where torques jump from row to row. Integrated with a
window w(t) that is zero at its ends, the balance does not need them. With the momentum p = M(q) dq,

    int w tau dt = int w (c(q, dq) + g(q) - dM/dt dq) dt - int dw/dt p dt + sizes times terms

It is linear in the base parameters of a chain with parallel axes: for each link, its first moment
in the plane about its own hinge and its inertia about it, with the links beyond it counted as point
masses at the next hinge (Khalil and Dombre, "Modeling, Identification and Control of Robots",
2002). A link's mass itself is not observable.
"""

from dataclasses import dataclass, replace

import mujoco
import numpy as np

from surefoot import Log
from surefoot.extend import (
    AXES,
    STICTION_RATE,
    LinkChange,
    Modelled,
    compensate_all,
    effect,
    known_effects,
)

SizeKey = tuple[str, str]
"""Name of a size, and the joint, or the joint that moves the link, that it belongs to."""
UNITS_OF_TERMS = {
    **{f"first moment {axis}": "kg m" for axis in AXES},
    "inertia about the hinge": "kg m^2",
    "rotor inertia": "kg m^2",
    "dry friction": "N m",
    "viscous friction": "N m s/rad",
}
CHANGES = ("link_mass", "link_com", "encoder_offset")
"""Effects by which a machine may change, in addition to dry friction."""
_STEP = 1e-3
"""Changes of a link [m, kg m^2] for the derivatives, which are exact since the terms are linear."""
_SHOWS = 1e-6
"""Torque per unit [N m] from which a parameter is observable; rounding is smaller."""
_ALONG = 1e-6
"""Time step along the motion for the rate of change of the inertia matrix [s]."""


@dataclass(frozen=True)
class WindowRows:
    """Torque balance of a log, averaged over N windows, for J joints.

    Attributes:
        joints: their names.
        t: middles of the windows (N,) [s].
        rest: measured torque minus that of the declared model (N, J) [N m].
        terms: name and target -> torque per unit of the size (N, J).
        changes: effect and target -> the same for effects by which the machine may change.
    """

    joints: tuple[str, ...]
    t: np.ndarray
    rest: np.ndarray
    terms: dict[SizeKey, np.ndarray]
    changes: dict[SizeKey, np.ndarray]

    @property
    def zeros(self) -> np.ndarray:
        """Change of torque (J, N, J) per rad of a zero error of each joint."""
        return np.stack([self.changes["encoder_offset", joint] for joint in self.joints])


@dataclass(frozen=True)
class Windows:
    """Windows on a log's rows: weights (N, rows) of a mean and of a mean rate of change."""

    t: np.ndarray
    mean: np.ndarray
    rate: np.ndarray


def windows(t: np.ndarray, length: float) -> Windows:
    """Hann windows of a length [s], each starting at the middle of the one before, on rows at t
    [s].

    Integrals use the trapezoidal rule, and those of rates integration by parts, so stamps may be
    uneven.
    """
    middles = np.arange(t[0] + 0.5 * length, t[-1] - 0.5 * length, 0.5 * length)
    x = (t - middles[:, None]) / length
    w = np.where(np.abs(x) < 0.5, 1.0 + np.cos(2.0 * np.pi * x), 0.0)
    halves = 0.5 * np.diff(t), 0.5 * np.diff(w, axis=1)
    span, change = (np.insert(h, 0, 0.0, -1) + np.insert(h, h.shape[-1], 0.0, -1) for h in halves)
    mean, rate = w * span, -change
    whole = mean.sum(axis=1, keepdims=True)
    return Windows(middles, mean / whole, rate / whole)


def window_rows(log: Log, machine: Modelled, length: float) -> WindowRows:
    """Torque balance of one log in windows of a length [s].

    A joint whose torque is always zero has no drive. Raises LogError if the log lacks q, dq or tau.
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
            # The position of a mass along a hinge's axis is not observable.
            term = (rigid_torque(known, changed, through) - rigid) / size
            if np.abs(term).max() > _SHOWS:
                changes[name, target] = term
    for joint in log.joints:
        changes["coulomb_friction", joint] = terms["dry friction", joint]
    return WindowRows(log.joints, through.t, through.mean @ log.tau - rigid, terms, changes)


def rigid_torque(log: Log, machine: Modelled, through: Windows) -> np.ndarray:
    """Mean torque (N, J) [N m] in each window that the machine's masses require."""
    dynamics, q, dq, still = machine.dynamics, log.q, log.dq, np.zeros_like(log.q)

    def torque(q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
        return dynamics.inverse(q, dq, ddq)[1]

    def momentum(q: np.ndarray) -> np.ndarray:
        return torque(q, still, dq) - torque(q, still, still)

    later, earlier = momentum(q + _ALONG * dq), momentum(q - _ALONG * dq)
    slow = torque(q, dq, still) - (later - earlier) / (2.0 * _ALONG)
    return through.mean @ slow + through.rate @ momentum(q)


def _link_steps(machine: Modelled, j: int) -> list[tuple[str, LinkChange, float]]:
    """Observable parameters of the link that joint j moves: name, a change of it alone, and its
    size.
    """
    model = machine.dynamics.model
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


def as_published(machine: Modelled, joint: str) -> dict[str, float]:
    """Observable parameters of a link in its file: name -> value."""
    model = machine.dynamics.model
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


def _with_link(machine: Modelled, change: LinkChange) -> Modelled:
    links = (*machine.extras.links, change)
    return replace(machine, extras=replace(machine.extras, links=links))


def _only(x: np.ndarray, j: int) -> np.ndarray:
    """Column j of x (N, J), with zeros in the others."""
    return np.where(np.arange(x.shape[1]) == j, x, 0.0)
