"""Scaling of a course to a robot of another size.

By dynamic similarity, lengths scale with the leg, times and speeds with its square root, so that
the Froude number, slopes and friction stay the same (Alexander, "The gaits of bipedal and
quadrupedal animals", IJRR 1984).
"""

from dataclasses import replace

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.ground.height_map import LATTICE
from surefoot.sim.ground.terrain import Ground, HeightField, Patch, Strip
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario, Segment

SLIP_CARE = 0.5
"""Least `slip_care` on a course made for another robot. Short legs recover only from shorter
slides: without it, legs of 0.4 m fall on sheets that legs of 0.66 m cross.
"""


def course_for(scenario: Scenario, robot: Robot) -> Scenario:
    """The scenario scaled to this robot; unchanged if it names no other robot, or an unknown
    one.
    """
    if scenario.robot in (None, robot.name):
        return scenario
    try:
        drawn_for = Robot.load(scenario.robot)
    except SurefootError:
        return scenario
    if drawn_for.file == robot.file:
        return scenario
    gait = replace(scenario.gait, slip_care=max(scenario.gait.slip_care, SLIP_CARE))
    return replace(_scaled(scenario, robot.leg_length / drawn_for.leg_length), gait=gait)


def _scaled(scenario: Scenario, k: float) -> Scenario:
    """The scenario scaled by `k`."""
    root = k**0.5
    segments = tuple(
        Segment(s.duration * root, s.forward * root, s.lateral * root, s.turn / root)
        for s in scenario.segments
    )
    ground, ranges = scenario.ground, scenario.ranges
    return replace(
        scenario,
        segments=segments,
        ground=_scaled_ground(ground, k),
        ranges=replace(
            ranges,
            patch_shift=k * ranges.patch_shift,
            payload=(k**3 * ranges.payload[0], k**3 * ranges.payload[1]),
        ),
    )


def _scaled_ground(ground: Ground, k: float) -> Ground:
    patches = tuple(
        Patch(k * p.center_x, k * p.center_y, k * p.size_x, k * p.size_y, p.mu)
        for p in ground.patches
    )
    strips = tuple(_scaled_strip(strip, k) for strip in ground.strips)
    fields = tuple(_scaled_field(field, k) for field in ground.fields)
    half_size = k * ground.half_size
    return replace(ground, patches=patches, half_size=half_size, strips=strips, fields=fields)


def _scaled_field(field: HeightField, k: float) -> HeightField:
    """The field scaled by `k`; its edges still meet those of adjacent strips."""
    x0, x1, y0, y1 = (_on_lattice(k * edge) for edge in field.rectangle)
    return replace(field, rectangle=(x0, x1, y0, y1), heights=k * field.heights)


def _scaled_strip(strip: Strip, k: float) -> Strip:
    """The strip scaled by `k`; its edges stay on the lattice of rough ground, and so do its
    neighbours'.
    """
    x0, x1, y0, y1 = (_on_lattice(k * edge) for edge in strip.rectangle)
    x, y = 0.5 * (x0 + x1), 0.5 * (y0 + y1)
    low, high, width = (
        ((x0, y), (x1, y), y1 - y0) if strip.axis == 0 else ((x, y0), (x, y1), x1 - x0)
    )
    start, end = (low, high) if strip.start < strip.end else (high, low)
    return replace(
        strip,
        start=start,
        end=end,
        width=width,
        heights=(k * strip.heights[0], k * strip.heights[1]),
        rough=k * strip.rough,
        grain=max(k * strip.grain, 2 * LATTICE),
    )


def _on_lattice(edge: float) -> float:
    return round(edge / LATTICE) * LATTICE
