"""Traces of walks: friction, pushes, several walks, and what the filters' drift comes of."""

from dataclasses import replace

import numpy as np
import pytest
from pushes import pushed
from scipy.spatial.transform import Rotation
from synthetic import without
from warming import GyroWarming

from surefoot import Learnt, Robot, Scenario, walk
from surefoot.extend import (
    BIN,
    Ground,
    Segment,
    Trajectory,
    effect,
    reference,
)
from surefoot.models.attribution import forces
from surefoot.models.attribution.diagnose import diagnose, logs_under_model
from surefoot.models.attribution.evidence import linearise, log_under_model
from surefoot.models.attribution.noise_floor import FloorWalk
from surefoot.models.attribution.weights import RobustWeights
from surefoot.scenarios.trace import filters
from surefoot.scenarios.trace.run import TraceOptions, trace_logs
from surefoot.sim.scenario_catalog import scenario_file

ROBOT = Robot.load("spot_class")


GROUND = Ground(0.8)


ZIGZAG = (Segment(1.5, 0.4, lateral=0.15), Segment(1.5, 0.4, lateral=-0.15)) * 4


@pytest.fixture(scope="module")
def zigzag():
    return walk(Scenario("zigzag", ZIGZAG, GROUND), ROBOT, 0)


@pytest.fixture(scope="module")
def slipped():
    lost = effect("foot_slip", "all", 0.85)
    return walk(Scenario("zigzag", ZIGZAG, GROUND), ROBOT, 0, [lost], declared=False)


def friction(log) -> forces.FootFriction:
    cases = [log_under_model(log, ROBOT)]
    found = forces.estimate_friction(cases, np.random.default_rng(0))
    assert found is not None
    return found


def test_feet_that_slide_show_how_much_friction_is_lost(slipped):
    found = friction(slipped)
    assert found.limit == pytest.approx(0.12, rel=0.1)
    assert found.everywhere
    (one,) = forces.slip_effect(found)
    assert (one.effect.name, one.effect.value) == ("foot_slip", pytest.approx(0.85, abs=0.02))
    assert one.interval[0] - 0.01 < 0.85 < one.interval[1] + 0.01


def test_feet_that_hold_show_only_how_much_friction_there_is_at_least(zigzag):
    found = friction(zigzag)
    assert (found.limit, forces.slip_effect(found)) == (None, ())
    assert 0.05 < found.held < 0.8
    (note,) = forces.slip_notes(found, True)
    assert f"coefficient of friction of up to {found.held:.2f}" in note


def test_slides_on_two_patches_are_in_places():
    """Nine slides at one coefficient, spread over the walk; elsewhere feet hold with more."""
    found = friction(walk(Scenario.load(scenario_file("demo/walk")), ROBOT, 3))
    assert found.limit is not None
    assert found.limit == pytest.approx(0.1, rel=0.1)
    assert found.slides >= forces.FEWEST_SLIDES
    assert found.held > 1.5 * found.limit
    assert not found.everywhere
    assert forces.slip_effect(found) == ()
    assert sum(found.by_leg.values()) == found.slides
    (note,) = forces.slip_notes(found, True)
    assert all(f"{leg} {count}" in note for leg, count in found.by_leg.items())
    assert "in places; feet that did not slide" in note


@pytest.mark.parametrize(
    ("limit", "held", "scatter"), [(0.041, 0.136, 0.0), (0.12, 0.3, 0.0), (0.12, 0.12, 0.5)]
)
def test_slides_that_contradict_the_feet_that_stick_are_not_lost_friction(limit, held, scatter):
    """Feet of elastic legs, such as the Go1's, seem to slide at nothing; those of late joints while
    they push, at any share of their force."""
    interval = 0.92 * limit, 1.08 * limit
    odd = forces.FootFriction(limit, interval, 40, everywhere=True, held=held, scatter=scatter)
    assert forces.slip_effect(odd) == ()
    assert "may look like sliding" in forces.slip_notes(odd, True)[0]
    assert forces.slip_effect(replace(odd, held=1.09 * limit, scatter=0.0)) != ()


@pytest.mark.parametrize(
    "one", [("joint_delay", "all", -0.015), ("foot_rolling", "all", 0.05)], ids=["late", "rolls"]
)
def test_another_effect_is_not_taken_for_lost_friction(zigzag, one):
    altered, known = effect(*one).compensate(zigzag, ROBOT)
    found = forces.estimate_friction([log_under_model(altered, known)], np.random.default_rng(0))
    assert forces.slip_effect(found) == ()


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
    assert forces.slip_effect(forces.estimate_friction([case], np.random.default_rng(0))) == ()


@pytest.mark.long
def test_friction_is_that_with_the_effects_found_compensated():
    """Joints of a fast clock make seeming slides, which are gone once the clock is found."""
    fast = effect("clock_scale", "joints", 0.002)
    log = walk(Scenario("zigzag", ZIGZAG, GROUND), ROBOT, 0, [fast], declared=False)
    seeming, found = friction(log), diagnose([log], ROBOT)
    assert found.friction is not None
    assert seeming.slides >= forces.FEWEST_SLIDES
    assert [(e.name, e.target) for e in found.effects] == [("clock_scale", "joints")]
    assert found.friction.slides == 0


def test_without_torques_friction_is_not_identifiable(zigzag):
    cases = [log_under_model(without(zigzag, "tau_"), ROBOT)]
    assert forces.estimate_friction(cases, np.random.default_rng(0)) is None
    assert "without torques" in forces.slip_notes(None, True)[0]


def test_outside_forces_are_found_where_they_act(zigzag):
    for spans, there in (((), 0), (((4.0, 5.0), (10.0, 11.0)), 2)):
        log = pushed(zigzag, ROBOT, spans, (0.0, 25.0, -15.0)) if spans else zigzag
        case = log_under_model(log, ROBOT)
        known = linearise([case], (), ())
        found = forces.outside_forces([case], known.table, known, BIN)
        assert len(found) == there
        for push, (begin, end) in zip(found, spans, strict=True):
            assert push.force == pytest.approx(np.hypot(25.0, 15.0), rel=0.1)
            assert [push.begin, push.end] == pytest.approx([begin, end], abs=0.2)
        near = forces.pushed_bins([case], known, found).sum() * BIN
        assert near == pytest.approx(there * 1.9, abs=0.3)


def test_what_comes_with_every_stride_is_no_outside_force(zigzag):
    strong = effect("torque_scale", "thigh", -0.3).compensate(zigzag, ROBOT)[0]
    case = log_under_model(strong, ROBOT)
    known = linearise([case], (), ())
    assert np.nanstd(known.table[:, known.layout.of("base_wrench")[:3]]) > 5.0
    assert forces.outside_forces([case], known.table, known, BIN) == ()


def test_dead_reckoning_by_the_legs_is_among_the_filters(zigzag):
    truth = reference(zigzag)
    right = filters.drift(truth, filters.dead_reckoned(zigzag, ROBOT.feet))
    long_ago = effect("link_length", "thigh", 0.02).compensate(zigzag, ROBOT)[1]
    assert right < 0.02 < filters.drift(truth, filters.dead_reckoned(zigzag, long_ago.feet))


LONGER = effect("link_length", "FR_calf", 0.006)


ZEROS, LATE = (0.02, -0.015, 0.01), (0.0, 0.012, 0.006)


"""rad of FL's thigh, and s of the reference's clock, of each walk."""


PUSH = (5.0, 6.2)


"""s of the second walk."""


def walked(seed):
    per_run = [effect("encoder_offset", "FL_thigh", ZEROS[seed])]
    per_run += [effect("reference_delay", "all", LATE[seed])] if LATE[seed] else []
    log = walk(Scenario("zigzag", ZIGZAG, GROUND), ROBOT, seed, [LONGER, *per_run], declared=False)
    return pushed(log, ROBOT, [PUSH], (0.0, 30.0, -15.0)) if seed == 1 else log


COURSE = (Segment(5.0, 0.5), Segment(5.0, 0.4, turn=0.5), Segment(4.0, 0.5, turn=-0.4))


def test_an_effect_that_grows_with_time_is_explained_before_the_log_is_cut(log):
    warms = GyroWarming("x", 0.1)
    drifting, _ = GyroWarming("x", -0.1).compensate(log, ROBOT)
    (case,), (exact,) = (logs_under_model([one], ROBOT, ()) for one in (drifting, log))
    found = filters.before_and_after([case], [warms], Learnt(), 0.7)
    right = filters.before_and_after([exact], [], Learnt(), 0.7)
    assert [one.filter for one in found] == [one.filter for one in right]
    for one, other in zip(found, right, strict=True):
        right_rot = other.before.errors["ape_rot"]
        assert one.after.errors["ape_rot"] == pytest.approx(right_rot, rel=1e-6)
    imu = next(one for one in found if one.filter == "imu")
    assert imu.before.errors["ape_rot"] > 5 * imu.after.errors["ape_rot"]
    assert np.isfinite(imu.after.errors["ape_trans"])


def test_errors_that_simulated_walks_have_too_are_no_harm(zigzag):
    """An effect that is not there harms, unless a walk with the right model errs as much."""
    (case,), absent = logs_under_model([zigzag], ROBOT, ()), effect("link_length", "thigh", 0.02)
    none = np.zeros(0)
    weights = RobustWeights(none, none, none, 0.0, none)
    exact, erring = (FloorWalk(case, one, none, weights) for one in ((), (absent,)))
    harm = filters.harmful_to_filters([case], [absent], [exact])
    assert harm is not None
    assert harm[0] == absent
    assert filters.harmful_to_filters([case], [absent], [exact, erring]) is None
    assert filters.harmful_to_filters([case], [absent], []) == harm
    without = zigzag.frame[[c for c in zigzag.frame if not str(c).startswith("ref_")]]
    (blind,) = logs_under_model([replace(zigzag, frame=without)], ROBOT, ())
    blinds = [FloorWalk(blind, (), none, weights)]
    assert filters.harmful_to_filters([blind], [absent], blinds) is None  # they cannot tell


T = np.linspace(0.0, 10.0, 1001)


def ahead(x, climb=0.0, turn=0.0):
    """A trajectory through x [m] that climbs [m/s] and turns [rad/s]."""
    R_GI = Rotation.from_euler("z", (turn * T)[:, None]).as_matrix()
    zeros = np.zeros((len(T), 3))
    return Trajectory(T, R_GI, zeros, np.column_stack([x, 0 * T, climb * T]), zeros, zeros)


def test_who_sways_on_the_spot_has_no_drift_by_the_metre():
    away = 0.1 * T
    assert filters.drift(ahead(0.5 * T), ahead(0.5 * T + away)) == pytest.approx(0.2)
    swaying = ahead(0.01 * np.sin(T)), ahead(0.01 * np.sin(T) + away)
    assert np.isnan(filters.drift(*swaying))
    assert np.isnan(filters.drift_parts(*swaying)).all()


def test_each_cause_of_drift_is_charged_with_what_it_causes(log, robot):
    """A gyro that reads turns 2 % too large turns the estimate; a short shank sinks it."""
    turns = effect("gyro_scale", "z", 0.02)
    course = Scenario("seen", COURSE, GROUND)
    built = walk(course, robot, 4, effects=[turns, LONGER], declared=False)
    (case,), (exact,) = (logs_under_model([one], robot, ()) for one in (built, log))
    causes = filters.causes_of_drift([case], [turns, LONGER])
    assert causes is not None
    added = {one.name: part for one, part in causes.added}
    height, yaw = (np.array([abs(x[k]) for x in added.values()]) for k in (1, 2))
    assert list(added)[int(height.argmax())] == "link_length"
    assert list(added)[int(yaw.argmax())] == "gyro_scale"
    assert height.max() > 3.0 * height.min()
    assert yaw.max() > 3.0 * yaw.min()
    # Small effects add up to what the declared model drifts more than one that has them all.
    more = (causes.declared - causes.left)[1:]
    assert np.sum(list(added.values()), axis=0)[1:] == pytest.approx(more, rel=0.1, abs=1e-4)
    assert causes.added[0][1][0] > causes.added[1][1][0] > 0.0
    none = filters.causes_of_drift([exact], [effect("gyro_scale", "z", 0.0)])
    assert none is not None
    assert np.abs(causes.left - none.declared).max() < 0.2 * np.abs(causes.declared).max()


def test_a_drift_has_a_height_a_yaw_and_a_distance():
    found = filters.drift_parts(ahead(T), ahead(1.02 * T, 0.003, 0.01))
    assert found[1:] == pytest.approx([0.003, 0.01, 0.02], rel=1e-3)
    assert found[0] > np.hypot(0.02, 0.003)  # beside what the turn adds


def test_where_the_leg_filter_does_not_run_no_cause_is_named(log, robot):
    cases = logs_under_model([without(log, "contact")], robot, ())
    assert filters.causes_of_drift(cases, [effect("gyro_scale", "z", 0.02)]) is None
    assert filters.causes_of_drift(cases, []) is None


@pytest.mark.slow
def test_two_walks_share_a_size_and_have_zeros_and_a_clock_of_their_own():
    found = trace_logs([walked(0), walked(1)], ROBOT, TraceOptions(holdout=[walked(2)]))
    assert found.held_out is not None
    assert [(e.name, e.target) for e in found.effects] == [("link_length", "FR_calf")]
    assert found.effects[0].value == pytest.approx(0.006, abs=0.0015)
    (size,) = found.found
    assert size.interval[0] - 5e-4 < 0.006 < size.interval[1] + 5e-4
    for run, zero, lag in zip(found.runs, ZEROS, LATE, strict=False):
        sizes = {(z.effect.name, z.effect.target): z.effect.value for z in run.zeros}
        assert sizes["encoder_offset", "FL_thigh"] == pytest.approx(zero, abs=0.004)
        assert sizes.get(("reference_delay", "all"), 0.0) == pytest.approx(lag, abs=0.002)
    (note,) = [one for one in (*found.reasons, *found.notes) if "outside forces" in one]
    assert "of run 2" in note
    feet = found.held_out.channels["foot_height"]
    assert feet.after < 0.7 * feet.before
