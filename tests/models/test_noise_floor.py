"""The noise floor of robots that match their model."""

import pytest

from surefoot.models.attribution.diagnose import diagnose
from surefoot.models.attribution.evidence import log_under_model
from surefoot.models.attribution.noise_floor import ground_of, noise_floor
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


@pytest.mark.long
def test_what_bumps_seem_to_be_is_known_from_the_walks_though_some_count_as_level():
    """On rough ground the torques seem to lack rotor inertia, as in the walks of the floor."""
    course = (Segment(8.0, 0.3), Segment(6.0, 0.4))
    rough = Scenario("rough", course, ground_of(course, 0.01, 0.8), stand=0.5)
    case = log_under_model(walk(rough, GO1, 3), GO1)
    floor = noise_floor([case])
    assert not case.motion.level
    assert not any(one.case.motion.level for one in floor.walks)
    assert "armature" in {name for name, _ in floor.error.keys}
