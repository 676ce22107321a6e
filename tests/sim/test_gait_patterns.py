"""Gaits beside the trot: feet land in the order that the pattern says, and robots stay up."""

import numpy as np
import pytest
from refusals import refused

from surefoot.sim.gait.options import PATTERNS, GaitOptions, Pattern, _check
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.walk import plan, record, simulate_motion

ROBOT = Robot.load("spot_class")


def walked(gait: GaitOptions, seconds: float = 6.0):
    scenario = Scenario("flat", (Segment(seconds, 0.3),), Ground(0.8), gait=gait)
    made = plan(scenario, ROBOT, 0)
    return made, record(made, simulate_motion(made.world, ROBOT, made.gait, made.course))


@pytest.mark.parametrize("name", ["trot", "walk", "pace"])
def test_feet_swing_when_the_pattern_says(name):
    made, log = walked(GaitOptions(pattern=name))
    assert log.ref_p[-1, 0] > 1.0
    feet_G = log.ref_p[:, None] + np.einsum("nij,nlj->nli", log.ref_R_GI, ROBOT.feet_I(log.q))
    height = feet_G[..., 2] - ROBOT.foot_radius
    lifted = (height > 0.5 * made.gait.clearance) & ((log.t > 2.0) & (log.t < 6.0))[:, None]
    assert lifted.any(axis=0).all()
    # Circular means of when each foot is up, relative to the first foot.
    turns = [np.angle(np.exp(2j * np.pi * log.t[up] / made.gait.period).mean()) for up in lifted.T]
    miss = (np.array(turns) - turns[0]) / (2.0 * np.pi) - PATTERNS[name].phase
    assert np.abs((miss + 0.5) % 1.0 - 0.5).max() < 0.05
    # As many at once as the duty leaves: one foot in a walk, a pair in the others.
    assert lifted.sum(axis=1).max() == (1 if name == "walk" else 2)
    if name == "walk":
        # The body sways to the side of the feet that stand, so that three bear it.
        assert np.mean(log.contact[(log.t > 2.0) & (log.t < 6.0)].sum(axis=1) >= 3) > 0.75


def test_what_is_no_gait_is_one_line():
    refused("did you mean 'trot'", GaitOptions, pattern="trott")
    for wrong in (Pattern((0.0, 0.5, 0.5, 1.5), 0.6), Pattern((0.0, 0.5, 0.5, 0.0), 0.99)):
        refused("must", _check, wrong)
