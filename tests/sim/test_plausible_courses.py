"""No simulated course is warned of: what a plausibility rule notices is not what walking does."""

from dataclasses import replace

import pytest

from surefoot.sim.plausibility import check_log
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario
from surefoot.sim.scenario_catalog import bundled_scenarios, scenario_file
from surefoot.sim.walk import walk

SECONDS = 12.0
"""Of each course that is walked [s]."""


@pytest.mark.long
@pytest.mark.parametrize("course", bundled_scenarios())
def test_no_warning_is_given_on_a_bundled_course(course):
    scenario = Scenario.load(scenario_file(course))
    robot = Robot.load(scenario.robot or "spot_class")
    log = walk(beginning(scenario), robot, 0)
    assert log.t[-1] > 5.0
    assert [one.line for one in check_log(log, robot)] == []
    assert [one.line for one in check_log(log)] == []


def beginning(scenario: Scenario) -> Scenario:
    """The course's first SECONDS."""
    kept, left = [], SECONDS
    for segment in scenario.segments:
        if left > 0.0:
            kept.append(replace(segment, duration=min(segment.duration, left)))
            left -= segment.duration
    return replace(scenario, segments=tuple(kept))
