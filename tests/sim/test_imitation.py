"""Imitation: a walk's manner is read from its log, and walking in that manner gives it back."""

from dataclasses import replace

import numpy as np
import pytest
from refusals import refused
from synthetic import without

from surefoot.sim.ground.terrain import Ground
from surefoot.sim.scenario import Ranges, Scenario, Segment
from surefoot.sim.walk import walk
from surefoot.sim.walking.imitation import (
    WalkingStyle,
    body_twists,
    replica,
    slower,
    walking_style,
)

FORWARD, TURN = 0.6, 0.4


@pytest.fixture(scope="module")
def shown(robot):
    """A walk with a slow, high-stepping, crouched gait: forward, then in a curve."""
    crouched = robot.q_home + np.tile([0.0, 0.08, -0.16], 4)
    ranges = Ranges(period=(1.25, 1.25), clearance=(1.3, 1.3))
    segments = (Segment(8.0, FORWARD), Segment(8.0, FORWARD, 0.0, TURN))
    scenario = Scenario("shown", segments, Ground(0.8), "spot_class", ranges=ranges)
    return walk(scenario, replace(robot, q_home=crouched), 5), crouched


def test_the_manner_of_a_walk_is_read_from_its_log(robot, shown):
    log, crouched = shown
    read = walking_style(log, robot)
    assert read.period == pytest.approx(1.25, rel=0.03)
    assert read.clearance == pytest.approx(1.3, rel=0.25)
    knees = slice(2, None, 3)
    np.testing.assert_allclose(read.q_stance[knees], crouched[knees], atol=0.12)
    steady = read.twists[3:7], read.twists[12:15]
    np.testing.assert_allclose(steady[0].mean(axis=0), [FORWARD, 0, 0], atol=0.05)
    np.testing.assert_allclose(steady[1].mean(axis=0), [FORWARD, 0, TURN], atol=0.1)


def test_a_replica_has_that_manner(robot, shown):
    read = walking_style(shown[0], robot)
    scenario, poised = replica(read, robot, "again")
    again = walking_style(walk(scenario, poised, 0), robot)
    assert again.period == pytest.approx(read.period, rel=0.03)
    assert (np.abs(again.q_stance - read.q_stance) < 0.12).all()
    speeds = [np.median(np.hypot(*m.twists[:, :2].T)) for m in (read, again)]
    assert speeds[1] == pytest.approx(speeds[0], rel=0.2)
    half = slower(scenario, 0.5)
    assert [s.forward for s in half.segments] == [0.5 * s.forward for s in scenario.segments]


def test_a_replica_walks_from_the_first_step_to_the_last(robot):
    forward = [0.0, 0.01, 0.4, 0.0, 0.6, 0.0]
    read = WalkingStyle(np.outer(forward, [1.0, 0.0, 0.0]), 1.0, 1.0, robot.q_home)
    assert [s.forward for s in replica(read, robot, "x")[0].segments] == [0.4, 0.0, 0.6]


def test_without_contacts_the_gait_is_the_controllers_own(robot, shown):
    read = walking_style(without(shown[0], "contact_"), robot)
    assert (read.period, read.clearance) == (1.0, 1.0)
    np.testing.assert_array_equal(read.q_stance, robot.q_home)


def test_gaps_in_the_reference_are_not_walked(robot, shown):
    log = shown[0]
    hidden = log.frame.copy()
    hidden["ref_ok"] = ((log.t < 2.0) | (log.t > 6.0)).astype(float)
    assert len(body_twists(replace(log, frame=hidden))) == len(body_twists(log)) - 4
    hidden["ref_ok"] = (log.t < 1.5).astype(float)
    refused("covers less than 3 s", walking_style, replace(log, frame=hidden), robot)
