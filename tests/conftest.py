"""Fixtures that tests of several packages share."""

from pathlib import Path

import pytest

from surefoot.sim.effects import CATALOGUE
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.walk import walk

CLIFF = """
name = "cliff"
robot = "spot_class"
[[segment]]
duration = 4.0
forward = 0.8
[[ground.strip]]
start = [-2.0, 0.0]
end = [0.7, 0.0]
width = 3.0
heights = [1.5, 1.5]
"""


@pytest.fixture
def catalogue():
    """The catalogue of effects, which a test may add to; afterwards it is as it was."""
    before = dict(CATALOGUE.bundled)
    yield CATALOGUE
    CATALOGUE.bundled.clear()
    CATALOGUE.bundled.update(before)


@pytest.fixture(scope="session")
def robot() -> Robot:
    return Robot.load("spot_class")


@pytest.fixture(scope="session")
def log(robot) -> Log:
    """A walk for tests that need any: 14 s of spot_class on a level floor, ahead and in two turns.

    Whoever changes its columns does so in a copy.
    """
    course = (Segment(5.0, 0.5), Segment(5.0, 0.4, turn=0.5), Segment(4.0, 0.5, turn=-0.4))
    return walk(Scenario("seen", course, Ground(0.8)), robot, 4)


@pytest.fixture
def cliff(tmp_path) -> Path:
    """Scenario file of a walk that ends in a fall."""
    path = tmp_path / "cliff.toml"
    path.write_text(CLIFF)
    return path
