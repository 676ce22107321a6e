"""Legs in stance: the wrench that carries the body, and the foot forces that produce it."""

import numpy as np

from surefoot.sim.common.gravity import GRAVITY
from surefoot.sim.common.kernels import kernel
from surefoot.sim.gait.state import STANCE

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
    WA = A * weight.reshape(6, 1)
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
        feet: Feet.
        torque: (12,) N m, written for the legs in stance.
    """
    gait = controller.gait
    p, R, v, w = base
    standing = np.flatnonzero(feet.mode == STANCE)
    n = len(standing)
    if n == 0:
        return
    level, slope_x, slope_y = ground
    com = p + R @ gait.com_B
    wrench = np.empty(6)
    for a in range(2):
        wrench[a] = gait.mass * gait.course_gain * (command.v[a] + command.sway[a] - v[a])
        wrench[a] += gait.mass * command.push[a]
    climb = slope_x * v[0] + slope_y * v[1]
    wrench[2] = gait.mass * (GRAVITY + 120.0 * (gait.height + level - p[2]) + 16.0 * (climb - v[2]))
    # Attitude error as the rotation vector to the plane, for small angles.
    steep = np.sqrt(1.0 + slope_x * slope_x + slope_y * slope_y)
    up_B = R.T @ np.array([-slope_x / steep, -slope_y / steep, 1.0 / steep])
    error_B = np.array([-up_B[1], up_B[0], 0.0])
    spin = command.turn * R[2] - w
    # A loosely controlled robot sways; with the full gain at larger tilt it still does not fall.
    tilt = np.sqrt(error_B @ error_B) / FIRM_TILT
    held = gait.level + (1.0 - gait.level) * min(tilt * tilt, 1.0)
    moment_B = np.empty(3)
    for a in range(3):
        moment_B[a] = (held * gait.inertia[a]) * (
            gait.level_gain * error_B[a] + gait.level_damping * spin[a]
        )
    wrench[3:] = R @ moment_B
    size = gait.height
    weight = np.array([1.0, 1.0, 2.0, 2.0 / size**2, 2.0 / size**2, 1.0 / size**2])
    r = np.empty((n, 3))
    effort = np.empty(n)
    for i in range(n):
        leg = standing[i]
        r[i] = feet.place[leg] - com - gait.foot_radius[leg] * feet.normal[leg]
        effort[i] = 1e-3 / max(load_share(gait, feet.progress[leg]), 0.05) ** 2
    forces = stance_forces(r, wrench, weight, effort)
    floor, ceiling = 0.03 * gait.mass * GRAVITY, 1.5 * gait.mass * GRAVITY
    for i in range(n):
        leg = standing[i]
        up = feet.normal[leg]
        push = forces[i] @ up
        across = forces[i] - push * up
        push = min(max(push, floor), ceiling)
        side = np.sqrt(across @ across)
        if side > gait.friction_clamp * push:
            across *= gait.friction_clamp * push / side
        # On a sliding foot the ground force is saturated, so the leg must damp the motion itself.
        sole_v = feet.sole_velocity[leg]
        slide = sole_v - (sole_v @ up) * up
        torque[3 * leg : 3 * leg + 3] = -(
            feet.jacobian[leg].T @ (push * up + across + gait.slide_damping * slide)
        )


@kernel(inline="always")
def stiffen(controller, state, command, feet, torque):
    """Add joint PD torques of standing legs to the feed-forward torques of the wrench.

    The targets are the joint angles for the commanded motion of the base since touchdown.

    Args:
        controller: a Controller, whose memory of touchdowns is changed.
        state: a RobotState.
        command: a Command.
        feet: Feet.
        torque: (12,) N m, changed for the legs in stance.
    """
    gait, memory = controller.gait, controller.memory
    t, base, _, dq, _ = state
    v_B = base.R.T @ command.v
    turn_B = base.R.T @ np.array([0.0, 0.0, command.turn])
    for leg in range(4):
        if feet.mode[leg] != STANCE:
            memory.since[leg] = np.nan
            continue
        own = slice(3 * leg, 3 * leg + 3)
        r_B = base.R.T @ (feet.place[leg] - base.p)
        if np.isnan(memory.since[leg]):
            memory.planted[leg] = r_B
            memory.since[leg] = t
        rate_B = -(v_B + np.cross(turn_B, memory.planted[leg]))
        wanted_B = memory.planted[leg] + (t - memory.since[leg]) * rate_B
        J = base.R.T @ feet.jacobian[leg]
        # Damped least squares, so that a straight knee does not require an infinite rotation.
        H = J @ J.T + 1e-4 * gait.leg_length**2 * np.eye(3)
        error = J.T @ np.linalg.solve(H, wanted_B - r_B)
        error_rate = J.T @ np.linalg.solve(H, rate_B) - dq[own]
        for j in range(3):
            pull = gait.stiffness * min(max(error[j], -FARTHEST_FROM_BASE), FARTHEST_FROM_BASE)
            torque[3 * leg + j] += pull + gait.damping * error_rate[j]
