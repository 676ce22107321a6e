"""A robot as it walks: what was measured of one walk, put into the suites' walks by one rule."""

import numpy as np
import pytest

from surefoot.scenarios.experiments.as_walked import SHEET, load_as_walked
from surefoot.scenarios.experiments.file import Experiment, walk_to_make
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.effects import effect
from surefoot.sim.effects.carry import carried, scale_of
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario

FILE = """robot = "spot_class"
period = 0.5
source = "a test"
sheets = 0.5
[gait]
duty = 0.7
[sensors]
contact_threshold = 0.2
[[size]]
effect = "joint_compliance"
target = "all"
value = 1e-3
source = "a test as well"
"""


def test_both_suites_have_the_condition_with_a_source_for_each_size():
    for suite in ("spot", "vision60"):
        names = {c.name: c for c in Experiment.load(suite).conditions}
        assert list(names) == ["as drawn", "as built", "as walked"]
        walked = names["as walked"].walked
        assert walked is not None
        assert all(len(one.source) > 20 for one in (walked, *walked.size))
        assert not names["as walked"].declared


def test_a_walk_has_the_gait_the_sensors_and_the_sizes_carried_to_its_robot(tmp_path):
    (tmp_path / "walked.toml").write_text(FILE)
    walked = load_as_walked(tmp_path / "walked.toml")
    suite = Experiment.load("vision60")
    condition = next(c for c in suite.conditions if c.name == "as walked")
    slipped = next(s for s in suite.scenarios if s.name == "Slipped")
    job = walk_to_make(slipped, "v60_class", condition, 1)
    assert condition.walked is not None
    assert job.scenario.gait == condition.walked.gait
    mine = walked.scenario(slipped)
    assert (mine.gait.duty, mine.sensors.contact_threshold) == (0.7, 0.2)
    for was, now in zip(slipped.ground.patches, mine.ground.patches, strict=True):
        assert was.mu < SHEET
        assert now.mu == pytest.approx(0.5 * was.mu)
    robots = [Robot.load(name) for name in ("spot_class", "v60_class")]
    scales = scale_of(robots[0], 0.5), scale_of(robots[1])
    (expected,) = carried([effect("joint_compliance", "all", 1e-3)], *scales)
    assert walked.effects_on(robots[1]) == (expected,)
    assert np.isfinite(expected.value)


@pytest.mark.parametrize(
    ("was", "now", "said"),
    [
        ("spot_class", "wings", "walked.toml"),
        ('target = "all"', 'target = "tail"\nunknown = 1', "unknown key 'unknown'"),
        ("duty = 0.7", "duty = 7", r"\[gait\] duty must lie between"),
        ("contact_threshold = 0.2", "smell = 1", "sensors: unknown key 'smell'"),
        ("value = 1e-3", "value = 1e3", "must lie between"),
    ],
)
def test_bad_files_are_one_clear_line(tmp_path, was, now, said):
    (tmp_path / "walked.toml").write_text(FILE.replace(was, now))
    with pytest.raises(SurefootError, match=said) as caught:
        load_as_walked(tmp_path / "walked.toml")
    assert "\n" not in str(caught.value)


def test_ground_without_sheets_stays():
    dry = Scenario.load("vision60/2cc2ccw")
    walked = load_as_walked()
    patches = zip(dry.ground.patches, walked.scenario(dry).ground.patches, strict=True)
    assert all(a == b for a, b in patches if a.mu >= SHEET)
    assert walked.scenario(dry).ground.mu == dry.ground.mu
