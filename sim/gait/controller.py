"""A trot controller, compiled: Raibert footholds, a stance wrench, Jacobian-transpose torques.

It knows the true base pose and the ground, as a laboratory's controller may. Every number
scales with the leg length and the mass read from the model, so one set walks any quadruped.
"""

from typing import NamedTuple

import numpy as np

from surefoot.sim.common.gravity import GRAVITY
from surefoot.sim.common.kernels import kernel
from surefoot.sim.gait.stance_control import support
from surefoot.sim.gait.swing import swing
from surefoot.sim.ground.height_map import height, normal, surface
from surefoot.sim.robot import Robot
from surefoot.sim.robot.kinematics import foot_motion, leg_forward, sole_motion

SWING, STANCE, REACHING = 0, 1, 2
STEEPEST = 0.6  # slope that the body follows at most


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
    leg_length: float  # m
    start: float  # s, first step
    phase: np.ndarray  # (4,) share of the period by which each leg's stance begins later
    friction_clamp: float  # tangential over normal foot force
    capture: float  # s, foothold per velocity error
    course_gain: float  # 1/s, force per velocity error and mass
    level_gain: float  # 1/s^2, moment per tilt and inertia
    level_damping: float  # 1/s
    slide_damping: float  # N s/m, on a stance foot that slides


def gait_for(
    robot: Robot, start: float, period: float = 1.0, clearance: float = 1.0, gain: float = 1.0
) -> Gait:
    """The trot of `robot`, its first step at `start` [s]; the last three are factors."""
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
        leg_length=length,
        start=start,
        phase=np.array([0.0, 0.5, 0.5, 0.0]),
        friction_clamp=0.6,
        capture=0.75 * np.sqrt(length / GRAVITY),
        course_gain=gain * 4.0,
        level_gain=gain * 180.0,
        level_damping=32.0,
        slide_damping=80.0 * foot_mass,
    )


def fresh_memory() -> np.ndarray:
    """What `tick` remembers of each leg (4, 9), of a robot that stands.

    Lift-off foot x, y, z; last mode; foothold x, y, z; touched since the stance began; height of
    the swing's bump.
    """
    memory = np.zeros((4, 9))
    memory[:, 3] = STANCE
    return memory


@kernel
def tick(legs, gait, relief, memory, t, p, R, v, w, q, dq, load, target, torque):
    """One control tick; writes joint torques [N m] into `torque` (12,).

    p, R, v: base position, attitude, velocity in G; w: angular velocity in B; q, dq (12,);
    load (4,) normal foot forces [N]; target (6,): x, y, yaw and their velocities (forward,
    lateral, yaw rate); relief: the ground; memory: of `fresh_memory`.
    """
    yaw = np.arctan2(R[1, 0], R[0, 0])
    c, s = np.cos(target[2]), np.sin(target[2])
    v_want = np.array([c * target[3] - s * target[4], s * target[3] + c * target[4], 0.0])
    for a in range(2):
        v_want[a] += min(max(1.0 * (target[a] - p[a]), -0.3), 0.3)
    yaw_error = np.arctan2(np.sin(target[2] - yaw), np.cos(target[2] - yaw))
    turn = target[5] + min(max(2.0 * yaw_error, -0.5), 0.5)
    ground = ground_below(gait, relief, p, yaw)

    feet = np.empty((4, 3))
    feet_v = np.empty((4, 3))
    sole_v = np.empty((4, 3))
    normals = np.empty((4, 3))
    jacobians = np.empty((4, 3, 3))
    mode = np.empty(4, np.int64)
    progress = np.zeros(4)
    foot, J, axes, spin = np.empty(3), np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    loaded = 0.04 * gait.mass * GRAVITY
    for leg in range(4):
        leg_forward(legs, leg, q[3 * leg : 3 * leg + 3], foot, J, axes)
        radius = gait.foot_radius[leg]
        foot_motion(
            p, R, v, w, dq[3 * leg : 3 * leg + 3], foot, J, axes,
            feet[leg], feet_v[leg], jacobians[leg], spin,
        )  # fmt: skip
        normals[leg, 0], normals[leg, 1], normals[leg, 2] = normal(
            relief, feet[leg, 0], feet[leg, 1]
        )
        sole_motion(feet_v[leg], spin, radius, normals[leg], sole_v[leg])
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
            above = feet[leg, 2] - radius - height(relief, feet[leg, 0], feet[leg, 1])
            low = above < 0.5 * radius + 0.04 * gait.leg_length
            if progress[leg] > 0.6 and load[leg] > loaded and low:
                mode[leg] = STANCE  # early touchdown: the ground is already carrying
                progress[leg] = 0.0
            elif memory[leg, 3] != SWING:
                memory[leg, 0:3] = feet[leg]
                memory[leg, 8] = 0.0
        memory[leg, 3] = SWING if mode[leg] == SWING else STANCE

    swing(
        gait, relief, memory, p, v, yaw, v_want, turn,
        feet, feet_v, jacobians, mode, progress, torque,
    )  # fmt: skip
    support(
        gait, ground, p, R, v, w, v_want, turn,
        feet, sole_v, normals, jacobians, mode, progress, torque,
    )  # fmt: skip
    for i in range(12):
        torque[i] = min(max(torque[i], -gait.torque_limit[i]), gait.torque_limit[i])


@kernel
def ground_below(gait, relief, p, yaw):
    """Height [m] and slopes along x and y of the plane that fits the ground under the body best.

    A grid over the stance and a little beyond: stairs look like the slope that they are.
    """
    c, s = np.cos(yaw), np.sin(yaw)
    reach = 0.5 * (gait.nominal_B[0, 0] - gait.nominal_B[2, 0]) + 0.15 * gait.leg_length
    aside = 0.5 * (gait.nominal_B[0, 1] - gait.nominal_B[1, 1])
    level = forward = lateral = squares_x = squares_y = 0.0
    for i in range(-4, 5):
        for j in range(-1, 2):
            x, y = reach * i / 4.0, aside * j
            z, _, _ = surface(relief, p[0] + c * x - s * y, p[1] + s * x + c * y)
            level += z / 27.0
            forward += x * z
            lateral += y * z
            squares_x += x * x
            squares_y += y * y
    forward = min(max(forward / squares_x, -STEEPEST), STEEPEST)
    lateral = min(max(lateral / squares_y, -STEEPEST), STEEPEST)
    return level, c * forward - s * lateral, s * forward + c * lateral
