"""An effect that leaves more of a channel than the declared model does, on data no fit has seen."""

import numpy as np
import pytest

from surefoot.models.attribution.evidence import all_keys, linearise, log_under_model
from surefoot.models.attribution.fit import design
from surefoot.models.attribution.levels import channel_levels, without_nuisance
from surefoot.models.attribution.noise_floor import noise_floor
from surefoot.models.attribution.refinement import RefinementData
from surefoot.models.attribution.robust_weights import robust_weights
from surefoot.models.attribution.search import approximate_gains, find_harmful_effect
from surefoot.models.attribution.split import split_of
from surefoot.models.residuals.registry import channels as known_channels
from surefoot.sim.effects import effect
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.walk import walk

ROBOT = Robot.load("spot_class")
TRUTH = effect("imu_position", "x", 0.04)


@pytest.fixture(scope="module")
def case():
    course = Scenario("harm", (Segment(12.0, 0.6, 0.1, 0.3),), Ground(0.8))
    return log_under_model(walk(course, ROBOT, 3, (TRUTH,), declared=False), ROBOT)


def data_with(case, *effects):
    evidence = linearise([case], effects, all_keys(case))
    split, floor = split_of([case]), noise_floor([case])
    weights = robust_weights(design(evidence), floor.sigma)
    return RefinementData([case], floor, evidence, effects, weights, split.part)


def found(case, *effects):
    return find_harmful_effect(data_with(case, *effects))


def test_what_is_there_harms_nothing(case):
    assert found(case, TRUTH) is None


def test_what_is_not_there_is_left_out_and_the_truth_is_kept(case):
    wrong = effect("encoder_offset", "FL_thigh", 0.02)
    harm = found(case, TRUTH, wrong)
    assert harm is not None
    one, channel = harm
    assert one == wrong
    assert channel in known_channels()


def test_bins_that_were_not_there_before_do_no_harm(case):
    """Undone late touch-downs leave whole stances, which the log as it is has not."""
    data = data_with(case)
    everywhere = np.ones(len(data.evidence.t), dtype=bool)
    before = without_nuisance(data.evidence, data.robust_weights, everywhere)
    first = slice(None, len(before) // 2), data.evidence.layout.of("leg_velocity")
    after = before.copy()
    after[first] *= 20.0
    levels = channel_levels(before, after, data.evidence, data.floor)
    assert levels["leg_velocity"].worse
    before[first] = np.nan
    levels = channel_levels(before, after, data.evidence, data.floor)
    assert levels["leg_velocity"].after > 1.1 * levels["leg_velocity"].before
    assert not levels["leg_velocity"].worse


@pytest.mark.long
def test_what_a_sensor_explains_costs_no_other_effect_its_place(case):
    """Its error is undone exactly: nothing is left that another effect could stand for."""
    scale, heavy = effect("gyro_scale", "z", 0.1), effect("payload", "all", 2.0)
    assert approximate_gains(data_with(case, scale)) == {}
    alone = approximate_gains(data_with(case, heavy))
    beside = approximate_gains(data_with(case, scale, heavy))
    assert abs(alone["base_wrench"]) > 100.0  # a load that is not there explains nothing
    assert beside["base_wrench"] == pytest.approx(alone["base_wrench"], rel=0.2)
    assert abs(beside["imu_gyro"]) < 1e-6 * abs(beside["base_wrench"])
