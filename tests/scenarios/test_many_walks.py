"""Walks to train on: the same when drawn again, kept, and left out where a robot cannot walk."""

from dataclasses import replace

import numpy as np
import pytest
from refusals import refused

from surefoot.scenarios.datasets import kept_walks
from surefoot.scenarios.datasets.kept_walks import DrawnWalk
from surefoot.scenarios.settings import WalksSettings
from surefoot.scenarios.training import many_walks
from surefoot.scenarios.training.drawn_course import COMMANDS, drawn_course
from surefoot.scenarios.training.many_walks import DrawnWalks
from surefoot.sim.gait.options import PLAIN_GAIT
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.walk import Fallen, walk

pytestmark = pytest.mark.usefixtures("own_cache")
ROBOT = Robot.load("spot_class")
DRAWN = DrawnWalks(ROBOT, "train", 0)


def test_a_walk_is_the_same_when_drawn_again_and_another_in_each_role_and_attempt():
    first = DRAWN.walk(3, 0).inputs
    assert DRAWN.walk(3, 0).inputs == first
    others = [replace(DRAWN, seed=1).walk(3, 0), replace(DRAWN, role="test").walk(3, 0)]
    others += [DRAWN.walk(3, 1), DRAWN.walk(4, 0)]
    assert len({repr(first), *(repr(one.inputs) for one in others)}) == 5


def test_walks_have_both_gaits_and_all_grounds():
    drawn = [DRAWN.walk(number, 0) for number in range(40)]
    gaits = {one.scenario.gait == PLAIN_GAIT for one in drawn}
    grounds = [one.scenario.ground for one in drawn]
    assert gaits == {True, False}
    assert any(ground.patches for ground in grounds)
    assert any(strip.steps for ground in grounds for strip in ground.strips)
    assert any(strip.rough for ground in grounds for strip in ground.strips)
    segments = [one for walk in drawn for one in walk.scenario.segments]
    assert min(one.forward for one in segments) < -0.2
    assert max(abs(one.lateral) for one in segments) > 0.2
    assert any(one.turn and not one.forward for one in segments)
    # Some robots equal their model; each other one is built with errors of its own.
    built = [one for one in drawn if one.effects]
    assert 20 < len(built) < 36
    assert len({one.effects[0].value for one in built}) == len(built)


def test_robots_are_slow_on_steps_alone():
    """The way along the lane, turned about at each end, and the speed wherever steps are."""
    fast = []
    for seed in range(30):
        course = drawn_course("course", 60.0, np.random.default_rng(seed))
        steps = [(s.start[0], s.end[0]) for s in course.ground.strips if s.steps]
        x, ahead = 0.0, 1.0
        for one in course.segments if course.ground.strips else ():
            if abs(one.turn * one.duration) > 3.0:
                ahead = -ahead
            begin, x = x, x + ahead * one.forward * one.duration
            low, high = sorted((begin, x))
            if any(low < finish and start < high for start, finish in steps):
                assert one.forward <= 0.6
            else:
                fast.append(one.forward)
    assert max(fast) > 1.0


def test_a_course_lasts_as_long_as_asked():
    assert sum(kind[0] for kind in COMMANDS.values()) == pytest.approx(1.0)
    for seed in range(6):
        course = drawn_course("course", 30.0, np.random.default_rng(seed))
        longest = max(one.duration for one in course.segments)
        assert 30.0 <= sum(one.duration for one in course.segments) <= 30.0 + longest


def test_own_scenarios_are_taken_in_turn():
    courses = [Scenario(name, (Segment(1.0, 0.4),), Ground(0.8), "spot_class") for name in "ab"]
    walks = [replace(DRAWN, courses=courses).walk(number, 0) for number in range(3)]
    assert [one.scenario.name for one in walks] == ["a", "b", "a"]


def test_walks_are_kept_and_falls_are_drawn_again(robot, monkeypatch):
    course = Scenario("short", (Segment(0.3, 0.4),), Ground(0.8), "spot_class")
    tried = []

    def falls(scenario, robot, seed, *others):
        tried.append(seed)
        if seed in (10, 20, 21):
            raise Fallen("the robot fell")
        return walk(scenario, robot, seed, *others)

    def draw(number, attempt):
        return DrawnWalk(course, robot, 10 * number + attempt)

    monkeypatch.setattr(kept_walks, "walk", falls)
    made = kept_walks.kept_walks(draw, 3, 2, "short", workers=1)
    assert [log.name for log in made] == ["short_0", "short_1"]
    assert tried == [0, 10, 11, 20, 21]
    assert [log.meta.seed for log in made] == [0, 11]
    assert [log.meta.effects for log in made] == [(), ()]
    again = kept_walks.kept_walks(draw, 3, 2, "short", workers=2)
    assert again == made
    assert len(tried) == 5
    assert len(made.first(1)) == 1


def test_what_cannot_be_walked_is_one_line(monkeypatch, capsys, cliff):
    four = WalksSettings(robot="spot_class", walks=1)
    refused("walks must be", many_walks.many_walks, replace(four, walks=0))
    refused("one robot", many_walks.many_walks, WalksSettings(walks=1))
    monkeypatch.setattr(many_walks, "ATTEMPTS", 1)
    refused("falls on every one", many_walks.many_walks, four, (str(cliff),))
    assert "1 of 1 walks left out" in capsys.readouterr().out
