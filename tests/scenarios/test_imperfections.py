"""A robot as built is one robot: the same wherever it walks, and not its neighbour."""

from dataclasses import replace

import numpy as np
import pytest
from refusals import refused

from surefoot.scenarios.experiments.file import PLAIN, Cell, Experiment
from surefoot.scenarios.experiments.imperfections import Imperfection, load_imperfections
from surefoot.sim.effects import effect
from surefoot.sim.robot.limbs import QUADRUPED


def test_an_instance_draws_the_same_wherever_it_walks_and_others_draw_otherwise():
    suite = Experiment.load("vision60")
    _, built, _ = suite.conditions
    walks = [Cell(s, "v60_class", built, 1).walk for s in suite.scenarios]
    assert all(walk.effects == walks[0].effects for walk in walks)
    assert len({walk.seed for walk in walks}) == len(walks)
    assert not any(walk.declared for walk in walks)
    assert Cell(suite.scenarios[0], "v60_class", built, 2).walk.effects != walks[0].effects
    assert walks[0].scenario.sensors.contact_delay == 0.005


def test_sizes_follow_the_law_of_the_file():
    offsets = Imperfection("encoder_offset", "", normal=0.01)
    drawn = np.array([[e.value for e in offsets.drawn(k, QUADRUPED)] for k in range(400)])
    # The standard error of a deviation from n draws is about 1 / sqrt(2 n) of it.
    assert np.std(drawn) == pytest.approx(0.01, rel=4 / np.sqrt(2 * drawn.size))
    assert abs(drawn.mean()) < 4 * 0.01 / np.sqrt(drawn.size)
    turns = Imperfection("imu_rotation", "", ("x", "y", "z"), uniform=0.006)
    drawn = np.array([[e.value for e in turns.drawn(k, QUADRUPED)] for k in range(400)])
    assert 0.0059 < np.abs(drawn).max() <= 0.006
    compliance = Imperfection("leg_compliance", "", QUADRUPED.joints[:3], fixed=1e-4)
    assert {e.value for e in compliance.drawn(3, QUADRUPED)} == {1e-4}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "are written as"),
        ("[[imperfection]]\neffect='wings'\nnormal=1\nsource=''", "unknown effect 'wings'"),
        ("[[imperfection]]\neffect='payload'\nsource=''", "needs one of normal"),
        ("[[imperfection]]\neffect='payload'\nfixed=true\nsource=''", "must be a number"),
        ("[[imperfection]]\neffect='payload'\nfixed=1", "source is missing"),
        ("[[imperfection]]\neffect='payload'\nfixed=99\nsource=''", "must lie between"),
        ("[[imperfection]]\neffect='payload'\nfixed=1\nsource=''\ntargets=['x']", "unknown target"),
        ("[[imperfection]]\neffect='payload'\nfixed=1\nsource=''\nsize=2", "unknown key 'size'"),
    ],
)
def test_bad_files_are_one_clear_line(tmp_path, text, said):
    (tmp_path / "bad.toml").write_text(text)
    assert said in refused(r"bad\.toml", load_imperfections, tmp_path / "bad.toml")


@pytest.mark.parametrize("seed", [0, 2])
def test_gears_as_stiff_as_real_ones_make_no_robot_fall_on_a_sheet(seed):
    suite = Experiment.load("vision60")
    course = next(s for s in suite.scenarios if s.name == "3CC3CCW")
    start = replace(course, segments=course.segments[:2], laps=1)
    gears = (effect("leg_compliance", "all", 1e-4),)
    walked = replace(Cell(start, "v60_class", PLAIN, seed).walk, effects=gears).simulated()
    slip = walked.frame[[f"slip_{leg}" for leg in walked.legs]].to_numpy()
    assert slip[walked.contact].max() > 0.2
