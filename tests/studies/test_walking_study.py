"""The study of how robots walk: its measures on a short walk."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from studies.command import run_study
from studies.walking.grounds import SLOPE, grounds_for
from studies.walking.study import WalkingStudy, velocity_error, walking_study
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.walk import plan, simulate_motion

COURSE = """
name = "short"
robot = "spot_class"
segment = [{duration = 3.0, forward = 0.5, turn = 0.3}]
"""


@pytest.fixture
def course(tmp_path, monkeypatch) -> Path:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "short.toml"
    path.write_text(COURSE)
    return path


def test_the_command_leaves_a_row_a_walk_and_a_line_a_course(course, capsys):
    run_study(WalkingStudy, "--course short.toml --seeds 2 --workers 2 -o study".split())
    rows = pd.read_csv("study/walking.csv")
    assert list(rows.seed) == [0, 1]
    assert (rows.falls == 0).all()
    assert (rows.creep < 1e-3).all()
    # The engine's steps are part of the walk's.
    assert rows.bare_pace[0] > rows.pace[0]
    assert "| spot_class | short | 0 of 2 |" in capsys.readouterr().out
    with pytest.raises(SystemExit, match=r"walking\.md: exists already"):
        run_study(WalkingStudy, "--course short.toml -o study".split())
    with pytest.raises(SystemExit, match="--seeds"):
        run_study(WalkingStudy, "--course short.toml --seeds -1 -o new".split())


def test_a_fall_is_counted_and_the_study_goes_on(course, cliff):
    walks = walking_study(WalkingStudy(Path("study"), course=(str(cliff), str(course)), seeds=1))
    assert [(w.walk, w.falls) for w in walks] == [("cliff", 1), ("short", 0)]
    assert "| cliff | 1 of 1 | –" in Path("study/walking.md").read_text()


def test_a_command_that_is_not_followed_shows_as_a_velocity_error():
    """Turning or not, forward or aside: the error is that of what was commanded."""
    made = plan(Scenario("s", (Segment(4.0, 0.4, 0.1, 0.3),), Ground(0.8)), spot(), 0)
    motion = simulate_motion(made.world, made.robot, made.gait, made.course)
    assert velocity_error(made, motion) < 0.1
    made.course.velocity[:, 1] += 0.3
    assert velocity_error(made, motion) == pytest.approx(0.3, abs=0.1)


def test_grounds_fit_the_robot():
    for scenario in grounds_for(spot()):
        assert sum(s.duration for s in scenario.segments) * scenario.laps >= 58.0
    hill = grounds_for(spot())[1].ground.height_map
    assert np.hypot(*_steepest(hill)) == pytest.approx(SLOPE)


def _steepest(height_map) -> tuple[float, float]:
    from surefoot.sim.ground.height_map import surface

    _, a, b = surface(height_map, 3.0, 0.0)
    return a, b


def spot() -> Robot:
    return Robot.load("spot_class")
