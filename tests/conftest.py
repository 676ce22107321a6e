"""Fixtures that tests of several packages share."""

from pathlib import Path

import pytest

from surefoot.sim.effects import CATALOGUE

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
    before = dict(CATALOGUE)
    yield CATALOGUE
    CATALOGUE.clear()
    CATALOGUE.update(before)


@pytest.fixture
def cliff(tmp_path) -> Path:
    """Scenario file of a walk that ends in a fall."""
    path = tmp_path / "cliff.toml"
    path.write_text(CLIFF)
    return path
