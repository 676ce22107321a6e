"""Derivatives of the residuals with respect to the readings and the robot, for each bin.

An effect's `compensate` defines how it changes the readings; the remaining derivatives are the same
for all effects and are computed once per log.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np

from surefoot.models.residuals.channel import ResidualInputs
from surefoot.models.residuals.channels import BUNDLED_CHANNELS, channels
from surefoot.models.residuals.feet import between_feet, foot_heights, leg_velocities, stance_means
from surefoot.models.residuals.layout import ResidualTable, filled
from surefoot.models.residuals.torques import (
    DynamicsInputs,
    InverseDynamics,
    inverse_dynamics,
    load_wrench,
    slope,
    smooth_121,
    standing_feet_wrenches,
    with_link_change,
)
from surefoot.sim.common.kernels import kernel
from surefoot.sim.robot import Robot
from surefoot.sim.robot.machine import Machine

DIFFERENCE_STEP = 1e-5  # rad, rad/s


ON_LEGS = ("leg_velocity", "stance_velocity", "foot_height")
ON_CONTACTS = ("contact_timing", "stance_displacement")
ON_TORQUES = ("joint_torque", "base_wrench")
CHAINED_CHANNELS = ("imu_gyro", "imu_accel", *ON_LEGS, *ON_CONTACTS, *ON_TORQUES, "joint_rate")
"""Channels whose derivatives with respect to readings `wrt_readings` has; of the times of events,
which a small change of a reading does not move, they are zero.
"""
CHANNELS_OF_FIELD = {
    **dict.fromkeys(("legs", "foot_radius"), (*ON_LEGS, *ON_CONTACTS, *ON_TORQUES)),
    **dict.fromkeys(("payload", "com_shift", "links"), ON_TORQUES),
    "touchdown_late": ("contact_timing",),
    "liftoff_late": ON_CONTACTS,
    "softness": (*ON_LEGS, *ON_TORQUES),
    "imu_lowpass": ("imu_gyro", "imu_accel", *ON_LEGS),
    "command_late": ("command",),
}
"""Field of a robot, or of its declared extras, -> channels that it may change."""
OUTLYING = 4.0
"""Robust standard deviations at which entries of a column are clipped."""


@dataclass(frozen=True)
class Regressor:
    """Derivative of columns (n,) of the residual table with respect to an effect's size: values (M,
    n).
    """

    columns: np.ndarray
    values: np.ndarray


@dataclass(frozen=True)
class ResidualJacobians:
    """Derivatives of a residual table in each bin; L legs of P joints, J joints in all.

    The order of the joints of a leg is that in `Limbs.chains`.

    Attributes:
        parts: the table.
        robot: the model.
        leg_omega: of the leg velocities by the rate of the IMU (M, 3 L, 3).
        leg_q: of the leg velocities by the leg's own joint angles (M, L, 3, P).
        leg_dq: of the leg velocities by the leg's own joint rates (M, L, 3, P).
        height_q: of the foot heights by the leg's own joint angles (M, L, P).
    """

    parts: ResidualTable
    robot: Machine
    leg_omega: np.ndarray
    leg_q: np.ndarray
    leg_dq: np.ndarray
    height_q: np.ndarray

    @cached_property
    def dynamics_jacobians(self) -> np.ndarray:
        """Derivatives (4, J, M, J + 6) of torques and wrench by each joint's angle, rate,
        acceleration and torque.

        They take most of the time, and are not needed for effects of the IMU alone.
        """
        _, joints = self.parts.inputs.bins.q.shape
        needed = self.parts.inputs.inverse_dynamics
        if needed is None or self.robot.dynamics is None:
            return np.zeros((4, joints, len(self.parts.t), joints + 6))
        return _dynamics_jacobians(self.parts, needed, self.robot)


def residual_jacobians(parts: ResidualTable, robot: Machine) -> ResidualJacobians:
    """Compute the derivatives with respect to the readings."""
    layout, bins = parts.layout, parts.inputs.bins
    m, joints = bins.q.shape
    legs, chains = len(layout.limbs.legs), layout.limbs.chains
    per = max(map(len, chains), default=0)
    leg_omega, leg = np.zeros((m, 3 * legs, 3)), np.zeros((2, m, legs, 3, per))
    height_q = np.zeros((m, legs, per))
    feet = robot.feet
    if feet is not None and np.isfinite(parts.table[:, layout.of("leg_velocity")]).any():
        place, rate = bins.feet
        # Of each foot alone: contrasts between feet are taken in `wrt_readings`.
        velocities = leg_velocities(bins, feet)

        def by(**moved) -> np.ndarray:
            ahead = leg_velocities(replace(bins, **moved), feet)
            return np.nan_to_num(ahead - velocities) / DIFFERENCE_STEP

        for axis in range(3):
            leg_omega[:, :, axis] = by(omega=bins.omega + DIFFERENCE_STEP * np.eye(3)[axis])
        heights = parts.table[:, layout.of("foot_height")]
        for j in range(per):
            # Perturb one joint of every leg at once, since a leg's columns depend on its own joints
            # only.
            all_legs = np.zeros(joints)
            all_legs[[chain[j] for chain in chains if j < len(chain)]] = DIFFERENCE_STEP
            leg[0, ..., j] = by(feet=(place + all_legs, rate)).reshape(m, legs, 3)
            leg[1, ..., j] = by(feet=(place, rate + all_legs)).reshape(m, legs, 3)
            if np.isfinite(heights).any():
                rise = foot_heights(replace(bins, feet=(place + all_legs, rate)), feet)
                height_q[:, :, j] = np.nan_to_num(rise - heights) / DIFFERENCE_STEP
    return ResidualJacobians(parts, robot, leg_omega, leg[0], leg[1], height_q)


def _dynamics_jacobians(
    parts: ResidualTable, needed: InverseDynamics, robot: Machine
) -> np.ndarray:
    """Derivatives (4, J, M, J + 6) by each joint's angle, rate, acceleration and torque.

    The last axis holds the torques, then the wrench.
    """
    steps, dynamics = parts.inputs.steps, robot.dynamics
    assert dynamics is not None
    m, joints = steps.q.shape
    out = np.zeros((4, joints, m, joints + 6))
    use = steps.needed
    s = replace(steps, **{f.name: getattr(steps, f.name)[use] for f in fields(steps)})
    wrench, torque = dynamics.derivatives(*steps.motion, DIFFERENCE_STEP)
    out[:3, :, use, :joints], out[:3, :, use, joints:] = -torque, -wrench
    for j in range(joints):
        out[3, j, use, j] = 1.0
    legged = robot.legged
    if legged is not None and s.steady.any() and robot.limbs.point_feet:
        out[:, :, use, joints:] += _feet_wrench_jacobians(s, needed.torque[use], torque, legged)
    return out


def _feet_wrench_jacobians(
    s: DynamicsInputs, needed: np.ndarray, torque: np.ndarray, robot: Robot
) -> np.ndarray:
    """Derivatives (4, J, M, 6) of the feet's wrench on the base.

    For a given motion of the base, a joint changes the torques of its own leg and so the force of
    its own foot only, so that all legs can be perturbed at once.

    needed (M, J), torque (3, J, M, J): torques by inverse dynamics and their derivatives.
    """
    bins, joints = needed.shape
    chains = np.array(robot.limbs.chains)
    out = np.zeros((4, joints, bins, 6))
    plain = standing_feet_wrenches(s, s.q, needed - s.tau, robot)
    for at in chains.T:
        moved = np.zeros(joints)
        moved[at] = 1.0
        for kind in range(4):
            if kind == 3:
                step, gained = 1.0, -moved
            else:
                step, gained = DIFFERENCE_STEP, np.zeros((bins, joints))
                for joint, chain in zip(at, chains, strict=True):
                    gained[:, chain] = DIFFERENCE_STEP * torque[kind, joint][:, chain]
            q = s.q + DIFFERENCE_STEP * moved if kind == 0 else s.q
            given = standing_feet_wrenches(s, q, needed - s.tau + gained, robot)
            out[kind, at] = np.moveaxis(given - plain, 1, 0) / step
    return out


def wrt_readings(
    parts: ResidualTable, known: ResidualJacobians, change: Mapping[str, Mapping[int, np.ndarray]]
) -> np.ndarray:
    """Change of the table (M, W) with the readings, by the chain rule.

    `change` maps each stream and index (axis or joint) to bin means (M,) of its change. "omega" is
    the gyro at the rows' times, "q_step" and "dq_step" are at the times of the torques, and "ddq"
    is the rate's slope over these.
    """
    out, layout = np.zeros(parts.table.shape), parts.layout
    joints, leg_of = parts.inputs.bins.q.shape[1], layout.limbs.leg_of
    gyro, accel, legs = (layout.of(n) for n in ("imu_gyro", "imu_accel", "leg_velocity"))
    velocity, height = layout.by_leg("leg_velocity"), layout.by_leg("foot_height")
    torque, wrench, rate = (layout.of(n) for n in ("joint_torque", "base_wrench", "joint_rate"))
    for axis, x in change.get("gyro", {}).items():
        out[:, gyro[axis]] += x
    for axis, x in change.get("omega", {}).items():
        out[:, legs] += known.leg_omega[:, :, axis] * x[:, None]
    for axis, x in change.get("accel", {}).items():
        out[:, accel[axis]] += x
    for stream, by_leg in (("q", known.leg_q), ("dq", known.leg_dq)):
        for joint, x in change.get(stream, {}).items():
            leg = leg_of[joint]
            if leg is not None:
                j = layout.limbs.chains[leg].index(joint)
                out[:, velocity[leg]] += by_leg[:, leg, :, j] * x[:, None]
                if stream == "q":
                    out[:, height[leg, 0]] += known.height_q[:, leg, j] * x
            out[:, rate[joint]] += slope(x) if stream == "q" else -smooth_121(x)
    if len(legs) and any(change.get(stream) for stream in ("omega", "q", "dq")):
        if not parts.inputs.motion.by_reference:
            stood = np.repeat(parts.inputs.bins.standing, 3, axis=1)
            out[:, legs] = np.nan_to_num(between_feet(np.where(stood, out[:, legs], np.nan)))
        moved = np.flatnonzero(out[:, velocity].any(axis=(0, 2)))
        stands = np.isfinite(parts.table[:, velocity[moved, 0]])
        means = stance_means(parts.t, out[:, velocity[moved]], stands)
        out[:, layout.by_leg("stance_velocity")[moved]] = np.nan_to_num(means)
    of_torques = ("q_step", "dq_step", "ddq", "tau")
    if any(change.get(stream) for stream in of_torques):
        forces = np.zeros((len(out), joints + 6))
        for stream, by_joint in zip(of_torques, known.dynamics_jacobians, strict=True):
            for joint, x in change.get(stream, {}).items():
                forces += by_joint[joint] * x[:, None]
        forces = smooth_121(forces)
        out[:, torque] += forces[:, :joints]
        if len(wrench):
            out[:, wrench] += forces[:, joints:]
    return out


def wrt_robot(parts: ResidualTable, robot: Machine, one: Machine, step: float) -> np.ndarray:
    """Change of the table (M, W) per unit, for a model `one` with `step` more of an effect than
    `robot`.

    The channels are recomputed from the same bin means. Times of contact changes are kept, since a
    small step moves them by less than a row.
    """
    same = unchanged_channels(robot, one)
    again = [n for n, channel in channels().items() if not (channel.of_events or n in same)]
    inputs = parts.inputs.under_model(one, _inverse_dynamics_under(parts.inputs, robot, one))
    return (filled(parts.layout, inputs, again) - parts.table) / step


def _inverse_dynamics_under(
    inputs: ResidualInputs, robot: Machine, one: Machine
) -> InverseDynamics | None:
    """Inverse dynamics of `inputs`, which are under the model `robot`, under the model `one`."""
    needed, steps, dynamics = inputs.inverse_dynamics, inputs.steps, robot.dynamics
    if needed is None or dynamics is None:
        return None
    if not _same_joints(robot, one):
        return inverse_dynamics(steps, one)
    links = one.extras.links
    one_more = bool(links) and links[:-1] == robot.extras.links
    by_links = inputs.link_jacobians if one_more else None
    if by_links is not None:
        needed = with_link_change(needed, links[-1], by_links, steps, dynamics)
    elif links != robot.extras.links:
        return inverse_dynamics(steps, one)
    more = load_wrench(steps, one) - load_wrench(steps, robot)
    return replace(needed, wrench=needed.wrench + more)


def unchanged_channels(robot: Machine, one: Machine) -> tuple[str, ...]:
    """Bundled channels that are equal under two models with the same readings.

    Empty if the models differ in a field whose influence is not known.
    """
    if type(robot) is not type(one):
        return ()
    pairs = {f.name: (robot, one) for f in fields(robot) if f.name != "extras"}
    pairs |= {f.name: (robot.extras, one.extras) for f in fields(robot.extras)}
    moved = [n for n, (a, b) in pairs.items() if getattr(a, n) is not getattr(b, n)]
    if any(name not in CHANNELS_OF_FIELD for name in moved):
        return ()
    touched = {name for n in moved for name in CHANNELS_OF_FIELD[n]}
    if one.extras.softness and touched & set(ON_TORQUES):
        touched |= set(ON_LEGS)  # loads say how deep feet are
    return tuple(kind.name for kind in BUNDLED_CHANNELS if kind.name not in touched)


def _same_joints(robot: Machine, one: Machine) -> bool:
    """Whether both models have their joints at the same places."""
    if robot.legged is None or one.legged is None:
        return True
    own, other = robot.legged.legs, one.legged.legs
    return np.array_equal(own.offset, other.offset) and np.array_equal(own.rotation, other.rotation)


def sparse(change: np.ndarray, table: np.ndarray) -> Regressor:
    """Keep the columns of a change that are not zero, with zeros where the table has no value."""
    columns = np.flatnonzero(_zeroed(change, table) > 1e-9)
    return Regressor(columns, change[:, columns])


@kernel
def _zeroed(change, table):
    """Set a change (M, W) to zero where it or the table has no value, and return its largest
    absolute value (W,) in each column.
    """
    largest = np.zeros(change.shape[1])
    for k in range(change.shape[0]):
        for c in range(change.shape[1]):
            if not (np.isfinite(change[k, c]) and np.isfinite(table[k, c])):
                change[k, c] = 0.0
            largest[c] = max(largest[c], abs(change[k, c]))
    return largest


def explained_share(one: Regressor, table: np.ndarray) -> float:
    """Share of the table's columns explained by a positive size of the regressor.

    Negative where the best size is negative. Columns are scaled by their robust deviation.
    """
    y = table[:, one.columns] - np.nanmedian(table[:, one.columns], axis=0)
    bulk = np.maximum(1.4826 * np.nanmedian(np.abs(y), axis=0), 1e-12)
    y = np.clip(y / bulk, -OUTLYING, OUTLYING)
    x = np.where(np.isfinite(y), one.values / bulk, np.nan)
    x, y = np.nan_to_num(x - np.nanmean(x, axis=0)), np.nan_to_num(y)
    shared = np.sum(x * y)
    return float(shared * abs(shared) / max(np.sum(x * x) * np.sum(y * y), 1e-300))
