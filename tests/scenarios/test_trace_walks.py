"""Friction, outside forces and filters of a trace, on short walks with known truth."""

from dataclasses import replace

import numpy as np
import pytest
from pushes import pushed

from surefoot.estimator.evaluation.trajectory import reference
from surefoot.models.attribution.diagnose import diagnose
from surefoot.models.attribution.evidence import linearise, log_under_model
from surefoot.models.attribution.forces import (
    FEWEST_SLIDES,
    FootFriction,
    estimate_friction,
    outside_forces,
    pushed_bins,
    slip_effect,
    slip_notes,
)
from surefoot.models.residuals.binning import BIN
from surefoot.scenarios.trace.filters import dead_reckoned, drift
from surefoot.sim.effects import effect
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.scenario_catalog import scenario_file
from surefoot.sim.walk import walk

ROBOT = Robot.load("spot_class")
GROUND = Ground(0.8)
ZIGZAG = (Segment(1.5, 0.4, lateral=0.15), Segment(1.5, 0.4, lateral=-0.15)) * 4


@pytest.fixture(scope="module")
def log():
    return walk(Scenario("zigzag", ZIGZAG, GROUND), ROBOT, 0)


@pytest.fixture(scope="module")
def slipped():
    lost = effect("foot_slip", "all", 0.85)
    return walk(Scenario("zigzag", ZIGZAG, GROUND), ROBOT, 0, [lost], declared=False)


def friction(log):
    return estimate_friction([log_under_model(log, ROBOT)], np.random.default_rng(0))


def test_feet_that_slide_show_how_much_friction_is_lost(slipped):
    found = friction(slipped)
    assert found is not None
    assert found.limit == pytest.approx(0.12, rel=0.1)
    assert found.everywhere
    (one,) = slip_effect(found)
    assert (one.effect.name, one.effect.value) == ("foot_slip", pytest.approx(0.85, abs=0.02))
    assert one.interval[0] - 0.01 < 0.85 < one.interval[1] + 0.01


def test_feet_that_hold_show_only_how_much_friction_there_is_at_least(log):
    found = friction(log)
    assert found is not None
    assert (found.limit, slip_effect(found)) == (None, ())
    assert 0.05 < found.held < 0.8
    (note,) = slip_notes(found, True)
    assert f"coefficient of friction of up to {found.held:.2f}" in note


def test_slides_in_one_place_are_no_loss_all_over():
    patched = FootFriction(0.12, (0.11, 0.13), slides=12, everywhere=False, held=0.2)
    assert slip_effect(patched) == ()
    (note,) = slip_notes(patched, True)
    assert note.endswith("in places; feet that did not slide used a coefficient of up to 0.20")


def test_slides_on_two_patches_are_in_places():
    """Nine slides at one coefficient, spread over the walk; elsewhere feet hold with more."""
    found = friction(walk(Scenario.load(scenario_file("demo/walk")), ROBOT, 3))
    assert found is not None
    assert found.limit is not None
    assert found.limit == pytest.approx(0.1, rel=0.1)
    assert found.slides >= FEWEST_SLIDES
    assert found.held > 1.5 * found.limit
    assert not found.everywhere
    (note,) = slip_notes(found, True)
    assert "in places; feet that did not slide" in note


def test_feet_that_hold_with_more_do_not_slide():
    """What elastic legs make of a walk of the Go1's model: feet that seem to slide at nothing."""
    elastic = FootFriction(0.041, (0.038, 0.044), slides=140, everywhere=True, held=0.136)
    assert slip_effect(elastic) == ()
    assert slip_effect(replace(elastic, held=0.045)) != ()


@pytest.mark.parametrize(("held", "scatter"), [(0.3, 0.0), (0.12, 0.5)])
def test_slides_that_contradict_the_feet_that_stick_are_not_lost_friction(held, scatter):
    """As a delay makes them: feet seem to move while they push, at any share of their force."""
    odd = FootFriction(0.12, (0.11, 0.13), 40, everywhere=True, held=held, scatter=scatter)
    assert slip_effect(odd) == ()
    assert "may look like sliding" in slip_notes(odd, True)[0]


@pytest.mark.parametrize(
    "one", [("joint_delay", "all", -0.015), ("foot_rolling", "all", 0.05)], ids=["late", "rolls"]
)
def test_another_effect_is_not_taken_for_lost_friction(log, one):
    altered, known = effect(*one).compensate(log, ROBOT)
    found = estimate_friction([log_under_model(altered, known)], np.random.default_rng(0))
    assert slip_effect(found) == ()


@pytest.mark.parametrize(
    ("robot", "one"),
    [
        ("spot_class", ("soft_ground", "all", 0.013)),
        ("v60_class", ("leg_compliance", "calf", 4e-4)),
    ],
    ids=["soft", "springs"],
)
def test_feet_that_yield_are_not_taken_for_lost_friction(robot, one):
    """Feet in soft ground creep, and springs let them move; neither is a slide at one friction."""
    robot, fault = Robot.load(robot), effect(*one)
    yields = walk(Scenario("zigzag", ZIGZAG, GROUND), robot, 0, [fault], declared=False)
    case = log_under_model(*fault.compensate(yields, robot))
    assert slip_effect(estimate_friction([case], np.random.default_rng(0))) == ()


@pytest.mark.long
def test_friction_is_that_with_the_effects_found_compensated():
    """Joints of a fast clock make seeming slides, which are gone once the clock is found."""
    fast = effect("clock_scale", "joints", 0.002)
    log = walk(Scenario("zigzag", ZIGZAG, GROUND), ROBOT, 0, [fast], declared=False)
    seeming, found = friction(log), diagnose([log], ROBOT)
    assert seeming is not None
    assert found.friction is not None
    assert seeming.slides >= FEWEST_SLIDES
    assert [(e.name, e.target) for e in found.effects] == [("clock_scale", "joints")]
    assert found.friction.slides == 0


def test_without_torques_friction_is_not_identifiable(log):
    bare = log.frame.drop(columns=[c for c in log.frame if str(c).startswith("tau_")])
    assert friction(replace(log, frame=bare)) is None
    assert "without torques" in slip_notes(None, True)[0]


def test_outside_forces_are_found_where_they_act(log):
    for spans, there in (((), 0), (((4.0, 5.0), (10.0, 11.0)), 2)):
        case = log_under_model(
            pushed(log, ROBOT, spans, (0.0, 25.0, -15.0)) if spans else log, ROBOT
        )
        known = linearise([case], (), ())
        found = outside_forces([case], known.table, known, BIN)
        assert len(found) == there
        for push, (begin, end) in zip(found, spans, strict=True):
            assert push.force == pytest.approx(np.hypot(25.0, 15.0), rel=0.1)
            assert (push.begin, push.end) == (
                pytest.approx(begin, abs=0.2),
                pytest.approx(end, abs=0.2),
            )
        near = pushed_bins([case], known, found).sum() * BIN
        assert near == pytest.approx(there * 1.9, abs=0.3)


def test_what_comes_with_every_stride_is_no_outside_force(log):
    strong = effect("torque_scale", "thigh", -0.3).compensate(log, ROBOT)[0]
    case = log_under_model(strong, ROBOT)
    known = linearise([case], (), ())
    assert np.nanstd(known.table[:, known.layout.of("base_wrench")[:3]]) > 5.0
    assert outside_forces([case], known.table, known, BIN) == ()


def test_dead_reckoning_by_the_legs_is_among_the_filters(log):
    truth = reference(log)
    right = drift(truth, dead_reckoned(log, ROBOT.feet))
    long_ago = effect("link_length", "thigh", 0.02).compensate(log, ROBOT)[1]
    assert right < 0.02 < drift(truth, dead_reckoned(log, long_ago.feet))
