"""What a log's readings say beyond the model: residual channels against the log's reference.

    imu_gyro, imu_accel   reading minus what the reference motion implies for the same sample
    leg_velocity          body velocity by each standing foot's kinematics, less the reference's
    foot_height           height of each standing foot in the world, where the ground is level
    joint_torque          measured torque less inverse dynamics, of legs in swing or a fixed base
    base_wrench           what the standing feet give the base less what its motion takes
    joint_rate            slope of a joint's measured angle less its measured rate
    contact_timing        when a contact is told to change less when the foot stopped or moved

Residuals are means over bins of 20 ms.
"""

from dataclasses import dataclass, replace

import numpy as np

from surefoot.models.residuals.binning import Bins, ReferenceMotion, binned
from surefoot.models.residuals.contact_timing import contact_timing
from surefoot.models.residuals.foot_loads import foot_loads
from surefoot.models.residuals.layout import QUADRUPED, Layout, layout_of
from surefoot.models.residuals.leg_velocity import leg_velocity
from surefoot.models.residuals.soft_ground import foot_sinking
from surefoot.models.residuals.torques import (
    InverseDynamics,
    Steps,
    inverse_dynamics,
    slope,
    steps_of,
    torque_residual,
    wrench_residual,
)
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot
from surefoot.sim.robot.fixed_base import Machine

HALFWAY = 0.5
"""Share of a foot's depth above its sole at which it touches."""


@dataclass(frozen=True)
class Parts:
    """A log's residuals and what they were computed from: what derivatives need again."""

    layout: Layout
    bins: Bins
    steps: Steps
    inverse_dynamics: InverseDynamics | None
    table: np.ndarray  # (M, W)
    t: np.ndarray  # (M,) s


def residual(log: Log, robot: Machine, frame: ReferenceMotion) -> Parts:
    """Residuals of the log's readings under the declared model `robot`."""
    layout = layout_of(log.joints)
    bins = binned(log, robot, frame)
    table = np.full((len(bins.t), layout.width), np.nan)
    steps, needed = steps_of(bins, robot), None
    if np.isfinite(bins.tau).any():
        needed = inverse_dynamics(steps, robot)
        table[:, layout.channels["joint_torque"]] = torque_residual(steps, needed)
    if log.has("q") and log.has("dq"):
        rates = slope(bins.lag)
        rates[[0, -1]] = np.nan
        table[:, layout.channels["joint_rate"]] = rates
    if layout is QUADRUPED:
        assert isinstance(robot, Robot)
        table[:, :3], table[:, 3:6] = bins.gyro, bins.accel
        if log.has("q") and bins.standing.any():
            if robot.extras.softness:
                load = foot_loads(log, robot, frame, bins, steps)
                depth, v_sole = foot_sinking(log, robot, frame, bins, load)
                bins = replace(bins, depth=depth, v_sole=v_sole)
                steps = replace(steps, sunk=HALFWAY * depth)
            table[:, 6:18] = leg_columns(bins, robot)
            if frame.level:
                table[:, 18:22] = height_columns(bins, robot)
            table[:, layout.channels["contact_timing"]] = contact_timing(log, robot, frame)
            if needed is not None:
                table[:, 34:40] = wrench_residual(steps, needed, robot)
    return Parts(layout, bins, steps, needed, table, frame.t)


def leg_columns(bins: Bins, robot: Robot) -> np.ndarray:
    """(M, 12) [m/s] in I. With v_foot = 0 at the contact point of a foot that rolls on its sphere
    of radius r, v_I = -J dq - omega x f + (omega + omega_foot) x r n, all in I."""
    v = leg_velocity(
        robot.legs, robot.foot_radius, robot.R_BI, robot.p_BI, bins.q, bins.dq, bins.omega,
        bins.R_GI[:, 2], bins.standing,
    )  # fmt: skip
    v -= bins.v_I[:, None]
    if bins.depth is not None and bins.v_sole is not None:
        spin = bins.omega[:, None] + robot.foot_rates_I(bins.q, bins.dq)
        rise = HALFWAY * bins.depth[:, :, None] * bins.R_GI[:, None, 2]
        v += bins.v_sole - np.cross(spin, rise)
    return v.reshape(len(v), 12)


def height_columns(bins: Bins, robot: Robot) -> np.ndarray:
    """Height (M, 4) [m] of each standing foot's centre in the world."""
    feet_I = robot.feet_I(bins.q)
    z = bins.p_GI[:, 2, None] + np.einsum("nj,nlj->nl", bins.R_GI[:, 2], feet_I)
    if bins.depth is not None:
        z = z + bins.depth
    return np.where(bins.standing, z, np.nan)


def level_ground(bins: Bins, robot: Robot, within: float = 0.006) -> bool:
    """Whether the feet stand on one plane: what a leg's heights have beyond a plane through all
    feet and a constant of the leg's own varies by less than `within` [m]."""
    z = height_columns(bins, robot)
    rows, legs = np.nonzero(np.isfinite(z))
    if len(rows) < 100:
        return False
    A = np.hstack([np.eye(4)[legs], bins.p_GI[rows, :2]])
    left = z[rows, legs]
    for _ in range(3):
        fit = np.linalg.lstsq(A, z[rows, legs], rcond=1e-10)[0]
        left = np.abs(z[rows, legs] - A @ fit)
        keep = left <= 4 * np.median(left) + 1e-4
        rows, legs, A = rows[keep], legs[keep], A[keep]
    return bool(1.4826 * np.median(left) < within)


def with_ground(frame: ReferenceMotion, log: Log, robot: Machine) -> ReferenceMotion:
    """The frame, knowing whether heights of feet mean anything."""
    if not isinstance(robot, Robot) or not log.has("q") or not frame.standing.any():
        return frame
    return replace(frame, level=level_ground(binned(log, robot, frame), robot))
