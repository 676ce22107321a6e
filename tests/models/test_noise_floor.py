"""The noise floor of robots that match their model."""

import pytest

from surefoot.models.attribution.diagnose import diagnose
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.walk import walk

GO1 = Robot.load("go1")


@pytest.mark.long
@pytest.mark.parametrize("speed", [0.1, 0.3])
def test_nothing_is_missed_on_a_straight_walk_of_the_declared_robot(speed):
    """Feet are steadier in the first seconds than in the rest of a walk."""
    log = walk(Scenario("straight", (Segment(20.0, speed),), Ground(0.8), stand=0.5), GO1, 2)
    assert diagnose([log], GO1).verdict == "no_residual"
