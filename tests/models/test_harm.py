"""Effects that make a channel worse on bins that no fit has seen."""

from dataclasses import replace

import numpy as np
import pytest

from surefoot.models.attribution.data import split_of
from surefoot.models.attribution.design import without_nuisance
from surefoot.models.attribution.evidence import all_keys, linearise, log_under_model
from surefoot.models.attribution.explain import problem_of
from surefoot.models.attribution.judgement import (
    Unseen,
    channel_levels,
    find_harmful_effect,
    residuals_with,
)
from surefoot.models.attribution.metric import metric_of
from surefoot.models.attribution.noise_floor import noise_floor
from surefoot.models.attribution.weights import robust_weights
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


@pytest.fixture(scope="module")
def floor(case):
    return noise_floor([case])


def sides(case, floor, *effects):
    known, split = linearise([case], effects, all_keys(case)), split_of([case])
    metric = metric_of([case], known, floor.error, split.fit)
    problem = problem_of([case], split.fit, False)
    return residuals_with(problem, effects, metric, floor, split.fit), split.report


def found(case, floor, *effects):
    residuals, report = sides(case, floor, *effects)
    return find_harmful_effect([Unseen(residuals, report, {"unseen bins": report})])


def test_what_is_there_harms_nothing(case, floor):
    assert found(case, floor, TRUTH) is None


def test_what_is_not_there_is_left_out_and_the_truth_is_kept(case, floor):
    wrong = effect("encoder_offset", "FL_thigh", 0.02)
    harm = found(case, floor, TRUTH, wrong)
    assert harm is not None
    one, why = harm
    assert one == wrong
    assert "worse" in why


def test_a_channel_is_worse_without_what_is_there_and_not_without_what_is_not(case, floor):
    def worse(effects, instead):
        residuals, report = sides(case, floor, *effects)
        return replace(residuals, before=residuals.left_by(instead)).worse(report)

    wrong = effect("encoder_offset", "FL_thigh", 0.02)
    assert worse((), (TRUTH,))
    assert not worse((TRUTH,), (TRUTH, wrong))


def test_bins_that_were_not_there_before_do_no_harm(case, floor):
    """Undone late touch-downs leave whole stances, which the log as it is has not."""
    known = linearise([case], (), ())
    weights = robust_weights(known, floor.sigma)
    everywhere = np.ones(len(known.t), dtype=bool)
    before = without_nuisance(known, weights.sigma, weights.weight, everywhere)
    first = slice(None, len(before) // 2), known.layout.of("leg_velocity")
    after = before.copy()
    after[first] *= 20.0
    levels = channel_levels(before, after, known, floor)
    assert levels["leg_velocity"].worse
    before[first] = np.nan
    levels = channel_levels(before, after, known, floor)
    assert levels["leg_velocity"].after > 1.1 * levels["leg_velocity"].before
    assert not levels["leg_velocity"].worse
