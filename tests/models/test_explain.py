"""The search on walks with a known effect: the right one of two that look alike, and no other."""

import numpy as np
import pytest

from surefoot.models.attribution.data import split_of
from surefoot.models.attribution.evidence import all_keys, linearise, log_under_model
from surefoot.models.attribution.explain import explain, problem_of, zeros_beside
from surefoot.models.attribution.metric import interpolation_weights
from surefoot.models.attribution.noise_floor import left_deviations, noise_floor, noise_floor_with
from surefoot.sim.effects import effect
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.walk import walk

SPOT = Robot.load("spot_class")
SCENARIO = Scenario("short", (Segment(12.0, 0.6, 0.1, 0.3),), Ground(0.8))


def case_with(*effects, seed=3):
    return log_under_model(walk(SCENARIO, SPOT, seed, effects, declared=False), SPOT)


@pytest.fixture(scope="module")
def floor():
    return noise_floor([case_with()])


def explained(case, floor):
    return explained_together([case], floor, several=False)


def explained_together(cases, floor, several=True):
    problem = problem_of(cases, split_of(cases).fit, several)
    return explain(
        problem,
        floor.error,
        lambda e, keys: left_deviations(floor, noise_floor_with(floor, e), keys),
    )


def test_joints_far_late_do_not_lack_readings_where_they_are_fitted():
    """Compensation of a delay repeats the last readings beyond the end of a log."""
    late = effect("joint_delay", "all", 0.04)
    case = case_with(late)
    split, known = split_of([case]), linearise([case], [late], ())
    rates = known.table[:, known.layout.channels["joint_rate"]]
    ends, inside = rates[-3:], rates[split.fit | split.report]
    assert np.nanmax(np.abs(ends)) > 10.0 * np.nanmax(np.abs(inside))


def names(found):
    return [(one.effect.name, one.effect.target) for one in found.found]


# Half a step between two rows: there most is lost by moving a stream.
@pytest.mark.parametrize("late", ["imu_delay", "reference_delay"])
@pytest.mark.parametrize("delay", [0.001, 0.01])
def test_of_two_streams_the_late_one_is_named(floor, late, delay):
    found = explained(case_with(effect(late, "all", delay)), floor)
    assert names(found) == [(late, "all")]
    # Interpolation draws a delay towards the middle between rows: here by a tenth of one at most.
    assert found.found[0].effect.value == pytest.approx(delay, abs=2e-4)
    assert not found.rivals


@pytest.mark.parametrize("time", [0.0016, 0.004])
def test_a_filtered_imu_is_no_late_one(floor, time):
    """Filtered rates are late in the legs' velocities too, which know of the filter."""
    found = explained(case_with(effect("imu_lowpass", "all", time)), floor)
    assert names(found) == [("imu_lowpass", "all")]
    assert found.found[0].effect.value == pytest.approx(time, rel=0.15)


def test_nothing_is_found_on_a_walk_of_the_model(floor):
    found = explained(case_with(seed=8), floor)
    assert not found.found
    assert not any(one.earned for one in found.rounds[0])
    assert all(one.least > 0.0 for one in found.rounds[0])


def test_two_effects_of_one_joint_are_both_found(floor):
    truth = effect("viscous_friction", "FL_calf", 0.8), effect("armature", "FL_calf", 0.02)
    found = explained(case_with(*truth), floor)
    assert {*names(found)} == {("viscous_friction", "FL_calf"), ("armature", "FL_calf")}
    for one in found.found:
        low, high = one.interval
        size = next(e.value for e in truth if e.name == one.effect.name)
        assert low < size < high


@pytest.mark.long
def test_a_scale_that_no_encoder_has_is_not_found(floor):
    found = explained(case_with(effect("encoder_scale", "FL_hip", -0.15)), floor)
    assert ("encoder_scale", "FL_hip") not in names(found)
    assert any(one.name == "encoder_scale" and "at its bound" in why for one, why in found.rejected)


@pytest.mark.long
def test_what_leftovers_of_compensation_may_imitate_is_not_found(floor):
    """What a spring of a joint leaves once it is compensated looks like masses of links."""
    found = explained(case_with(effect("leg_compliance", "hip", 1.5e-3)), floor)
    assert names(found) == [("leg_compliance", "hip")]


@pytest.mark.long
def test_zeros_of_each_log_are_no_effects(floor):
    zeros = (0.01, -0.015)
    cases = [
        case_with(effect("encoder_offset", "FL_thigh", zero), seed=k)
        for k, zero in enumerate(zeros)
    ]
    found = explained_together(cases, floor)
    assert not found.found
    alone = problem_of(cases[:1], np.ones(len(cases[0].motion.t), bool), several=True)
    runs, _ = zeros_beside(alone, floor.error, ())
    for run, zero in zip((*found.runs, *runs), (*zeros, zeros[0]), strict=True):
        one = next(z for z in run.zeros if z.effect.target == "FL_thigh")
        assert one.effect.name == "encoder_offset"
        assert one.effect.value == pytest.approx(zero, abs=1e-3)
        assert one.effect in run.compensated


@pytest.mark.long
def test_zeros_that_logs_seemed_to_have_vanish_with_the_effect_that_they_lacked(floor):
    longer = effect("link_length", "FR_calf", 0.006)
    found = explained_together([case_with(longer, seed=seed) for seed in (3, 4)], floor)
    assert names(found) == [("link_length", "FR_calf")]
    assert not any(run.compensated for run in found.runs)


def test_shocks_of_the_imu_and_of_torques_lose_weight_and_nothing_else_does(floor):
    case = case_with()
    known = linearise([case], (), all_keys(case))
    weight = interpolation_weights([case], known, floor.sigma)
    command = known.layout.of("command")
    others = np.setdiff1d(np.arange(6, weight.shape[1]), command)
    assert np.all(weight[:, others] == 1.0)
    # The robot stands before it walks.
    assert weight[:10, command].min() > 0.9
    assert weight[:, command].min() < 0.1
    quiet = (case.motion.standing.all(axis=1)).astype(float)
    bins = np.add.reduceat(quiet, case.motion.first) == case.motion.count
    assert np.median(weight[bins, :6]) > 0.4
    assert weight[:, 3:6].min() < 0.02
