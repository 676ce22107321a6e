"""Motion that a log's readings are compared with, under a model.

Without a reference, a walk's motion is from its IMU and legs alone. It is derived from the
readings, which can therefore not be compared with it. It only gives the vertical, the stances, and
the course for the simulated walks of a noise floor. The residuals are then contrasts between feet
in simultaneous stance (`feet.between_feet`), and those of the joints alone.
"""

from dataclasses import replace

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.ndimage import uniform_filter1d
from scipy.spatial.transform import Rotation

from surefoot.models.residuals.binning import (
    ReferenceMotion,
    at_rows,
    binned,
    reference_motion,
)
from surefoot.models.residuals.contact_timing import within_windows
from surefoot.models.residuals.feet import (
    footholds,
    ground_normals,
    leg_velocities,
    level_ground,
    unevenness,
)
from surefoot.sim.common.quaternion import quaternion_from_matrix
from surefoot.sim.common.series import interpolate_rows
from surefoot.sim.log import Log
from surefoot.sim.robot.feet import Feet, shown_feet
from surefoot.sim.robot.machine import Machine

LEVELLING_WINDOW = 1.0
"""Averaging time of the specific force for the vertical [s]: accelerations of a walk average to a
few hundredths of gravity, and the vertical only affects the contact point of a rolling foot.
"""


def motion_under_model(log: Log, robot: Machine, fixed: bool) -> ReferenceMotion:
    """Reference motion of a log, with stances and swings as they are under this model.

    Without a reference, the motion by IMU and legs.
    """
    if fixed or robot.fixed:
        return reference_motion(log, robot.limbs, fixed)
    if not log.has("reference"):
        return motion_without_reference(log, robot)
    motion = reference_motion(log, robot.limbs)
    return within_windows(motion, log, robot) if motion.standing.any() else motion


def with_ground(motion: ReferenceMotion, log: Log, robot: Machine) -> ReferenceMotion:
    """Detect whether the ground is level, so that heights of feet can be compared, and otherwise
    how uneven it is, and its normal where it slopes.

    A staircase rises as a slope does, but its treads are level: the slope's normal is taken only if
    the feet then move less over the ground.
    """
    feet = shown_feet(log, robot.feet)
    if feet is None or not (motion.by_reference and motion.standing.any()):
        return motion
    bins = binned(log, robot, motion)
    if level_ground(bins, feet):
        return replace(motion, level=True)
    holds, leg = footholds(bins, feet)
    motion = replace(motion, unevenness=unevenness(holds, leg))
    slope = ground_normals(holds, bins.p_GI)
    sloping = replace(motion, normal_G=interpolate_rows(log.t, bins.t, slope))
    moves = [
        np.nanmedian(np.abs(leg_velocities(binned(log, robot, one), feet)))
        for one in (motion, sloping)
    ]
    return sloping if moves[1] < moves[0] else motion


def motion_without_reference(log: Log, robot: Machine) -> ReferenceMotion:
    """Stances, bins and vertical of a walk without a reference.

    No foot stands or swings where the log lacks IMU, angles or contacts, or where it gives the
    feet: their differences while one turns depend on how far each rolls, which is not known.
    """
    reckoned = with_dead_reckoning(log, robot.feet)
    if reckoned is None:
        motion = reference_motion(log, robot.limbs, fixed=True)
        return replace(motion, lifted=motion.standing, by_reference=False)
    motion = within_windows(reference_motion(reckoned, robot.limbs), reckoned, robot)
    nothing = np.zeros((len(log.t), 3))
    unknown = np.full_like(nothing, np.nan)
    return replace(
        motion, gyro=unknown, accel=unknown, v_I=nothing, p_GI=nothing, by_reference=False
    )


def with_dead_reckoning(log: Log, feet: Feet | None) -> Log | None:
    """Replace a log's reference by dead reckoning.

    The velocity is the mean over the standing feet, up is the direction of the mean specific force,
    and the heading is the integral of the gyro. None where the log lacks IMU, angles or contacts,
    where no foot ever stands, or where it is unknown how far the feet roll.
    """
    if feet is None or feet.roll_unknown or not all(map(log.has, ("imu", "q", "contact"))):
        return None
    if not log.contact.any():
        return None
    up = uniform_filter1d(log.accel, max(1, round(LEVELLING_WINDOW * log.rate)), axis=0)
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    by_foot = feet.imu_velocity(*feet.readings(log), at_rows(log.gyro), up, log.contact)
    count = log.contact.sum(axis=1)
    v_I = np.nansum(by_foot, axis=1) / np.maximum(count, 1)[:, None]
    stands = np.flatnonzero(count)
    v_I = interpolate_rows(log.t, log.t[stands], v_I[stands])
    yaw = cumulative_trapezoid(np.sum(log.gyro * up, axis=1), log.t, initial=0.0)
    # Rows: level heading, left and up, expressed in I.
    ahead = np.array([1.0, 0.0, 0.0]) - up[:, :1] * up
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    R_levelled = np.stack([ahead, np.cross(up, ahead), up], axis=1)
    R_GI = Rotation.from_euler("z", yaw[:, None]).as_matrix() @ R_levelled
    v_GI = np.einsum("nij,nj->ni", R_GI, v_I)
    p_GI = cumulative_trapezoid(v_GI, log.t, axis=0, initial=0.0)
    q_GI = quaternion_from_matrix(R_GI)
    columns = {f"ref_q_{a}": q_GI[:, i] for i, a in enumerate("wxyz")}
    columns |= {f"ref_p_{a}": p_GI[:, i] for i, a in enumerate("xyz")}
    columns |= {f"ref_v_{a}": v_GI[:, i] for i, a in enumerate("xyz")}
    return log.with_columns(columns)
