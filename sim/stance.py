"""A standing posture for a robot whose model has no home keyframe."""

import numpy as np
from scipy.optimize import least_squares

from sim.kinematics import Legs, leg_forward

CROUCH = 0.76  # height of the thigh joint over the foot, as a share of the straight leg


def standing_joints(legs: Legs, joint_range: np.ndarray) -> np.ndarray:
    """Joint angles (12,) [rad] that put every foot straight below its thigh joint.

    Of the two ways a knee can bend, the one nearer to the middle of the joints' ranges wins.
    """
    q_home = np.empty(12)
    foot, J, axes = np.empty(3), np.empty((3, 3)), np.empty((3, 3))
    for leg in range(4):
        lower, upper = joint_range[3 * leg : 3 * leg + 3].T
        lower, upper = np.maximum(lower, -np.pi), np.minimum(upper, np.pi)
        middle = 0.5 * (lower + upper)
        straight = np.linalg.norm(legs.offset[leg, 2]) + np.linalg.norm(legs.foot[leg])
        thigh = legs.offset[leg, 0] + legs.rotation[leg, 0] @ legs.offset[leg, 1]
        target = thigh - np.array([0.0, 0.0, CROUCH * straight])

        def miss(q: np.ndarray, leg: int = leg, target: np.ndarray = target) -> np.ndarray:
            leg_forward(legs, leg, q, foot, J, axes)
            return foot - target

        best, best_cost = middle, np.inf
        for thigh_start in np.linspace(lower[1], upper[1], 5):
            for knee_start in (
                0.75 * lower[2] + 0.25 * middle[2],
                0.75 * upper[2] + 0.25 * middle[2],
            ):
                start = np.clip([0.0, thigh_start, knee_start], lower + 1e-6, upper - 1e-6)
                found = least_squares(miss, start, bounds=(lower, upper))
                off_middle = np.abs((found.x - middle) / (upper - lower)).max()
                cost = off_middle + 1e3 * found.cost + np.abs(found.x[0])
                if cost < best_cost:
                    best, best_cost = found.x, cost
        q_home[3 * leg : 3 * leg + 3] = best
    return q_home
