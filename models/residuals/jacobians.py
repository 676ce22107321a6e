"""How each residual answers to a small change of the readings, bin by bin: the chain rule.

An effect's `explain` says how it changes readings; from there on the derivatives are the same for
all effects and are computed once a log.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from surefoot.models.residuals.channels import Parts, height_columns, leg_columns
from surefoot.models.residuals.layout import QUADRUPED
from surefoot.models.residuals.torques import (
    InverseDynamics,
    Steps,
    carried,
    dilate,
    given_by_feet,
    inverse_dynamics,
    inverse_dynamics_jacobians,
    slope,
    smooth_121,
    torque_residual,
    wrench_residual,
)
from surefoot.sim.robot import Robot
from surefoot.sim.robot.fixed_base import Machine

STEP = 1e-5  # rad, rad/s


OUTLYING = 4.0
"""Standard deviations of a column's bulk beyond which an entry counts no more."""


@dataclass(frozen=True)
class Regressor:
    """What one unit of an effect adds to some columns (n,) of the residual table: values (M, n)."""

    columns: np.ndarray
    values: np.ndarray


@dataclass(frozen=True)
class ResidualJacobians:
    """Derivatives of a table's columns at each bin. Of legs, by the rate of the IMU (M, 12, 3) and
    by the leg's own joints' angles and rates (M, 4, 3, 3); of heights, by the own joints' angles
    (M, 4, 3); of torques and wrench together (J, M, J + 6), by each joint's angle, rate,
    acceleration and torque."""

    leg_omega: np.ndarray
    leg_q: np.ndarray
    leg_dq: np.ndarray
    height_q: np.ndarray
    effort_q: np.ndarray
    effort_dq: np.ndarray
    effort_ddq: np.ndarray
    effort_tau: np.ndarray


def residual_jacobians(parts: Parts, robot: Machine) -> ResidualJacobians:
    """Every derivative that a change of readings can ask for."""
    m, joints = parts.bins.q.shape
    leg_omega, leg = np.zeros((m, 12, 3)), np.zeros((2, m, 4, 3, 3))
    height_q = np.zeros((m, 4, 3))
    legged = parts.layout is QUADRUPED and np.isfinite(parts.table[:, 6:18]).any()
    if legged:
        assert isinstance(robot, Robot)
        bins = parts.bins

        def by(**moved) -> np.ndarray:
            ahead = leg_columns(replace(bins, **moved), robot)
            return np.nan_to_num(ahead - parts.table[:, 6:18]) / STEP

        for axis in range(3):
            leg_omega[:, :, axis] = by(omega=bins.omega + STEP * np.eye(3)[axis])
            all_legs = STEP * np.tile(np.eye(3)[axis], 4)
            leg[0, ..., axis] = by(q=bins.q + all_legs).reshape(m, 4, 3)
            leg[1, ..., axis] = by(dq=bins.dq + all_legs).reshape(m, 4, 3)
            if np.isfinite(parts.table[:, 18:22]).any():
                rise = height_columns(replace(bins, q=bins.q + all_legs), robot)
                height_q[:, :, axis] = np.nan_to_num(rise - parts.table[:, 18:22]) / STEP
    by_effort = np.zeros((4, joints, m, joints + 6))
    if parts.inverse_dynamics is not None:
        by_effort = _by_effort(parts, parts.inverse_dynamics, robot)
    return ResidualJacobians(leg_omega, leg[0], leg[1], height_q, *by_effort)


def _by_effort(parts: Parts, needed: InverseDynamics, robot: Machine) -> np.ndarray:
    """(4, J, M, J + 6): by each joint's angle, rate, acceleration and torque, the torques, then the
    wrench."""
    m, joints = parts.bins.q.shape
    out = np.zeros((4, joints, m, joints + 6))
    use = np.flatnonzero(dilate(parts.steps.swings.any(axis=1) | parts.steps.steady))
    s = replace(parts.steps, **{name: values[use] for name, values in vars(parts.steps).items()})
    wrench, torque = inverse_dynamics_jacobians(s, robot, STEP)
    out[:3, :, use, :joints], out[:3, :, use, joints:] = -torque, -wrench
    for j in range(joints):
        out[3, j, use, j] = 1.0
    if isinstance(robot, Robot) and s.steady.any():
        out[:, :, use, joints:] += _by_feet(s, needed.torque[use], torque, robot)
    return out


def _by_feet(s: Steps, needed: np.ndarray, torque: np.ndarray, robot: Robot) -> np.ndarray:
    """What the feet give the base (4, 12, M, 6), likewise. The base's motion being what it is, a
    joint changes the torques of its own leg alone, and so the force of its own foot: all four legs
    can be moved at once.

    needed (M, 12), torque (3, 12, M, 12): what the motion takes, and its derivatives.
    """
    legs, bins = np.arange(4), len(needed)
    out = np.zeros((4, 12, bins, 6))
    plain = given_by_feet(s, s.q, needed - s.tau, robot)
    for j in range(3):
        at = 3 * legs + j
        moved = np.zeros(12)
        moved[at] = 1.0
        for kind in range(4):
            if kind == 3:
                step, gained = 1.0, -moved
            else:
                own = torque[kind, at].reshape(4, bins, 4, 3)[legs, :, legs]
                step, gained = STEP, STEP * np.moveaxis(own, 0, 1).reshape(bins, 12)
            q = s.q + STEP * moved if kind == 0 else s.q
            given = given_by_feet(s, q, needed - s.tau + gained, robot)
            out[kind, at] = np.moveaxis(given - plain, 1, 0) / step
    return out


def wrt_readings(
    parts: Parts, known: ResidualJacobians, change: Mapping[str, Mapping[int, np.ndarray]]
) -> Regressor:
    """What a change of readings does to the table: of each stream, at each place (axis or joint),
    its means over bins (M,); of "ddq" what the rate gains over them."""
    out = np.zeros(parts.table.shape)
    layout, joints = parts.layout, parts.bins.q.shape[1]
    legged = layout is QUADRUPED
    torque, rate = layout.channels["joint_torque"].start, layout.channels["joint_rate"].start
    forces = np.zeros((len(out), joints + 6))
    for axis, x in change.get("gyro", {}).items():
        out[:, axis] += x
        out[:, 6:18] += known.leg_omega[:, :, axis] * x[:, None]
    for axis, x in change.get("accel", {}).items():
        out[:, 3 + axis] += x
    for place, x in change.get("q", {}).items():
        leg, j = divmod(place, 3)
        if legged:
            out[:, 6 + 3 * leg : 9 + 3 * leg] += known.leg_q[:, leg, :, j] * x[:, None]
            out[:, 18 + leg] += known.height_q[:, leg, j] * x
        out[:, rate + place] += slope(x)
        forces += known.effort_q[place] * x[:, None]
    for place, x in change.get("dq", {}).items():
        leg, j = divmod(place, 3)
        if legged:
            out[:, 6 + 3 * leg : 9 + 3 * leg] += known.leg_dq[:, leg, :, j] * x[:, None]
        out[:, rate + place] -= smooth_121(x)
        forces += known.effort_dq[place] * x[:, None]
    for place, x in change.get("ddq", {}).items():
        forces += known.effort_ddq[place] * x[:, None]
    for place, x in change.get("tau", {}).items():
        forces += known.effort_tau[place] * x[:, None]
    forces = smooth_121(forces)
    out[:, torque : torque + joints] += forces[:, :joints]
    if legged:
        out[:, layout.channels["base_wrench"]] += forces[:, joints:]
    return sparse(out, parts.table)


def wrt_robot(parts: Parts, robot: Machine, one: Robot, step: float) -> Regressor:
    """What a changed body does to the table, the model `one` having `step` more than `robot`."""
    table = parts.table.copy()
    legs_alone = robot.extras is one.extras
    if np.isfinite(table[:, 6:18]).any() and legs_alone:
        table[:, 6:18] = leg_columns(parts.bins, one)
        if np.isfinite(table[:, 18:22]).any():
            table[:, 18:22] = height_columns(parts.bins, one)
    if parts.inverse_dynamics is not None and parts.steps.steady.any():
        needed = parts.inverse_dynamics
        if robot.legs.offset is not one.legs.offset:
            needed = inverse_dynamics(parts.steps, one)
            torques = parts.layout.channels["joint_torque"]
            table[:, torques] = torque_residual(parts.steps, needed)
        elif not legs_alone:
            more = carried(parts.steps, one) - carried(parts.steps, robot)
            needed = replace(needed, wrench=needed.wrench + more)
        table[:, 34:40] = wrench_residual(parts.steps, needed, one)
    return sparse((table - parts.table) / step, parts.table)


def sparse(change: np.ndarray, table: np.ndarray) -> Regressor:
    """The columns that change at all, zero where the table has nothing."""
    touched = np.flatnonzero(change.any(axis=0))
    change, there = change[:, touched], np.isfinite(table[:, touched])
    change = np.where(there, np.nan_to_num(change), 0.0)
    large = np.abs(change).max(axis=0) > 1e-9
    return Regressor(touched[large], np.ascontiguousarray(change[:, large]))


def explained_share(one: Regressor, table: np.ndarray) -> float:
    """Share of the table's columns that a positive size of the regressor explains; less than zero
    where it wants a negative one. Columns weigh by their bulk."""
    y = table[:, one.columns] - np.nanmedian(table[:, one.columns], axis=0)
    bulk = np.maximum(1.4826 * np.nanmedian(np.abs(y), axis=0), 1e-12)
    y = np.clip(y / bulk, -OUTLYING, OUTLYING)
    x = np.where(np.isfinite(y), one.values / bulk, np.nan)
    x, y = np.nan_to_num(x - np.nanmean(x, axis=0)), np.nan_to_num(y)
    shared = np.sum(x * y)
    return float(shared * abs(shared) / max(np.sum(x * x) * np.sum(y * y), 1e-300))
