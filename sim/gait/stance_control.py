"""Legs in stance: the wrench on the body, and the foot forces that produce it."""

import numpy as np

from surefoot.sim.common.copies import copy_row
from surefoot.sim.common.gravity import GRAVITY
from surefoot.sim.common.kernels import kernel
from surefoot.sim.gait.state import STANCE

FRICTION_CLAMP = 0.6
"""Largest tangential over normal foot force."""
LEVEL_DAMPING = 32.0
"""Gain of the rates that hold the base level [1/s]."""
FIRM_TILT = 0.1
"""Tilt from the plane of the ground from which the base is held level with the full moment
[rad].
"""
FARTHEST_FROM_BASE = 0.3
"""Largest joint error that the PD responds to [rad], so that a stuck foot does not pull the body
down.
"""


@kernel
def load_share(gait, progress):
    """Share (0 to 1) of its load that a foot bears, ramped up and down over its stance."""
    return min(1.0, min(progress / gait.unloading, (1.0 - progress) / gait.unloading))


@kernel(inline="always")
def stance_forces(r, wrench, weight, effort):
    """Foot forces (n, 3) at lever arms r (n, 3) that best produce `wrench` (6,).

    Least squares with weights on the six rows, and a penalty `effort` (n,) on large forces.
    """
    n = r.shape[0]
    A = np.zeros((6, 3 * n))
    for i in range(n):
        for a in range(3):
            A[a, 3 * i + a] = 1.0
        A[3, 3 * i + 1], A[3, 3 * i + 2] = -r[i, 2], r[i, 1]
        A[4, 3 * i], A[4, 3 * i + 2] = r[i, 2], -r[i, 0]
        A[5, 3 * i], A[5, 3 * i + 1] = -r[i, 1], r[i, 0]
    WA = np.empty((6, 3 * n))
    for a in range(6):
        for j in range(3 * n):
            WA[a, j] = A[a, j] * weight[a]
    H = A.T @ WA
    for i in range(n):
        for a in range(3):
            H[3 * i + a, 3 * i + a] += effort[i]
    return np.linalg.solve(H, WA.T @ wrench).reshape(n, 3)


@kernel(inline="always")
def support(controller, ground, base, command, feet, torque):
    """Distribute the wrench that controls height, attitude and course over the standing feet.

    Args:
        controller: a Controller.
        ground: height at the base [m] and slopes along x and y of the plane that it follows.
        base: a BaseMotion.
        command: a Command.
        feet: FootStates.
        torque: (12,) N m, written for the legs in stance.
    """
    gait = controller.gait
    p, R, v, w = base
    standing = np.flatnonzero(feet.mode == STANCE)
    n = len(standing)
    if n == 0:
        return
    level, slope_x, slope_y = ground
    com = R @ gait.com_B
    for a in range(3):
        com[a] = p[a] + com[a]
    wrench = np.empty(6)
    for a in range(2):
        wrench[a] = gait.mass * gait.course_gain * (command.v[a] + command.sway[a] - v[a])
        wrench[a] += gait.mass * command.push[a]
    climb = slope_x * v[0] + slope_y * v[1]
    wrench[2] = gait.mass * (GRAVITY + 120.0 * (gait.height + level - p[2]) + 16.0 * (climb - v[2]))
    # Attitude error as the rotation vector to the plane, for small angles.
    steep = np.sqrt(1.0 + slope_x * slope_x + slope_y * slope_y)
    level_up = np.empty(3)
    level_up[0], level_up[1], level_up[2] = -slope_x / steep, -slope_y / steep, 1.0 / steep
    up_B = R.T @ level_up
    error_B = np.zeros(3)
    error_B[0], error_B[1] = -up_B[1], up_B[0]
    # A loosely controlled robot sways; with the full gain at larger tilt it still does not fall.
    tilt = np.sqrt(error_B @ error_B) / FIRM_TILT
    held = gait.level + (1.0 - gait.level) * min(tilt * tilt, 1.0)
    moment_B = np.empty(3)
    for a in range(3):
        moment_B[a] = (held * gait.inertia[a]) * (
            gait.level_gain * error_B[a] + LEVEL_DAMPING * (command.turn * R[2, a] - w[a])
        )
    copy_row(R @ moment_B, wrench[3:])
    size = gait.height
    weight = np.ones(6)
    weight[2], weight[3], weight[4], weight[5] = 2.0, 2.0 / size**2, 2.0 / size**2, 1.0 / size**2
    r = np.empty((n, 3))
    effort = np.empty(n)
    for i in range(n):
        leg = standing[i]
        for a in range(3):
            r[i, a] = feet.place[leg, a] - com[a] - gait.foot_radius[leg] * feet.normal[leg, a]
        effort[i] = 1e-3 / max(load_share(gait, feet.progress[leg]), 0.05) ** 2
    forces = stance_forces(r, wrench, weight, effort)
    floor, ceiling = 0.03 * gait.mass * GRAVITY, 1.5 * gait.mass * GRAVITY
    across = np.empty(3)
    for i in range(n):
        leg = standing[i]
        up = feet.normal[leg]
        push = forces[i] @ up
        for a in range(3):
            across[a] = forces[i, a] - push * up[a]
        push = min(max(push, floor), ceiling)
        side = np.sqrt(across @ across)
        if side > FRICTION_CLAMP * push:
            for a in range(3):
                across[a] *= FRICTION_CLAMP * push / side
        # On a sliding foot the ground force is saturated, so the leg must damp the motion itself.
        sole_v = feet.sole_velocity[leg]
        rise = sole_v @ up
        for a in range(3):
            slide = sole_v[a] - rise * up[a]
            across[a] = push * up[a] + across[a] + gait.slide_damping * slide
        needed = feet.jacobian[leg].T @ across
        for j in range(3):
            torque[3 * leg + j] = -needed[j]


@kernel(inline="always")
def stiffen(controller, state, command, feet, torque):
    """Add joint PD torques of standing legs to the feed-forward torques of the wrench.

    The targets are the joint angles for the commanded motion of the base since touchdown.

    Args:
        controller: a Controller, whose memory of touchdowns is changed.
        state: a RobotState.
        command: a Command.
        feet: FootStates.
        torque: (12,) N m, changed for the legs in stance.
    """
    gait, memory = controller.gait, controller.memory
    t, base, _, dq, _ = state
    v_B = base.R.T @ command.v
    turn_G = np.zeros(3)
    turn_G[2] = command.turn
    turn_B = base.R.T @ turn_G
    arm, lacking = np.empty(3), np.empty(3)
    rate_B = np.empty(3)
    for leg in range(4):
        if feet.mode[leg] != STANCE:
            memory.since[leg] = np.nan
            continue
        for a in range(3):
            arm[a] = feet.place[leg, a] - base.p[a]
        r_B = base.R.T @ arm
        planted = memory.planted[leg]
        if np.isnan(memory.since[leg]):
            copy_row(r_B, planted)
            memory.since[leg] = t
        for a in range(3):
            b, c = (a + 1) % 3, (a + 2) % 3
            rate_B[a] = -(v_B[a] + (turn_B[b] * planted[c] - turn_B[c] * planted[b]))
            lacking[a] = planted[a] + (t - memory.since[leg]) * rate_B[a] - r_B[a]
        J = base.R.T @ feet.jacobian[leg]
        # Damped least squares, so that a straight knee does not require an infinite rotation.
        H = J @ J.T
        for a in range(3):
            H[a, a] += 1e-4 * gait.leg_length**2
        error = J.T @ np.linalg.solve(H, lacking)
        error_rate = J.T @ np.linalg.solve(H, rate_B)
        for j in range(3):
            pull = gait.stiffness * min(max(error[j], -FARTHEST_FROM_BASE), FARTHEST_FROM_BASE)
            torque[3 * leg + j] += pull + gait.damping * (error_rate[j] - dq[3 * leg + j])
