"""Contacts for a log without them, from forces, joint torques, kinematics or the gait."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from surefoot.sim.common.errors import SurefootError, errors_in
from surefoot.sim.common.kernels import kernel
from surefoot.sim.importing.sections import ContactTable, Quantity
from surefoot.sim.log import Log
from surefoot.sim.log.derived import JOINT_WINDOW, derivative
from surefoot.sim.robot import Robot
from surefoot.sim.sensors.stances import contact_from_force

_LEVELLED = 4.0
"""Time constant with which the accelerometer levels the gyro's attitude [s]: a few strides, over
which a walking body's own acceleration averages out. A gyro's bias of 1 mrad/s tilts it by 4 mrad.
"""
_NARROWEST = 0.05
"""Least spread of the feet's mean positions across their longest extent [m] from which their plane
gives the upward direction; a smaller one would be tilted by a step's height.
"""
_IN_PHASE = 0.7
"""Correlation of two feet's velocities from which their legs swing together: diagonal legs of a
trot have 0.9 and more, legs a quarter of a stride apart none.
"""


def feet_that_stand(log: Log, rule: ContactTable) -> Log:
    """Add contact_<leg> to a log by a rule on force, torque, kinematics or gait.

    Raises SurefootError where the log lacks what the rule needs.
    """
    stands = contacts_from_loads(log.t, contact_loads(log, rule.of), rule)
    meta = replace(log.meta, derived=(*log.meta.derived, f"contact from {rule.of}"))
    return replace(log, meta=meta).with_columns(stands)


def contact_loads(log: Log, of: Quantity, robot: Robot | None = None) -> dict[str, np.ndarray]:
    """By leg, what a rule of `ContactTable.of` compares (N,); speeds and heights are negative, so
    that it is the larger, the more a foot stands.

    `robot` is the log's own by default. Raises SurefootError where the log lacks what the rule
    needs.
    """
    if of == "force":
        log.require("force")
        return {leg: log.columns[f"force_{leg}"] for leg in log.legs}
    given = of != "torque" and log.has("foot")
    needed = ("q", "tau") if of == "torque" else ("foot" if given else "q",)
    with errors_in(f"[contact] of {of}"):
        log.require("imu", *needed)
        robot = None if given else robot or Robot.for_log(log)
    legs = log.legs if robot is None else robot.limbs.legs
    feet_I = log.foot_I if robot is None else robot.feet_I(log.q)
    up = up_in_imu(log.t, log.gyro, log.accel)
    if of == "torque" and robot is not None:
        load = upward_forces(log, robot, up)
    elif of == "kinematics":
        load = -speeds_beside_lowest(log.t, feet_I, log.gyro, up)
    else:
        up = up_by_feet(log.t, log.gyro, log.accel, feet_I)
        load = -heights_beside_others(log.t, feet_I, up)
    return dict(zip(legs, load.T, strict=True))


def contacts_from_loads(
    t: np.ndarray, loads: Mapping[str, np.ndarray], rule: ContactTable
) -> dict[str, np.ndarray]:
    """Columns contact_<leg>, 1 where a load by leg, each (N,) at t (N,) [s], stays beyond the
    rule's thresholds.
    """
    found = {}
    for leg, (offset, on, off) in rule.by_leg(tuple(loads)).items():
        stands = contact_from_force(t, loads[leg] - offset, on, off, rule.debounce)
        found[f"contact_{leg}"] = stands.astype(float)
    return found


def speeds_beside_lowest(
    t: np.ndarray, feet_I: np.ndarray, gyro: np.ndarray, up: np.ndarray
) -> np.ndarray:
    """Speed (N, L) [m/s] of each foot relative to the lowest one, small for standing feet.

    Args:
        t: (N,) [s].
        feet_I: (N, L, 3) [m].
        gyro: (N, 3) [rad/s].
        up: (N, 3) upward direction in I.
    """
    rows = np.arange(len(t))
    v_I = _velocities_by_body(t, feet_I, gyro)
    lowest = np.einsum("nli,ni->nl", feet_I, up).argmin(axis=1)
    return np.linalg.norm(v_I - v_I[rows, lowest][:, None], axis=2)


def _velocities_by_body(t: np.ndarray, feet_I: np.ndarray, gyro: np.ndarray) -> np.ndarray:
    """Velocities (N, L, 3) [m/s] of feet over the ground, less that of the IMU, in I."""
    return derivative(t, feet_I, JOINT_WINDOW, causal=False) + np.cross(gyro[:, None], feet_I)


def heights_beside_others(t: np.ndarray, feet_I: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Mean height (N, L) [m] of each foot's group of legs above the lowest other group.

    A group is the legs that swing together; the value is negative for the lowest group. Raises
    SurefootError where all legs swing together.

    Args:
        t: (N,) [s].
        feet_I: (N, L, 3) [m].
        up: (N, 3) upward direction in I.
    """
    groups = legs_in_phase(t, feet_I, up)
    if len(groups) < 2:
        raise SurefootError("[contact] of gait: all legs swing together, none stands meanwhile")
    height = np.einsum("nli,ni->nl", feet_I, up)
    means = np.column_stack([height[:, group].mean(axis=1) for group in groups])
    beside = np.empty_like(height)
    for k, group in enumerate(groups):
        others = np.delete(means, k, axis=1).min(axis=1)
        beside[:, group] = (means[:, k] - others)[:, None]
    return beside


def legs_in_phase(t: np.ndarray, feet_I: np.ndarray, up: np.ndarray) -> list[list[int]]:
    """Groups of legs, by index, that swing together.

    The velocities of their feet correlate by more than _IN_PHASE, along the axis of I in which the
    feet move most, without the upward component.

    Args:
        t: (N,) [s].
        feet_I: (N, L, 3) [m].
        up: (N, 3) upward direction in I.
    """
    v = derivative(t, feet_I, JOINT_WINDOW, causal=False)
    v = v - np.einsum("nli,ni->nl", v, up)[..., None] * up[:, None]
    along = v[:, :, int(np.argmax(np.var(v, axis=0).sum(axis=0)))]
    alike = np.corrcoef(along.T) > _IN_PHASE
    groups: list[list[int]] = []
    for leg in range(feet_I.shape[1]):
        together = next((g for g in groups if alike[leg, g].all()), [])
        if not together:
            groups.append(together)
        together.append(leg)
    return groups


def upward_forces(log: Log, robot: Robot, up: np.ndarray) -> np.ndarray:
    """Upward force (N, L) [N] of the ground on each foot, from the torques of the leg's joints.

    J^T f = -tau by least squares, neglecting the leg's mass; up (N, 3) in I.
    """
    J = robot.feet_jacobian_I(log.q)
    tau = log.tau[:, robot.legs.joints] * (np.abs(J).sum(axis=2) > 0.0)
    force = -np.einsum("nlij,nlj->nli", np.linalg.pinv(np.swapaxes(J, 2, 3)), tau)
    return np.einsum("nli,ni->nl", force, up)


@kernel
def _levelled(t, gyro, accel, settled):
    up = np.empty_like(accel)
    u = accel[:settled].sum(axis=0)
    u /= np.sqrt(np.sum(u**2))
    for k in range(len(t)):
        dt = t[k] - t[k - 1] if k else 0.0
        u = u - np.cross(gyro[k], u) * dt
        size = np.sqrt(np.sum(accel[k] ** 2))
        if size > 0.0:
            u = u + dt / _LEVELLED * (accel[k] / size - u)
        u = u / np.sqrt(np.sum(u**2))
        up[k] = u
    return up


def up_in_imu(t: np.ndarray, gyro: np.ndarray, accel: np.ndarray) -> np.ndarray:
    """Upward direction (N, 3) in I, of unit length, at t (N,) [s].

    Integrated from gyro (N, 3) [rad/s] and corrected towards accel (N, 3) [m/s^2] with the time
    constant _LEVELLED.
    """
    settled = max(int(np.searchsorted(t, t[0] + _LEVELLED)), 1)
    return _levelled(t, gyro, accel, settled)


def up_by_feet(
    t: np.ndarray, gyro: np.ndarray, accel: np.ndarray, feet_I: np.ndarray
) -> np.ndarray:
    """Upward direction (N, 3) in I, across the ground on which the feet walk.

    As `up_in_imu`, but the gyro is corrected towards the normal of the plane through the mean
    positions of feet_I (N, L, 3) [m]: no bias of the accelerometer tilts it, and on a slope it is
    the slope's normal. Fewer than three feet, or feet in a line, leave it to the accelerometer.
    """
    up = up_in_imu(t, gyro, accel)
    mean_I = feet_I.mean(axis=0)
    _, spread, axes = np.linalg.svd(mean_I - mean_I.mean(axis=0))
    if len(mean_I) < 3 or spread[1] < _NARROWEST:
        return up
    normal = axes[2] * np.sign(axes[2] @ up.mean(axis=0))
    return up_in_imu(t, gyro, np.tile(normal, (len(t), 1)))
