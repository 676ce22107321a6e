"""Derivatives of the residuals with respect to the readings and the robot, for each bin.

An effect's `compensate` defines how it changes the readings; the remaining derivatives are the same
for all effects and are computed once per log.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np

from surefoot.models.residuals.binning import Bins
from surefoot.models.residuals.channel import ResidualInputs
from surefoot.models.residuals.channels import BUNDLED_CHANNELS
from surefoot.models.residuals.feet import between_feet, foot_heights, leg_velocities, stance_means
from surefoot.models.residuals.layout import ResidualTable
from surefoot.models.residuals.torques import (
    DynamicsInputs,
    InverseDynamics,
    load_wrench,
    slope,
    smooth_121,
    standing_feet_wrenches,
)
from surefoot.sim.common.kernels import kernel
from surefoot.sim.robot import Robot
from surefoot.sim.robot.body_changes import LinkChange
from surefoot.sim.robot.feet import Feet
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
    """

    parts: ResidualTable

    @cached_property
    def turning(self) -> np.ndarray:
        """Of the leg velocities by the rate of the IMU (M, L, 3, 3)."""
        bins = self.parts.inputs.bins
        out = np.zeros((*bins.standing.shape, 3, 3))
        if self._feet is not None:
            for axis, along in enumerate(DIFFERENCE_STEP * np.eye(3)):
                out[..., axis] = self._faster(replace(bins, omega=bins.omega + along), self._feet)
        return out

    @cached_property
    def legs(self) -> dict[str, np.ndarray]:
        """Of the leg velocities by the leg's own joint angles and rates, "q" and "dq" (M, L, 3, P);
        of the foot heights by the leg's own angles, "height" (M, L, P).
        """
        layout, bins, feet = self.parts.layout, self.parts.inputs.bins, self._feet
        chains = layout.limbs.chains
        per = max(map(len, chains), default=0)
        columns = {"q": (3, per), "dq": (3, per), "height": (per,)}
        out = {name: np.zeros((*bins.standing.shape, *each)) for name, each in columns.items()}
        if feet is None:
            return out
        place, rate = bins.feet
        heights = self.parts.table[:, layout.of("foot_height")]
        for j in range(per):
            # Perturb one joint of every leg at once, since a leg's columns depend on its own joints
            # only.
            step = np.zeros(bins.q.shape[1])
            step[[chain[j] for chain in chains if j < len(chain)]] = DIFFERENCE_STEP
            moved = replace(bins, feet=(place + step, rate))
            out["q"][..., j] = self._faster(moved, feet)
            out["dq"][..., j] = self._faster(replace(bins, feet=(place, rate + step)), feet)
            if np.isfinite(heights).any():
                higher = foot_heights(moved, feet) - heights
                out["height"][..., j] = np.nan_to_num(higher) / DIFFERENCE_STEP
        return out

    @cached_property
    def _feet(self) -> Feet | None:
        """The feet, where any of them has a velocity."""
        velocity = self.parts.table[:, self.parts.layout.of("leg_velocity")]
        return self.parts.inputs.robot.feet if np.isfinite(velocity).any() else None

    @cached_property
    def _velocities(self) -> np.ndarray:
        """Velocities of each foot alone: contrasts between feet are taken in `wrt_readings`."""
        inputs = self.parts.inputs
        assert inputs.robot.feet is not None  # as `_feet`
        return leg_velocities(inputs.bins, inputs.robot.feet)

    def _faster(self, moved: Bins, feet: Feet) -> np.ndarray:
        """Change of the leg velocities (M, L, 3) with other bins, per unit of DIFFERENCE_STEP."""
        change = np.nan_to_num(leg_velocities(moved, feet) - self._velocities)
        return change.reshape(*moved.standing.shape, 3) / DIFFERENCE_STEP

    @cached_property
    def dynamics(self) -> np.ndarray:
        """Of the torques and the wrench by each joint's angle, rate, acceleration and torque
        (4, J, M, J + 6).

        They take most of the time, and are not needed for effects of the IMU alone.
        """
        inputs = self.parts.inputs
        robot, steps, needed = inputs.robot, inputs.steps, inputs.inverse_dynamics
        m, joints = inputs.bins.q.shape
        out = np.zeros((4, joints, m, joints + 6))
        if needed is None or robot.dynamics is None:
            return out
        use = steps.needed
        wrench, torque = robot.dynamics.derivatives(*steps.motion, DIFFERENCE_STEP)
        out[:3, :, use, :joints], out[:3, :, use, joints:] = -torque, -wrench
        out[3, np.arange(joints), :, np.arange(joints)] = np.isin(np.arange(m), use)
        if robot.legged is not None and steps.steady.any() and robot.limbs.point_feet:
            more = _feet_wrench_jacobians(steps, needed.torque, -out[..., :joints], robot.legged)
            out[:, :, use, joints:] += more[:, :, use]
        return out

    def wrt_readings(self, change: Mapping[str, Mapping[int, np.ndarray]]) -> np.ndarray:
        """Change of the table (M, W) with the readings, by the chain rule.

        `change` maps each stream and index (axis or joint) to bin means (M,) of its change.
        "omega" is the gyro at the rows' times, "q_step" and "dq_step" are at the times of the
        torques, and "ddq" is the rate's slope over these.
        """
        parts, layout, limbs = self.parts, self.parts.layout, self.parts.layout.limbs
        out, (_, joints) = np.zeros(parts.table.shape), parts.inputs.bins.q.shape
        velocity, height = layout.by_leg("leg_velocity"), layout.by_leg("foot_height")
        rate, legs = layout.of("joint_rate"), layout.of("leg_velocity")
        for stream in ("gyro", "accel"):
            for axis, x in change.get(stream, {}).items():
                out[:, layout.of(f"imu_{stream}")[axis]] += x
        for axis, x in change.get("omega", {}).items():
            out[:, velocity] += self.turning[..., axis] * x[:, None, None]
        for stream in ("q", "dq"):
            for joint, x in change.get(stream, {}).items():
                leg = limbs.leg_of[joint]
                if leg is not None:
                    j = limbs.chains[leg].index(joint)
                    out[:, velocity[leg]] += self.legs[stream][:, leg, :, j] * x[:, None]
                    if stream == "q":
                        out[:, height[leg, 0]] += self.legs["height"][:, leg, j] * x
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
            for stream, by_joint in zip(of_torques, self.dynamics, strict=True):
                for joint, x in change.get(stream, {}).items():
                    forces += by_joint[joint] * x[:, None]
            columns = layout.of("joint_torque", "base_wrench")
            out[:, columns] += smooth_121(forces)[:, : len(columns)]
        return out


def _feet_wrench_jacobians(
    s: DynamicsInputs, needed: np.ndarray, torque: np.ndarray, robot: Robot
) -> np.ndarray:
    """Derivatives (4, J, M, 6) of the feet's wrench on the base.

    For a given motion of the base, a joint changes the torques of its own leg and so the force of
    its own foot only, so that all legs can be perturbed at once.

    needed (M, J): torques by inverse dynamics; torque (4, J, M, J): derivatives of these less the
    measured ones.
    """
    chains, taken = np.array(robot.limbs.chains), needed - s.bins.tau
    out = np.zeros((*torque.shape[:3], 6))
    plain = standing_feet_wrenches(s, s.bins.q_step, taken, robot)
    for at in chains.T:
        moved = np.zeros(needed.shape[1])
        moved[at] = DIFFERENCE_STEP
        for kind, step in enumerate((*(DIFFERENCE_STEP,) * 3, 1.0)):
            gained = np.zeros_like(needed)
            for joint, chain in zip(at, chains, strict=True):
                gained[:, chain] = step * torque[kind, joint][:, chain]
            q = s.bins.q_step + moved if kind == 0 else s.bins.q_step
            given = standing_feet_wrenches(s, q, taken + gained, robot)
            out[kind, at] = np.moveaxis(given - plain, 1, 0) / step
    return out


def under_model(inputs: ResidualInputs, robot: Machine) -> ResidualInputs:
    """The same readings under the model of another body, with the same bin means, and with inverse
    dynamics by the difference between the models where that is possible.
    """
    other = replace(inputs, robot=robot)
    vars(other).update(bins=inputs.bins, steps=inputs.steps)
    links, before = robot.extras.links, inputs.robot.extras.links
    needed = inputs.inverse_dynamics
    if needed is None or not _same_joints(inputs.robot, robot):
        return other
    if links and links[:-1] == before:
        needed = _with_link_change(inputs, needed, links[-1])
    elif links != before:
        return other
    more = load_wrench(inputs.bins, robot) - load_wrench(inputs.bins, inputs.robot)
    vars(other)["inverse_dynamics"] = replace(needed, wrench=needed.wrench + more)
    return other


def _with_link_change(
    inputs: ResidualInputs, needed: InverseDynamics, change: LinkChange
) -> InverseDynamics:
    """Inverse dynamics of the inputs with one more change of a link, to first order."""
    dynamics, by_links, use = inputs.robot.dynamics, inputs.link_jacobians, inputs.steps.needed
    assert dynamics is not None  # as there is inverse dynamics
    sizes = (change.mass, *change.com, change.inertia)
    more = dynamics.parted(np.tensordot(sizes, by_links[:, change.joint], 1).T)
    wrench, torque = needed.wrench.copy(), needed.torque.copy()
    wrench[use] += more[0]
    torque[use] += more[1]
    return InverseDynamics(wrench, torque)


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
