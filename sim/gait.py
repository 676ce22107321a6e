"""A trot controller, compiled: Raibert footholds, a stance wrench, Jacobian-transpose torques.

It knows the true base pose and the ground, as a laboratory's controller may. Every number
scales with the leg length and the mass read from the model, so one set walks any quadruped.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from sim.kinematics import leg_forward
from sim.robot import Robot

GRAVITY = 9.81
SWING, STANCE, REACHING = 0, 1, 2


class Gait(NamedTuple):
    """Gait timing and gains of one robot, SI units."""

    period: float  # s
    duty: float  # share of the period in stance
    clearance: float  # m, of the swing foot
    height: float  # m, base origin over the ground
    mass: float  # kg
    inertia: np.ndarray  # (3,) kg m^2, of the whole robot about its base axes
    com_B: np.ndarray  # (3,) m
    nominal_B: np.ndarray  # (4, 2) m, foothold below each hip, in B
    foot_radius: np.ndarray  # (4,) m
    torque_limit: np.ndarray  # (12,) N m
    foot_mass: float  # kg, of a leg as felt at its foot
    start: float  # s, first step
    phase: np.ndarray  # (4,) share of the period by which each leg's stance begins later
    friction_clamp: float  # horizontal over vertical foot force
    capture: float  # s, foothold per velocity error
    course_gain: float  # 1/s, force per velocity error and mass
    level_gain: float  # 1/s^2, moment per tilt and inertia
    level_damping: float  # 1/s
    slide_damping: float  # N s/m, on a stance foot that slides


def gait_for(robot: Robot, start: float, period: float = 1.0, clearance: float = 1.0) -> Gait:
    """The trot of `robot`, its first step at `start` [s]; the last two are factors."""
    length = robot.leg_length
    home_B = robot.feet_I(robot.q_home[None])[0] @ robot.R_BI.T + robot.p_BI
    mass, com_B, inertia, foot_mass = robot.inertial
    return Gait(
        period=period * 0.5 * np.sqrt(length / 0.66),
        duty=0.6,
        clearance=clearance * 0.11 * length,
        height=float(robot.foot_radius.mean() - home_B[:, 2].mean()),
        mass=mass,
        inertia=inertia,
        com_B=com_B,
        nominal_B=np.ascontiguousarray(home_B[:, :2]),
        foot_radius=robot.foot_radius,
        torque_limit=robot.torque_limit,
        foot_mass=foot_mass,
        start=start,
        phase=np.array([0.0, 0.5, 0.5, 0.0]),
        friction_clamp=0.6,
        capture=0.75 * np.sqrt(length / GRAVITY),
        course_gain=4.0,
        level_gain=180.0,
        level_damping=32.0,
        slide_damping=80.0 * foot_mass,
    )


@njit(cache=True)
def stance_forces(r, wrench, weight, effort):
    """Foot forces (n, 3) that best make `wrench` (6,) at lever arms r (n, 3).

    Least squares with weights on the six rows and `effort` (n,) against large forces.
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


@njit(cache=True)
def tick(legs, gait, memory, t, p, R, v, w, q, dq, load, target, torque):
    """One control tick; writes joint torques [N m] into `torque` (12,).

    p, R, v: base position, attitude, velocity in G; w: angular velocity in B; q, dq (12,);
    load (4,) normal foot forces [N]; target (6,): x, y, yaw and their velocities (forward,
    lateral, yaw rate). memory (4, 8) keeps per leg: lift-off foot x, y, z; last mode; foothold x, y, z;
    touched since the stance began.
    """
    yaw = np.arctan2(R[1, 0], R[0, 0])
    c, s = np.cos(target[2]), np.sin(target[2])
    v_want = np.array([c * target[3] - s * target[4], s * target[3] + c * target[4], 0.0])
    for a in range(2):
        v_want[a] += min(max(1.0 * (target[a] - p[a]), -0.3), 0.3)
    yaw_error = np.arctan2(np.sin(target[2] - yaw), np.cos(target[2] - yaw))
    turn = target[5] + min(max(2.0 * yaw_error, -0.5), 0.5)

    feet = np.empty((4, 3))
    feet_v = np.empty((4, 3))
    sole_v = np.empty((4, 3))
    jacobians = np.empty((4, 3, 3))
    mode = np.empty(4, np.int64)
    progress = np.zeros(4)
    foot, J, axes = np.empty(3), np.empty((3, 3)), np.empty((3, 3))
    loaded = 0.04 * gait.mass * GRAVITY
    for leg in range(4):
        leg_forward(legs, leg, q[3 * leg : 3 * leg + 3], foot, J, axes)
        feet[leg] = p + R @ foot
        jacobians[leg] = R @ J
        feet_v[leg] = v + R @ np.cross(w, foot) + jacobians[leg] @ dq[3 * leg : 3 * leg + 3]
        w_foot = R @ (w + axes @ dq[3 * leg : 3 * leg + 3])
        sole_v[leg] = feet_v[leg] + np.cross(w_foot, np.array([0.0, 0.0, -gait.foot_radius[leg]]))
        phase = 0.0
        if t >= gait.start:
            phase = ((t - gait.start) / gait.period + gait.phase[leg]) % 1.0
        if phase < gait.duty or t < gait.start:
            progress[leg] = phase / gait.duty if t >= gait.start else 0.5
            if memory[leg, 3] == SWING:
                memory[leg, 7] = 0.0
            if load[leg] > loaded:
                memory[leg, 7] = 1.0
            mode[leg] = STANCE if memory[leg, 7] > 0.0 or t < gait.start else REACHING
        else:
            progress[leg] = (phase - gait.duty) / (1.0 - gait.duty)
            mode[leg] = SWING
            if progress[leg] > 0.6 and load[leg] > loaded:
                mode[leg] = STANCE  # early touchdown: the ground is already carrying
                progress[leg] = 0.0
            elif memory[leg, 3] != SWING:
                memory[leg, 0:3] = feet[leg]
        memory[leg, 3] = SWING if mode[leg] == SWING else STANCE

    _swing(
        gait, memory, p, R, v, yaw, v_want, turn, feet, feet_v, jacobians, mode, progress, torque
    )
    _stance(gait, p, R, v, w, v_want, turn, feet, sole_v, jacobians, mode, progress, torque)
    for i in range(12):
        torque[i] = min(max(torque[i], -gait.torque_limit[i]), gait.torque_limit[i])


@njit(cache=True)
def _swing(gait, memory, p, R, v, yaw, v_want, turn, feet, feet_v, J, mode, progress, torque):
    """Operational-space PD of feet in the air towards their footholds."""
    c, s = np.cos(yaw), np.sin(yaw)
    swing_time = (1.0 - gait.duty) * gait.period
    stance_time = gait.duty * gait.period
    rate = 7.0 / swing_time  # natural frequency of the foot's tracking [rad/s]
    for leg in range(4):
        if mode[leg] == STANCE:
            continue
        x, y = gait.nominal_B[leg]
        hip = np.array([p[0] + c * x - s * y, p[1] + s * x + c * y])
        arm = np.array([-(hip[1] - p[1]), hip[0] - p[0]])
        ahead = stance_time / 2.0 + (1.0 - progress[leg]) * swing_time * (mode[leg] == SWING)
        if mode[leg] == SWING:
            for a in range(2):
                drift = v[a] + turn * arm[a]
                want = v_want[a] + turn * arm[a]
                memory[leg, 4 + a] = hip[a] + ahead * drift + gait.capture * (drift - want)
            memory[leg, 6] = gait.foot_radius[leg]
        u = progress[leg]
        goal, goal_v, goal_a = np.empty(3), np.zeros(3), np.zeros(3)
        if mode[leg] == SWING:
            # Minimum-jerk across; up and down again along a smooth bump that lands with little speed.
            blend = u * u * u * (10.0 - 15.0 * u + 6.0 * u * u)
            slope = 30.0 * u * u * (1.0 - u) * (1.0 - u) / swing_time
            bend = 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u) / swing_time**2
            for a in range(3):
                span = memory[leg, 4 + a] - memory[leg, a]
                goal[a] = memory[leg, a] + blend * span
                goal_v[a] = slope * span
                goal_a[a] = bend * span
            bump = 64.0 * (u * (1.0 - u)) ** 3 * gait.clearance
            dbump = 192.0 * (u * (1.0 - u)) ** 2 * (1.0 - 2.0 * u) * gait.clearance / swing_time
            goal[2] += bump
            goal_v[2] += dbump
        else:
            # Late touchdown: hold the foothold and go on down, or the foot is thrown off its step.
            goal[0], goal[1] = memory[leg, 4], memory[leg, 5]
            goal[2] = feet[leg, 2] - 0.02
            goal_v[2] = -0.15
        force = gait.foot_mass * (
            goal_a + rate * rate * (goal - feet[leg]) + 1.4 * rate * (goal_v - feet_v[leg])
        )
        force[2] += gait.foot_mass * GRAVITY
        torque[3 * leg : 3 * leg + 3] = J[leg].T @ force


@njit(cache=True)
def _stance(gait, p, R, v, w, v_want, turn, feet, sole_v, J, mode, progress, torque):
    """The wrench that holds height, level and course, shared over the feet that stand."""
    standing = np.flatnonzero(mode == STANCE)
    n = len(standing)
    if n == 0:
        return
    ground = 0.0
    for i in range(n):
        ground += (feet[standing[i], 2] - gait.foot_radius[standing[i]]) / n
    com = p + R @ gait.com_B
    wrench = np.empty(6)
    for a in range(2):
        wrench[a] = gait.mass * gait.course_gain * (v_want[a] - v[a])
    wrench[2] = gait.mass * (GRAVITY + 120.0 * (gait.height + ground - p[2]) - 16.0 * v[2])
    # Attitude error as the rotation vector that would level the base, small-angle.
    tilt = np.array([-R[2, 1], R[2, 0], 0.0])
    error_B = np.array([tilt[0], tilt[1], 0.0])
    spin = np.array([-w[0], -w[1], turn - w[2]])
    moment_B = np.empty(3)
    for a in range(3):
        moment_B[a] = gait.inertia[a] * (
            gait.level_gain * error_B[a] + gait.level_damping * spin[a]
        )
    wrench[3:] = R @ moment_B
    size = gait.height
    weight = np.array([1.0, 1.0, 2.0, 2.0 / size**2, 2.0 / size**2, 1.0 / size**2])
    r = np.empty((n, 3))
    effort = np.empty(n)
    for i in range(n):
        leg = standing[i]
        r[i] = feet[leg] - com
        r[i, 2] -= gait.foot_radius[leg]
        u = progress[leg]
        ease = min(1.0, min(u / 0.15, (1.0 - u) / 0.15))
        effort[i] = 1e-3 / max(ease, 0.05) ** 2
    forces = stance_forces(r, wrench, weight, effort)
    floor, ceiling = 0.03 * gait.mass * GRAVITY, 1.5 * gait.mass * GRAVITY
    for i in range(n):
        leg = standing[i]
        f = forces[i]
        f[2] = min(max(f[2], floor), ceiling)
        side = np.sqrt(f[0] ** 2 + f[1] ** 2)
        if side > gait.friction_clamp * f[2]:
            f[0] *= gait.friction_clamp * f[2] / side
            f[1] *= gait.friction_clamp * f[2] / side
        # On a foot that slides the ground has no more to give: the leg itself must stop it.
        f[0] += gait.slide_damping * sole_v[leg, 0]
        f[1] += gait.slide_damping * sole_v[leg, 1]
        torque[3 * leg : 3 * leg + 3] = -(J[leg].T @ f)
