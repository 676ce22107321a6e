"""A compiled trot controller: Raibert footholds, a stance wrench, Jacobian-transpose torques.

It knows the ground and the base's motion, true or with the errors of an estimate, as a controller
in a laboratory may. All parameters scale with the leg length and mass of the model, so one set
walks any quadruped.
"""

from typing import NamedTuple

import numpy as np

from surefoot.sim.common.copies import copy_row
from surefoot.sim.common.gravity import GRAVITY
from surefoot.sim.common.kernels import kernel
from surefoot.sim.gait.irregular import stride_at
from surefoot.sim.gait.options import PLAIN_GAIT, GaitOptions, pattern_named
from surefoot.sim.gait.stance_control import load_share, stiffen, support
from surefoot.sim.gait.state import REACHING, STANCE, SWING, Command, FootStates, Gait, LegMemory
from surefoot.sim.gait.swing import swing
from surefoot.sim.ground.height_map import HeightMap, height, normal, surface
from surefoot.sim.robot import Robot
from surefoot.sim.robot.kinematics import FootMotion, foot_motion, leg_forward, sole_motion

STEEPEST = 0.6  # slope that the body follows at most
SLIDING_SPEED = 0.2  # m/s over the ground from which the way of a loaded foot counts
SLIDING_DISTANCE = 0.02  # of the leg's length: mean way of all feet from which they slide


class Controller(NamedTuple):
    """A trot controller: the robot's gait, the ground, and its memory."""

    gait: Gait
    height_map: HeightMap
    memory: LegMemory


def gait_for(
    robot: Robot,
    start: float,
    period: float = 1.0,
    clearance: float = 1.0,
    gain: float = 1.0,
    options: GaitOptions = PLAIN_GAIT,
) -> Gait:
    """The gait of a robot.

    Args:
        robot: whose size and masses scale the gait.
        start: time of the first step [s].
        period: factor of the stride's period.
        clearance: factor of the swing height.
        gain: factor of the controller's gains.
        options: of the gait.
    """
    length, pattern = robot.leg_length, pattern_named(options.pattern)
    home_B = robot.home_feet_B
    mass, com_B, inertia, foot_mass = robot.inertial
    return Gait(
        period=pattern.period * period * 0.5 * np.sqrt(length / 0.66),
        duty=max(options.duty, pattern.duty),
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
        phase=-np.array(pattern.phase) % 1.0,
        capture=0.75 * np.sqrt(length / GRAVITY),
        course_gain=gain * 4.0,
        level=options.level,
        level_gain=gain * 180.0,
        sway=getattr(pattern, "sway", 0.0),
        slide_damping=80.0 * foot_mass,
        unloading=options.unloading,
        touchdown_speed=options.touchdown_speed * np.sqrt(GRAVITY * length),
        liftoff_speed=options.liftoff_speed * np.sqrt(GRAVITY * length),
        liftoff_advance=options.liftoff_advance,
        braking=options.braking,
        stiffness=options.stiffness * mass * GRAVITY * length,
        damping=options.stiffness * options.damping * mass * GRAVITY * length,
        slip_care=options.slip_care,
    )


@kernel
def tick(legs, controller, state, target, torque):
    """One control tick.

    Args:
        legs: the robot's Legs.
        controller: a Controller, whose memory is changed.
        state: a RobotState.
        target: (6,) x, y [m], yaw [rad] and their velocities: forward, lateral, yaw rate.
        torque: (12,) N m, written.
    """
    gait, height_map, memory = controller
    t, base, q, dq, load = state
    yaw = np.arctan2(base.R[1, 0], base.R[0, 0])
    command = _command(base, yaw, target)
    ground = ground_below(gait, height_map, base.p, yaw)
    feet = FootStates(
        np.empty((4, 3)),
        np.empty((4, 3)),
        np.empty((4, 3)),
        np.empty((4, 3, 3)),
        np.empty((4, 3)),
        np.empty(4, np.int64),
        np.zeros(4),
        np.zeros(4, np.int64),
    )
    foot, J, axes, spin = np.empty(3), np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    loaded = 0.04 * gait.mass * GRAVITY
    for leg in range(4):
        own = slice(3 * leg, 3 * leg + 3)
        leg_forward(legs, leg, q, foot, J, axes)
        place = feet.place[leg]
        motion = FootMotion(place, feet.velocity[leg], feet.jacobian[leg], spin)
        foot_motion(base, dq[own], foot, J, axes, motion)
        up = feet.normal[leg]
        up[0], up[1], up[2] = normal(height_map, place[0], place[1])
        radius = gait.foot_radius[leg]
        sole_motion(feet.velocity[leg], spin, radius, up, feet.sole_velocity[leg])
        phase = 0.0
        if t >= gait.start:
            feet.stride[leg], phase = stride_at(gait, t, leg)
        if phase < gait.duty or t < gait.start:
            feet.progress[leg] = phase / gait.duty if t >= gait.start else 0.5
            if memory.mode[leg] == SWING:
                memory.touched[leg] = False
            if load[leg] > loaded:
                memory.touched[leg] = True
            feet.mode[leg] = STANCE if memory.touched[leg] or t < gait.start else REACHING
        else:
            feet.progress[leg] = (phase - gait.duty) / (1.0 - gait.duty)
            feet.mode[leg] = SWING
            above = place[2] - radius - height(height_map, place[0], place[1])
            low = above < 0.5 * radius + 0.04 * gait.leg_length
            if feet.progress[leg] > 0.6 and load[leg] > loaded and low:
                feet.mode[leg] = STANCE  # early touchdown: the ground is already carrying
                feet.progress[leg] = 0.0
            elif memory.mode[leg] != SWING:
                copy_row(place, memory.lift_off[leg])
                memory.bump[leg] = 0.0
        memory.mode[leg] = SWING if feet.mode[leg] == SWING else STANCE
    if gait.slip_care > 0.0:
        slow_down_when_sliding(controller, state, loaded, command, feet)
    if gait.sway > 0.0 and t >= gait.start:
        sway_body(controller, state, (np.cos(yaw), np.sin(yaw)), command, feet)
    swing(controller, base, command, feet, torque)
    support(controller, ground, base, command, feet, torque)
    if gait.stiffness > 0.0:
        stiffen(controller, state, command, feet, torque)
    for i in range(12):
        torque[i] = min(max(torque[i], -gait.torque_limit[i]), gait.torque_limit[i])


@kernel(inline="always")
def _command(base, yaw, target):
    """The target's velocities, corrected to return the base to its place and heading."""
    c, s = np.cos(target[2]), np.sin(target[2])
    v = np.zeros(3)
    v[0], v[1] = c * target[3] - s * target[4], s * target[3] + c * target[4]
    for a in range(2):
        v[a] += min(max(1.0 * (target[a] - base.p[a]), -0.3), 0.3)
    yaw_error = np.arctan2(np.sin(target[2] - yaw), np.cos(target[2] - yaw))
    turn = target[5] + min(max(2.0 * yaw_error, -0.5), 0.5)
    return Command(v, turn, np.zeros(2), np.zeros(2))


@kernel(inline="always")
def slow_down_when_sliding(controller, state, loaded, command, feet):
    """While loaded feet slide, reduce the commanded velocity by the base's shortfall from it.

    The shortfall is averaged over a stride, so the response to swaying is unchanged. The command is
    reduced to zero at most: a sliding robot slows down and stops but does not turn back. The
    command recovers within a stride or two once no foot slides.

    Args:
        controller: a Controller, which stores the reduction.
        state: a RobotState.
        loaded: force from which a foot is loaded [N]; a bouncing foot does not slide.
        command: a Command, changed.
        feet: FootStates.
    """
    gait, memory = controller.gait, controller.memory
    t, base, _, _, load = state
    dt = t - memory.slid[1]
    memory.slid[1] = t
    across = np.empty(3)
    for leg in range(4):
        v, up = feet.sole_velocity[leg], feet.normal[leg]
        rise = v @ up
        for a in range(3):
            across[a] = v[a] - rise * up[a]
        speed = np.sqrt(across @ across)
        if feet.mode[leg] == STANCE and feet.progress[leg] < 0.75:
            # In the first quarter of the stance the leg is still being loaded, and yields.
            if feet.progress[leg] < 0.25:
                memory.way[leg] = 0.0
            elif speed > SLIDING_SPEED and load[leg] > loaded:
                memory.way[leg] = min(
                    memory.way[leg] + speed * dt, 3.0 * SLIDING_DISTANCE * gait.leg_length
                )
    # A single foot that slips off an edge does not mean slippery ground.
    if memory.way.mean() > SLIDING_DISTANCE * gait.leg_length:
        memory.slid[0] = t
    part = min(dt / gait.period, 1.0)
    slides = t - memory.slid[0] < gait.period
    for a in range(2):
        lack = gait.slip_care * (command.v[a] - base.v[a]) if slides else 0.0
        lack = min(max(lack, min(command.v[a], 0.0)), max(command.v[a], 0.0))
        memory.given_up[a] += part * (lack - memory.given_up[a])
        command.v[a] -= memory.given_up[a]


@kernel(inline="always")
def sway_body(controller, state, heading, command, feet):
    """Let the body sway, so that each standing foot bears load.

    This moves the centre of pressure towards the middle of the standing feet. A body at height h
    whose centre of pressure is offset by d accelerates by g d / h, like an inverted pendulum. The
    feet's nominal positions are used, since the actual ones would feed the sway back into itself.
    The mean of the velocity decays within a stride.

    Args:
        controller: a Controller, which stores the velocity.
        state: a RobotState.
        heading: cosine and sine of the yaw.
        command: a Command, changed.
        feet: FootStates.
    """
    gait, memory = controller.gait, controller.memory
    total, x, y = 1e-3, 0.0, 0.0
    middle_x, middle_y = gait.nominal_B[:, 0].mean(), gait.nominal_B[:, 1].mean()
    for leg in range(4):
        if feet.mode[leg] != SWING:
            part = load_share(gait, feet.progress[leg])
            total += part
            x += part * (gait.nominal_B[leg, 0] - middle_x)
            y += part * (gait.nominal_B[leg, 1] - middle_y)
    rate = -gait.sway * GRAVITY / gait.height / total
    c, s = heading
    command.push[0] = rate * (c * x - s * y)
    command.push[1] = rate * (s * x + c * y)
    dt = min(state.t - memory.sway[2], gait.period)
    memory.sway[2] = state.t
    for a in range(2):
        memory.sway[a] += dt * (command.push[a] - memory.sway[a] / gait.period)
        command.sway[a] = memory.sway[a]


@kernel(inline="always")
def ground_below(gait, height_map, p, yaw):
    """Height [m] and slopes along x and y of the plane that fits the ground under the body best.

    On a grid over the stance and a little beyond, on which stairs look like their mean slope.
    """
    c, s = np.cos(yaw), np.sin(yaw)
    reach = 0.5 * (gait.nominal_B[0, 0] - gait.nominal_B[2, 0]) + 0.15 * gait.leg_length
    aside = 0.5 * (gait.nominal_B[0, 1] - gait.nominal_B[1, 1])
    level = forward = lateral = squares_x = squares_y = 0.0
    for i in range(-4, 5):
        for j in range(-1, 2):
            x, y = reach * i / 4.0, aside * j
            z, _, _ = surface(height_map, p[0] + c * x - s * y, p[1] + s * x + c * y)
            level += z / 27.0
            forward += x * z
            lateral += y * z
            squares_x += x * x
            squares_y += y * y
    forward = min(max(forward / squares_x, -STEEPEST), STEEPEST)
    lateral = min(max(lateral / squares_y, -STEEPEST), STEEPEST)
    return level, c * forward - s * lateral, s * forward + c * lateral
