"""Several walks of one robot: sizes that they share, zeros and clocks of their own, and a hand that
pushed in one of them."""

import pytest
from pushes import pushed

from surefoot.scenarios.trace.run import TraceOptions, trace_logs
from surefoot.sim.effects import effect
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.walk import walk

pytestmark = pytest.mark.slow

ROBOT = Robot.load("spot_class")
ZIGZAG = (Segment(1.5, 0.4, lateral=0.15), Segment(1.5, 0.4, lateral=-0.15)) * 4
LONGER = effect("link_length", "FR_calf", 0.006)
ZEROS, LATE = (0.02, -0.015, 0.01), (0.0, 0.012, 0.006)
"""rad of FL's thigh, and s of the reference's clock, of each walk."""
PUSH = (5.0, 6.2)
"""s of the second walk."""


def walked(seed):
    own = [effect("encoder_offset", "FL_thigh", ZEROS[seed])]
    own += [effect("reference_delay", "all", LATE[seed])] if LATE[seed] else []
    course = Scenario("zigzag", ZIGZAG, Ground(0.8))
    log = walk(course, ROBOT, seed, [LONGER, *own], declared=False)
    return pushed(log, ROBOT, [PUSH], (0.0, 30.0, -15.0)) if seed == 1 else log


@pytest.fixture(scope="module")
def found():
    return trace_logs([walked(0), walked(1)], ROBOT, TraceOptions(holdout=[walked(2)]))


def of_run(run, name):
    return {z.effect.target: z.effect.value for z in run.zeros if z.effect.name == name}


def test_the_size_that_both_walks_share_is_found(found):
    assert [(e.name, e.target) for e in found.effects] == [("link_length", "FR_calf")]
    assert found.effects[0].value == pytest.approx(0.006, abs=0.0015)
    (size,) = found.found
    assert size.interval[0] - 5e-4 < 0.006 < size.interval[1] + 5e-4


def test_each_walk_has_a_zero_and_a_clock_of_its_own(found):
    for run, zero, late in zip(found.runs, ZEROS, LATE, strict=False):
        assert of_run(run, "encoder_offset")["FL_thigh"] == pytest.approx(zero, abs=0.004)
        assert of_run(run, "reference_delay").get("all", 0.0) == pytest.approx(late, abs=0.002)


def test_the_push_is_told_from_what_the_robot_lacks(found):
    (told,) = [one for one in (*found.reasons, *found.notes) if "outside forces" in one]
    assert "of run 2" in told


def test_the_walk_that_no_fit_has_seen_agrees(found):
    feet = found.held_out.channels["foot_height"]
    assert feet.after < 0.7 * feet.before
