"""Courses: ramps, integrals, laps, and courses carried to a robot of another size."""

from dataclasses import replace

import numpy as np
import pytest
from ground_course import whole_course

from studies.measured import measured_folder
from surefoot.sim.gait.course import ACCELERATION, TURN_ACCELERATION
from surefoot.sim.ground.terrain import Ground, Patch, Strip
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.similar_course import course_for
from surefoot.sim.walk import walk

DT = 0.004


def test_velocity_obeys_the_ramps_and_ends_at_rest():
    course = whole_course((Segment(3, 1.0), Segment(2, 0.2, 0.1, -1.0), Segment(1, -0.3)), DT, 1.0)
    rates = np.diff(course.velocity, axis=0) / DT
    assert np.abs(rates[:, :2]).max() <= ACCELERATION + 1e-9
    assert np.abs(rates[:, 2]).max() <= TURN_ACCELERATION + 1e-9
    assert not course.velocity[:200].any()
    np.testing.assert_allclose(course.velocity[-1], 0.0, atol=1e-12)


def test_pose_is_the_integral_of_the_velocity():
    course = whole_course((Segment(3, 0.8, 0.1, 0.4), Segment(2, 0.4, 0.0, -0.9)), DT, 0.5)
    yaw = course.pose[:, 2]
    c, s = np.cos(yaw[1:]), np.sin(yaw[1:])
    forward, lateral, turn = course.velocity[1:].T
    step = np.diff(course.pose, axis=0) / DT
    np.testing.assert_allclose(step[:, 0], c * forward - s * lateral, atol=1e-12)
    np.testing.assert_allclose(step[:, 1], s * forward + c * lateral, atol=1e-12)
    np.testing.assert_allclose(step[:, 2], turn, atol=1e-12)


def test_laps_of_a_square_close():
    side = (Segment(5, 0.8), Segment(np.pi / 2 / 0.6, 0.5, turn=0.6))
    course = whole_course(side * 4, DT, 1.0, laps=2)
    one = whole_course(side * 4, DT, 1.0, laps=1)
    assert len(course.t) - len(one.t) == pytest.approx(4 * (5 + np.pi / 2 / 0.6) / DT, abs=4)
    # What is left is the run-out of the last stop.
    assert np.abs(course.pose[-1, :2]).max() < 1.5


SPOT = Robot.load("spot_class")


STRIPS = (
    Strip((2.0, 0.0), (6.0, 0.0), 4.0, (0.0, 0.6), steps=5),
    Strip((6.0, 0.0), (9.0, 0.0), 4.0, (0.6, 0.6), rough=0.05),
    Strip((9.0, 4.0), (9.0, -4.0), 2.0, (0.6, 0.0)),
)


COURSE = Scenario(
    "course",
    (Segment(8.0, 0.6), Segment(4.0, 0.4, turn=0.5), Segment(6.0, 0.9)),
    Ground(0.8, (Patch(3.0, 0.0, 2.0, 1.0, 0.2),), strips=STRIPS),
    robot="spot_class",
)


def small(leg: float) -> Robot:
    """A robot of another name whose legs are `leg` times as long."""
    legs = SPOT.legs._replace(offset=leg * SPOT.legs.offset, foot=leg * SPOT.legs.foot)
    return replace(SPOT, name="small", file=SPOT.file.with_name("small.xml"), legs=legs)


def test_the_path_is_similar_and_the_froude_number_the_same():
    k, dt = 0.5, 0.001
    scaled = course_for(COURSE, small(k))
    lead, whole = ([s.duration for s in one.segments] for one in (scaled, COURSE))
    assert np.allclose(lead, np.sqrt(k) * np.array(whole))
    before, after = (whole_course(one.segments, dt, 0.0) for one in (COURSE, scaled))
    # Turns ramp up at one rate whatever the size, which costs a turn of four seconds some 3 %.
    assert after.pose[-1] == pytest.approx([k, k, 1.0] * before.pose[-1], rel=0.05)
    speeds = [np.abs(one.velocity[:, 0]).max() ** 2 for one in (before, after)]
    assert speeds[1] / k == pytest.approx(speeds[0], rel=1e-3)


def test_risers_shrink_slopes_stay_and_strips_still_meet():
    strips = course_for(COURSE, small(0.5)).ground.strips
    assert strips[0].heights[1] / strips[0].steps == pytest.approx(0.06)
    steep = [np.ptp(s.heights) / np.hypot(*np.subtract(s.end, s.start)) for s in strips]
    assert steep == pytest.approx([0.15, 0.0, 0.075], rel=0.1)
    assert strips[0].end == pytest.approx(strips[1].start)
    assert strips[1].rough == pytest.approx(0.025)


def test_its_own_robot_and_one_of_no_other_walk_it_as_written():
    assert course_for(COURSE, SPOT) is COURSE
    free = replace(COURSE, robot=None)
    assert course_for(free, small(0.5)) is free
    unknown = replace(COURSE, robot="nobody_knows")
    assert course_for(unknown, small(0.5)) is unknown


@pytest.mark.parametrize(
    "name",
    [
        "anybotics_anymal_b/anymal_b",
        pytest.param("anybotics_anymal_c/anymal_c", marks=pytest.mark.long),
        pytest.param("unitree_a1/a1", marks=pytest.mark.long),
        pytest.param("unitree_go1/go1", marks=pytest.mark.long),
    ],
)
def test_robots_that_others_drew_walk_the_demo_s_hardest_course(name):
    """Turns, a stop and ice, drawn for legs of 0.66 m; at that size those of 0.4 m fall on it."""
    file = measured_folder().parent / "models" / f"{name}.xml"
    if not file.is_file():
        pytest.skip(f"no {file}")
    robot = Robot.load(file)
    whole = Scenario.load("demo/calibrate")
    log = walk(replace(whole, laps=1), robot, seed=0)
    assert log.slip.max() > 0.2
