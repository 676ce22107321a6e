"""Walks of the noise floor: along sections of the log, once the gait has settled."""

import pytest
from numpy.testing import assert_allclose

from surefoot.models.attribution.diagnose import diagnose
from surefoot.models.attribution.noise_floor import courses
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.walk import walk

GO1 = Robot.load("go1")


def test_a_section_is_walked_after_what_came_before_it():
    speeds = [0.1, 0.2, 0.3, 0.2, 0.1, 0.3]
    segments = tuple(Segment(3.0, forward) for forward in speeds)
    log = walk(Scenario("uneven", segments, Ground(0.8), stand=1.0), GO1, 0)
    found = courses([log])
    assert [len(one.lead_in) for one in found] == [4] * 4
    assert [len(one.section) for one in found] == [12] * 4
    whole = [forward for forward, _, _ in (*found[0].lead_in, *found[0].section)]
    assert_allclose(whole[2:14:3], speeds[:4], atol=0.06)
    assert found[-1].section[-2][0] == pytest.approx(speeds[-1], abs=0.06)


def test_a_short_log_is_walked_from_where_it_begins():
    log = walk(Scenario("short", (Segment(9.0, 0.3),), Ground(0.8), stand=1.0), GO1, 0)
    assert all(not one.lead_in and len(one.section) <= 12 for one in courses([log]))


@pytest.mark.long
@pytest.mark.parametrize("speed", [0.1, 0.3])
def test_nothing_is_missed_on_a_straight_walk_of_the_declared_robot(speed):
    """Feet are steadier in the first seconds than in the rest of a walk."""
    log = walk(Scenario("straight", (Segment(20.0, speed),), Ground(0.8), stand=0.5), GO1, 2)
    assert diagnose([log], GO1).verdict == "no_residual"
