"""The home pose of a robot: that of its model, or a standing one where it has none."""

from itertools import product

import mujoco
import numpy as np
from scipy.optimize import least_squares

from surefoot.sim.robot.kinematics import Legs, feet, leg_forward
from surefoot.sim.robot.legs import JOINTS, LegTree

CROUCH = 0.76  # height of the thigh joint over the foot, as a share of the straight leg, on average
# Criteria of standing, as shares of the straight leg; of the mean one, for uneven feet.
LOWEST, HIGHEST, UNEVEN, ASKEW = 0.7, 0.97, 0.1, 0.3


def home_pose(model: mujoco.MjModel, tree: LegTree) -> np.ndarray:
    """Angles (J,) [rad] of the keyframe "home", or zeros; for a quadruped that would not stand so,
    a standing pose with bent knees and feet below the hips.
    """
    key = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, "home")
    pose = model.key_qpos[key] if key >= 0 else model.qpos0
    q_home = pose[model.jnt_qposadr[tree.joint_ids]].copy()
    legs, radius = tree.constants, tree.foot_radius
    if tree.limbs.joints[:12] != JOINTS or (key >= 0 and stands(legs, radius, q_home)):
        return q_home
    q_home[:12] = standing_joints(legs, radius, joint_ranges(model, tree.joint_ids))
    return q_home


def joint_ranges(model: mujoco.MjModel, joints: np.ndarray) -> np.ndarray:
    """Range (J, 2) [rad] of each joint, a half turn to either side where the model gives none."""
    limited = model.jnt_limited[joints].astype(bool)[:, None]
    return np.where(limited, model.jnt_range[joints], [-np.pi, np.pi])


def stands(legs: Legs, radius: np.ndarray, q: np.ndarray) -> bool:
    """Whether joint angles q (12,) [rad] support the body: feet of radius (4,) [m] level, far below
    and near the hips, knees bent.

    The "home" keyframe of some published models only folds the legs, that of others is zero.
    """
    hips = np.array([_thigh_joint(legs, leg) for leg in range(4)])
    straight = np.array([_straight(legs, leg) for leg in range(4)])
    feet_B, _, _ = feet(legs, q[None], np.eye(3), np.zeros(3))
    askew, _, drops = np.transpose((hips - feet_B[0]) / straight[:, None])
    reach = (drops >= LOWEST) & (drops <= HIGHEST) & (np.abs(askew) <= ASKEW)  # not of nan
    return bool(reach.all() and np.ptp(feet_B[0, :, 2] - radius) < UNEVEN * straight.mean())


def standing_joints(legs: Legs, radius: np.ndarray, joint_range: np.ndarray) -> np.ndarray:
    """Joint angles (12,) [rad] that put every foot straight below its thigh joint, on one ground,
    also those of legs of unlike lengths and feet of unlike radius (4,) [m].

    Of the two directions in which a knee can bend, the one nearer to the middle of the joints'
    ranges is used or, if the ranges are symmetric, backwards, as on nearly every quadruped.
    """
    thighs = [_thigh_joint(legs, leg) for leg in range(4)]
    floors = [thighs[leg][2] - CROUCH * _straight(legs, leg) - radius[leg] for leg in range(4)]
    q_home = np.empty(12)
    foot, J, axes = np.empty(3), np.empty((3, 3)), np.empty((3, 3))
    for leg in range(4):
        lower, upper = joint_range[3 * leg : 3 * leg + 3].T
        lower, upper = np.maximum(lower, -np.pi), np.minimum(upper, np.pi)
        middle = 0.5 * (lower + upper)
        target = np.array([*thighs[leg][:2], np.mean(floors) + radius[leg]])

        def miss(q: np.ndarray, leg: int = leg, target: np.ndarray = target) -> np.ndarray:
            whole = np.zeros(12)
            whole[3 * leg : 3 * leg + 3] = q
            leg_forward(legs, leg, whole, foot, J, axes)
            return foot - target

        best, best_cost = middle, np.inf
        knees = 0.75 * lower[2] + 0.25 * middle[2], 0.75 * upper[2] + 0.25 * middle[2]
        for thigh_start, knee_start in product(np.linspace(lower[1], upper[1], 5), knees):
            start = np.clip([0.0, thigh_start, knee_start], lower + 1e-6, upper - 1e-6)
            found = least_squares(miss, start, bounds=(lower, upper))
            off_middle = np.abs((found.x - middle) / (upper - lower)).max()
            miss(found.x)
            knee_x = foot[0] - np.cross(J[:, 2], axes[:, 2])[0]
            cost = off_middle + 1e3 * found.cost + np.abs(found.x[0])
            cost += 0.01 * (knee_x > target[0])
            if cost < best_cost:
                best, best_cost = found.x, cost
        q_home[3 * leg : 3 * leg + 3] = best
    return q_home


def _thigh_joint(legs: Legs, leg: int) -> np.ndarray:
    """Position (3,) [m] of the thigh's hinge in B with the abduction at zero."""
    return legs.offset[leg, 0] + legs.rotation[leg, 0] @ legs.offset[leg, 1]


def _straight(legs: Legs, leg: int) -> float:
    """Length [m] of the stretched leg from the thigh's hinge to the foot's centre."""
    return float(np.linalg.norm(legs.offset[leg, 2]) + np.linalg.norm(legs.foot[leg]))
