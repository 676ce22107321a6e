"""Scenario files: what they mean, what a seed may change, and one clear line for every mistake."""

import numpy as np
import pytest
from ground_course import surfaces, whole_course
from refusals import refusal, refused
from written import written

from surefoot.sim.common.files import bundled
from surefoot.sim.scenario import Scenario, drawn
from surefoot.sim.scenario_catalog import bundled_scenarios

SCENARIOS = bundled("surefoot.scenarios", "courses")
SUITES = sorted(p for suite in ("demo", "shift", "spot", "vision60")
                for p in (SCENARIOS / suite).glob("*.toml"))  # fmt: skip
GOOD = """
robot = "spot_class"
role = "test"
segment = [{distance = 2.0, forward = 0.5}, {angle = 1.0, turn = -0.5},
  {repeat = 2, segment = [{duration = 3.0, lateral = 0.1}]}]
[ground]
mu = 0.7
[[ground.strip]]
start = [2.0, 0.0]
end = [4.0, 0.0]
width = 2.0
heights = [0.0, 0.4]
rough = 0.03
mu = 0.6
[[ground.patch]]
center = [2.5, 0.03]
size = [1.0, 1.0]
mu = 0.2
[ranges]
mu = [0.8, 1.2]
rough = [0.5, 1.0]
patch_shift = 0.1
"""


def load(tmp_path, text: str) -> Scenario:
    return Scenario.load(written(tmp_path / "walk.toml", text))


def test_segments_by_length_angle_and_rounds(tmp_path):
    scenario = load(tmp_path, GOOD)
    assert [s.duration for s in scenario.segments] == [4.0, 2.0, 3.0, 3.0]
    assert (scenario.name, scenario.role, scenario.robot) == ("walk", "test", "spot_class")


def test_a_seed_draws_within_the_ranges_and_the_same_twice(tmp_path):
    scenario = load(tmp_path, GOOD)
    one, same = (drawn(scenario, np.random.default_rng(1)).scenario.ground for _ in range(2))
    other = drawn(scenario, np.random.default_rng(2)).scenario.ground
    assert one == same != other
    np.testing.assert_array_equal(one.strips[0].bumps, same.strips[0].bumps)
    factor = one.mu / 0.7
    assert 0.8 <= factor <= 1.2
    assert one.strips[0].mu == pytest.approx(0.6 * factor)
    assert one.patches[0].mu == pytest.approx(0.2 * factor)
    assert 0.015 <= one.strips[0].rough <= 0.03
    # Patches near rough ground keep to its lattice, so that geoms and truth agree.
    edges = np.array(one.patches[0].rectangle) / 0.1
    np.testing.assert_allclose(edges, np.round(edges), atol=1e-9)


def test_without_ranges_nothing_is_changed(tmp_path):
    scenario = load(tmp_path, "segment = [{duration = 2.0, forward = 0.5}]")
    drew = drawn(scenario, np.random.default_rng(0))
    assert drew.scenario == scenario
    assert (drew.period, drew.clearance, drew.gain, drew.payload) == (1.0, 1.0, 1.0, 0.0)


HIGHEST_RISER = 0.13  # m: shins strike the edges of stairs from 15 cm on


@pytest.mark.parametrize(
    "path", [p for p in SUITES if p.parent.name != "demo"], ids=lambda p: p.stem
)
def test_no_course_leads_over_a_pit_or_a_wall(path):
    scenario = Scenario.load(path)
    height_map = drawn(scenario, np.random.default_rng(0)).scenario.ground.height_map
    course = whole_course(scenario.segments, 0.01, scenario.stand, scenario.laps)
    x, y, yaw = course.pose.T
    for aside in (-0.7, -0.35, 0.0, 0.35, 0.7):
        z, _ = surfaces(height_map, x - aside * np.sin(yaw), y + aside * np.cos(yaw))
        assert np.abs(np.diff(z)).max() < HIGHEST_RISER


SEGMENT = "segment = [{duration = 2.0, forward = 0.5}]\n"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("segment = [{angle = 1.0, forward = 1.0}]", "angle needs a speed"),
        ("segment = [{duration = 1.0, speed = 1.0}]", "; did you mean forward?"),
        (SEGMENT + "[ground]\nfriction = 1", "; did you mean mu?"),
        (SEGMENT + "[friction]\nmu = 1", "; did you mean [ground] mu?"),
        (SEGMENT + "[[patch]]\nmu = 1", "; did you mean [[ground.patch]]?"),
        (SEGMENT + "[grond]\nmu = 1", "; did you mean 'ground'?"),
    ],
)
def test_a_mistake_is_one_line_that_names_file_and_key(tmp_path, text, words):
    message = refusal(load, tmp_path, text)
    assert words in message
    assert "walk.toml" in message


def test_a_missing_file_is_named(tmp_path):
    refused(r"nowhere\.toml: No such file.*demo/walk", Scenario.load, tmp_path / "nowhere.toml")


def test_bundled_scenarios_have_names_and_a_file_of_that_name_goes_first(tmp_path, monkeypatch):
    assert set(bundled_scenarios().values()) >= set(SUITES)
    assert Scenario.load("spot/atrium") == Scenario.load(SCENARIOS / "spot" / "atrium.toml")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "demo").mkdir()
    (tmp_path / "demo" / "walk").write_text('name = "mine"\nsegment = [{duration = 1.0}]\n')
    assert Scenario.load("demo/walk").name == "mine"
