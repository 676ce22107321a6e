"""Legs in swing: foothold, ground clearance, and the force that moves the foot."""

import numpy as np

from surefoot.sim.common.copies import copy_row
from surefoot.sim.common.gravity import GRAVITY
from surefoot.sim.common.kernels import kernel
from surefoot.sim.gait.state import STANCE, SWING
from surefoot.sim.ground.height_map import height, normal, surface

# Distances between a foothold and an edge, as shares of the leg's length: a falling edge, a riser
# ahead of the foot, and one behind it, towards which the shin leans when descending.
BRINK, RISER, SHIN = 0.07, 0.14, 0.17
EDGE_JUMP = 0.04  # of the leg's length: ground that jumps by more is an edge
FOOTHOLD_FIXED = 0.4  # share of the swing after which a foothold stays on its step
CLIMB_SHARE = 0.6  # share of the swing in which the foot climbs to, or falls from, another height
SWING_CLEARANCE = 0.04  # of the leg's length, between the sole and what it passes over


@kernel(inline="always")
def swing(controller, base, command, feet, torque):
    """Operational-space PD of swinging feet towards their footholds.

    Args:
        controller: a Controller, whose footholds and bumps are changed.
        base: a BaseMotion.
        command: a Command.
        feet: FootStates.
        torque: (12,) N m, written for the legs in swing.
    """
    gait, memory = controller.gait, controller.memory
    yaw = np.arctan2(base.R[1, 0], base.R[0, 0])
    heading = np.cos(yaw), np.sin(yaw)
    rate = 7.0 / ((1.0 - gait.duty) * gait.period)  # natural frequency of the tracking [rad/s]
    want, force = np.empty(2), np.empty(3)
    goal, goal_v, goal_a = np.empty(3), np.empty(3), np.empty(3)
    for leg in range(4):
        if feet.mode[leg] == STANCE:
            continue
        for a in range(3):
            goal_v[a] = goal_a[a] = 0.0
        if feet.mode[leg] == SWING:
            u = feet.progress[leg]
            _desired_foothold(gait, base, command, feet, leg, heading, want)
            place_foot(controller, leg, want, heading, u)
            set_swing_height(controller, leg)
            _swing_motion(gait, memory, leg, u, base.v, goal, goal_v, goal_a)
        else:
            # Late touchdown: keep the foothold and move down, or the foot is thrown off its step.
            copy_row(memory.foothold[leg], goal)
            goal[2] = feet.place[leg, 2] - 0.02
            goal_v[2] = -max(0.15, gait.touchdown_speed)
        for a in range(3):
            error = goal[a] - feet.place[leg, a]
            error_v = goal_v[a] - feet.velocity[leg, a]
            push = goal_a[a] + rate * rate * error + 1.4 * rate * error_v
            force[a] = gait.foot_mass * push
        force[2] += gait.foot_mass * GRAVITY
        copy_row(feet.jacobian[leg].T @ force, torque[3 * leg : 3 * leg + 3])


@kernel(inline="always")
def _desired_foothold(gait, base, command, feet, leg, heading, want):
    """Foothold half a stance ahead of the hip's motion, corrected by the error of the velocity.

    Args:
        gait: a Gait.
        base: a BaseMotion.
        command: a Command.
        feet: FootStates.
        leg: its index.
        heading: cosine and sine of the base's yaw.
        want: (2,) m in G, written.
    """
    c, s = heading
    x, y = gait.nominal_B[leg]
    arm_x, arm_y = c * x - s * y, s * x + c * y
    swing_time, stance_time = (1.0 - gait.duty) * gait.period, gait.duty * gait.period
    ahead = stance_time / 2.0 + (1.0 - feet.progress[leg]) * swing_time
    for a in range(2):
        spin = command.turn * (-arm_y if a == 0 else arm_x)
        drift, wanted = base.v[a] - command.sway[a] + spin, command.v[a] + spin
        want[a] = base.p[a] + (arm_x if a == 0 else arm_y)
        want[a] += ahead * drift + gait.capture * (drift - wanted)
    if len(gait.footholds):
        # The coming stance belongs to the next stride.
        aside = gait.footholds[min(feet.stride[leg] + 1, len(gait.footholds) - 1), leg]
        want[0] += c * aside[0] - s * aside[1]
        want[1] += s * aside[0] + c * aside[1]


@kernel(inline="always")
def _swing_motion(gait, memory, leg, u, v, goal, goal_v, goal_a):
    """Desired motion of a foot between lift-off and foothold.

    It is a minimum-jerk motion horizontally, and vertically one along a smooth bump that lands
    softly. To both are added the velocities of a foot that moves at once after lift-off, and still
    at touchdown.

    Args:
        gait: a Gait.
        memory: of the controller.
        leg: its index.
        u: completed share of the swing.
        v: (3,) m/s, velocity of the base in G.
        goal: (3,) m in G, written.
        goal_v: (3,) m/s, written.
        goal_a: (3,) m/s^2, written.
    """
    swing_time = (1.0 - gait.duty) * gait.period
    for a in range(3):
        start = memory.lift_off[leg, a]
        span = memory.foothold[leg, a] - start
        part, pace = (u, 1.0) if a < 2 else climb_progress(span, u)
        blend = part * part * part * (10.0 - 15.0 * part + 6.0 * part * part)
        slope = 30.0 * (part * (1.0 - part)) ** 2
        bend = 60.0 * part * (1.0 - part) * (1.0 - 2.0 * part)
        goal[a] = start + blend * span
        goal_v[a] = slope * span * pace / swing_time
        goal_a[a] = bend * span * (pace / swing_time) ** 2
    bump = memory.bump[leg]
    goal[2] += 64.0 * (u * (1.0 - u)) ** 3 * bump
    goal_v[2] += 192.0 * (u * (1.0 - u)) ** 2 * (1.0 - 2.0 * u) * bump / swing_time
    # u^3 (u - 1) ends at zero with slope one; its mirror image, u (1 - u)^3, begins so.
    late, late_rate = u * u * u * (u - 1.0), 4.0 * u * u * u - 3.0 * u * u
    early, early_rate = u * (1.0 - u) ** 3, (1.0 - u) ** 2 * (1.0 - 4.0 * u)
    for a in range(3):
        end_v = gait.braking * v[a] if a < 2 else -gait.touchdown_speed
        goal[a] += end_v * swing_time * late
        goal_v[a] += end_v * late_rate
        goal_a[a] += end_v * (12.0 * u - 6.0) * u / swing_time
        begin_v = gait.liftoff_advance * v[a] if a < 2 else gait.liftoff_speed
        goal[a] += begin_v * swing_time * early
        goal_v[a] += begin_v * early_rate
        goal_a[a] += begin_v * (12.0 * u - 6.0) * (1.0 - u) / swing_time


@kernel
def climb_progress(span, u):
    """Completed share of a change of height, and its rate: up before across, across before down."""
    if span > 0.0:
        return min(u / CLIMB_SHARE, 1.0), 1.0 / CLIMB_SHARE
    return max((u - 1.0 + CLIMB_SHARE) / CLIMB_SHARE, 0.0), 1.0 / CLIMB_SHARE


@kernel(inline="always")
def place_foot(controller, leg, want, heading, u):
    """Set the foothold of a leg on the ground near the desired one, away from edges.

    Args:
        controller: a Controller.
        leg: its index.
        want: (2,) m, the desired foothold.
        heading: cosine and sine of the base's yaw.
        u: completed share of the swing; late in it, the foothold stays on its step.
    """
    gait, height_map = controller.gait, controller.height_map
    foothold = controller.memory.foothold[leg]
    length = gait.leg_length
    x, y = want
    for axis in range(2):  # in a loop, since the function is compiled into each place of a call
        off = _off_edges(height_map, x, y, axis, heading[axis], length)
        if axis == 0:
            x += off
        else:
            y += off
    z = height(height_map, x, y) + gait.foot_radius[leg] / normal(height_map, x, y)[2]
    if u < FOOTHOLD_FIXED or abs(z - foothold[2]) < EDGE_JUMP * length:
        foothold[0], foothold[1], foothold[2] = x, y, z


@kernel(inline="always")
def _off_edges(height_map, x, y, axis, heading, length):
    """Displacement along `axis` (0: x, 1: y) that leaves enough distance to the edges on both sides
    [m].

    Args:
        height_map: HeightMap of the ground.
        x: of the foothold in G [m].
        y: of the foothold in G [m].
        axis: 0 for x, 1 for y.
        heading: component of the robot's heading along the axis.
        length: of the leg [m].
    """
    low, high = -1.0, 1.0
    for side in (-1.0, 1.0):
        riser = RISER if side * heading > -0.5 else SHIN
        distance, rises = _edge(height_map, x, y, axis, side, SHIN * length, EDGE_JUMP * length)
        lacking = (riser if rises else BRINK) * length - distance
        if side < 0.0:
            low = max(low, lacking)
        else:
            high = min(high, -lacking)
    if low > high:
        return 0.5 * (low + high)
    return min(max(0.0, low), high)


@kernel(inline="always")
def _edge(height_map, x, y, axis, side, reach, jump):
    """Distance [m] to the next edge from (x, y) towards `side` of `axis`, and whether it rises.

    Twice the reach if there is none within it.

    Args:
        height_map: HeightMap of the ground.
        x: of the foothold in G [m].
        y: of the foothold in G [m].
        axis: 0 for x, 1 for y.
        side: +1.0 or -1.0, direction along the axis.
        reach: of the search [m].
        jump: height that counts as an edge [m].
    """
    z, slope_x, slope_y = surface(height_map, x, y)
    slope = (slope_x if axis == 0 else slope_y) * side
    near = 0.0
    for k in range(1, 4):
        far = reach * k / 3.0
        off = _along(height_map, x, y, axis, side * far) - z - slope * far
        if abs(off) > jump:
            for _ in range(4):
                middle = 0.5 * (near + far)
                if abs(_along(height_map, x, y, axis, side * middle) - z - slope * middle) > jump:
                    far = middle
                else:
                    near = middle
            return near, off > 0.0
        near = far
    return 2.0 * reach, False


@kernel
def _along(height_map, x, y, axis, distance):
    """Height [m] of the ground at a distance from a point along an axis.

    Args:
        height_map: HeightMap of the ground.
        x: of the point in G [m].
        y: of the point in G [m].
        axis: 0 for x, 1 for y.
        distance: signed [m].
    """
    return height(height_map, x + distance, y) if axis == 0 else height(height_map, x, y + distance)


@kernel(inline="always")
def set_swing_height(controller, leg):
    """Set the height of the swing's bump so that the sole clears the ground between its ends.

    Ground that rises evenly between the ends needs only the plain swing.
    """
    gait, height_map, memory = controller.gait, controller.height_map, controller.memory
    start, end = memory.lift_off[leg], memory.foothold[leg]
    radius, room = gait.foot_radius[leg], SWING_CLEARANCE * gait.leg_length
    apex, uneven = 0.0, False
    for k in range(4, 17):
        u = 0.05 * k
        blend = u * u * u * (10.0 - 15.0 * u + 6.0 * u * u)
        x = start[0] + blend * (end[0] - start[0])
        y = start[1] + blend * (end[1] - start[1])
        sole = height(height_map, x, y) + radius
        climb = end[2] - start[2]
        uneven |= abs(sole - start[2] - blend * climb) > 0.015 * gait.leg_length
        part, _ = climb_progress(climb, u)
        lifted = part * part * part * (10.0 - 15.0 * part + 6.0 * part * part)
        lack = sole + room - start[2] - lifted * climb
        apex = max(apex, lack / (64.0 * (u * (1.0 - u)) ** 3))
    if uneven:
        memory.bump[leg] = max(memory.bump[leg], min(apex, 0.4 * gait.leg_length))
    memory.bump[leg] = max(memory.bump[leg], gait.clearance)
