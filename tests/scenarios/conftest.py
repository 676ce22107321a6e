"""What tests of this folder share: an arc that is drawn, and a walk that falls."""

from pathlib import Path

import pytest
from arc_walk import Walk, make_walk

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
def cliff(tmp_path) -> Path:
    """Scenario file of a walk that ends in a fall."""
    path = tmp_path / "cliff.toml"
    path.write_text(CLIFF)
    return path


@pytest.fixture(scope="session")
def walk() -> Walk:
    return make_walk(seconds=4.0)
