"""An effect that makes the drift of the legs worse is refuted, whatever else it explains."""

from dataclasses import replace

import numpy as np
import pytest

from surefoot.models.attribution.drift import adds_drift
from surefoot.models.attribution.evidence import linearise, log_under_model
from surefoot.models.attribution.noise_floor import noise_floor
from surefoot.sim.effects import effect
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.walk import walk

ROBOT = Robot.load("spot_class")
POINTS = replace(ROBOT, foot_radius=np.zeros(4))


@pytest.fixture(scope="module")
def case():
    """A walk of a robot whose feet roll, under a model that takes them for points."""
    course = (Segment(5.0, 0.6), Segment(4.0, 0.5, turn=0.4))
    return log_under_model(walk(Scenario("drift", course, Ground(0.8)), ROBOT, seed=2), POINTS)


def test_rolling_takes_drift_away_and_too_much_of_it_adds(case):
    radius, every = float(ROBOT.foot_radius[0]), np.ones(len(case.motion.t), dtype=bool)
    right, far = (effect("foot_rolling", "all", k * radius) for k in (1.0, 1.6))
    points, rolls = (linearise([case], known, ()) for known in ([], [right]))
    assert not adds_drift([case], points, points, [right], every)
    assert adds_drift([case], points, rolls, [far], every)
    assert adds_drift([case], points, rolls, [], every)
    # What is not looked at says nothing.
    assert not adds_drift([case], points, rolls, [far], ~every)


def test_the_drift_that_walks_of_the_model_have_is_none_that_an_effect_adds(case):
    every, less = np.ones(len(case.motion.t), dtype=bool), effect("foot_rolling", "all", -0.004)
    model = log_under_model(case.log, ROBOT)
    floor = noise_floor([model])
    declared = linearise([model], [], ())
    assert adds_drift([model], declared, declared, [less], every)
    assert adds_drift([model], declared, declared, [less], every, floor)
    assert not adds_drift([model], declared, declared, [less], every, louder(floor, 30.0))
    # Walks that differ among themselves may differ from one more by as much again.
    assert adds_drift([model], declared, declared, [less], every, louder(floor, 0.5, 1.0))
    assert not adds_drift([model], declared, declared, [less], every, louder(floor, 1.0, 20.0))


def louder(floor, *times):
    """The floor of a robot whose feet seem to move so many times as far while they stand, walk by
    walk in turn."""
    repeats = [
        replace(
            one, evidence=replace(one.evidence, table=times[i % len(times)] * one.evidence.table)
        )
        for i, one in enumerate(floor.walks)
    ]
    return replace(floor, walks=tuple(repeats))


def test_an_effect_of_the_imu_alone_adds_none(case):
    every = np.ones(len(case.motion.t), dtype=bool)
    declared = linearise([case], [], ())
    assert not adds_drift([case], declared, declared, [effect("accel_bias", "x", 0.3)], every)
