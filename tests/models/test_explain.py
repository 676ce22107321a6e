"""Searches that explain a residual: what is found, what harms nothing, and what bends."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from reference_columns import reference_columns
from scipy.integrate import cumulative_trapezoid
from scipy.spatial.transform import Rotation

from studies.blind.outside_effects import OUTSIDE_EFFECTS
from surefoot.models.attribution.data import split_of
from surefoot.models.attribution.design import without_nuisance
from surefoot.models.attribution.evidence import all_keys, linearise, log_under_model
from surefoot.models.attribution.explain import (
    Chosen,
    deviation_of_mean,
    explain,
    problem_of,
    zeros_beside,
)
from surefoot.models.attribution.judgement import (
    Unseen,
    channel_levels,
    find_harmful_effect,
    residuals_with,
)
from surefoot.models.attribution.metric import interpolation_weights, metric_of
from surefoot.models.attribution.noise_floor import left_deviations, noise_floor, noise_floor_with
from surefoot.models.attribution.unexplained import angle_curves, curved_angles
from surefoot.models.attribution.weights import robust_weights
from surefoot.sim.effects import effect
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.walk import walk

SPOT = Robot.load("spot_class")


SCENARIO = Scenario("short", (Segment(12.0, 0.6, 0.1, 0.3),), Ground(0.8))


def case_with(*effects, seed=3, course=SCENARIO):
    return log_under_model(walk(course, SPOT, seed, effects, declared=False), SPOT)


@pytest.fixture(scope="module")
def floor():
    return noise_floor([case_with()])


def explained(cases, floor):
    cases = cases if isinstance(cases, list) else [cases]
    problem = problem_of(cases, split_of(cases).fit, several=len(cases) > 1)
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
@pytest.mark.parametrize("name", ["imu_delay", "reference_delay"])
@pytest.mark.parametrize("delay", [0.001, pytest.param(0.01, marks=pytest.mark.long)])
def test_of_two_streams_the_lagging_one_is_named(floor, name, delay):
    found = explained(case_with(effect(name, "all", delay)), floor)
    assert names(found) == [(name, "all")]
    # Interpolation draws a delay towards the middle between rows: here by a tenth of one at most.
    assert found.found[0].effect.value == pytest.approx(delay, abs=2e-4)
    assert not found.rivals


@pytest.mark.long
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


@pytest.mark.long
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
    of_links = [why for one, why in found.dropped if one.name.startswith("link_")]
    assert of_links, [one for one, _ in (*found.dropped, *found.rejected)]


@pytest.mark.long
def test_zeros_of_each_log_are_no_effects(floor):
    zeros = (0.01, -0.015)
    cases = [
        case_with(effect("encoder_offset", "FL_thigh", zero), seed=k)
        for k, zero in enumerate(zeros)
    ]
    found = explained(cases, floor)
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
    found = explained([case_with(longer, seed=seed) for seed in (3, 4)], floor)
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


COURSE = Scenario("there", (Segment(10.0, 0.5, turn=0.3), Segment(10.0, 0.6)), Ground(0.8))


def found(one):
    case = case_with(one, course=COURSE)
    result = explained(case, noise_floor([case]))
    return result, curved_angles(result, [case])


@pytest.mark.long
def test_a_curve_is_told_from_the_line_that_comes_nearest():
    result, bent = found(OUTSIDE_EFFECTS["encoder_eccentricity"]("FL_thigh", 0.03))
    assert result.found, "something of the catalogue comes near"
    assert [(one.column, one.channel) for one in bent[:1]] == [("FL_thigh", "leg_velocity")]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "size"), [("encoder_scale", 0.03), ("leg_compliance", 1e-3)])
def test_what_the_catalogue_has_is_no_curve(name, size):
    result, bent = found(effect(name, "FL_thigh", size))
    assert [f.effect.name for f in result.found] == [name]
    assert bent == ()


def test_bends_leave_out_what_an_offset_and_a_scale_can_do():
    log = walk(replace(COURSE, segments=(Segment(1.0, 0.5),)), SPOT, 3)
    q = log.frame["q_FL_thigh"].to_numpy()
    even = np.linspace(q.min(), q.max(), 2001)
    for change in [*angle_curves(log, "FL_thigh").values()][:5]:
        curve = np.interp(even, np.sort(q), change["q_FL_thigh"][np.argsort(q)])
        line = np.polynomial.Legendre.fit(even, curve, 1)
        assert np.abs(line.coef).max() < 0.05


TRUTH = effect("imu_position", "x", 0.04)


@pytest.fixture(scope="module")
def case():
    return case_with(TRUTH)


@pytest.fixture(scope="module")
def floor_harm(case):
    return noise_floor([case])


def sides(case, floor_harm, *effects):
    known, split = linearise([case], effects, all_keys(case)), split_of([case])
    metric = metric_of([case], known, floor_harm.error, split.fit)
    problem = problem_of([case], split.fit, False)
    return residuals_with(problem, effects, metric, floor_harm, split.fit), split.report


def found_harm(case, floor_harm, *effects):
    residuals, report = sides(case, floor_harm, *effects)
    return find_harmful_effect([Unseen(residuals, report, {"unseen bins": report})])


def test_what_is_there_harms_nothing(case, floor_harm):
    assert found_harm(case, floor_harm, TRUTH) is None


def test_what_is_not_there_is_left_out_and_the_truth_is_kept(case, floor_harm):
    wrong = effect("encoder_offset", "FL_thigh", 0.02)
    harm = found_harm(case, floor_harm, TRUTH, wrong)
    assert harm is not None
    one, why = harm
    assert one == wrong
    assert "worse" in why


def test_what_more_likely_adds_to_what_no_fit_has_seen_is_left_out(case, floor_harm):
    """Of a small error either way, at least one sign does not help."""
    small = [effect("encoder_offset", "FL_thigh", size) for size in (1e-4, -1e-4)]
    alone = [found_harm(case, floor_harm, TRUTH, one) for one in small]
    left_out = [harm[0] for harm in alone if harm]
    assert left_out
    assert {*left_out} <= {*small}


def test_a_channel_is_worse_without_what_is_there_and_not_without_what_is_not(case, floor_harm):
    def worse(effects, instead):
        residuals, report = sides(case, floor_harm, *effects)
        return replace(residuals, before=residuals.left_by(instead)).worse(report)

    wrong = effect("encoder_offset", "FL_thigh", 0.02)
    assert worse((), (TRUTH,))
    assert not worse((TRUTH,), (TRUTH, wrong))


def test_bins_that_were_not_there_before_do_no_harm(case, floor_harm):
    """Undone late touch-downs leave whole stances, which the log as it is has not."""
    known = linearise([case], (), ())
    weights = robust_weights(known, floor_harm.sigma)
    everywhere = np.ones(len(known.t), dtype=bool)
    before = without_nuisance(known, weights.sigma, weights.weight, everywhere)
    first = slice(None, len(before) // 2), known.layout.of("leg_velocity")
    after = before.copy()
    after[first] *= 20.0
    levels = channel_levels(before, after, known, floor_harm)
    assert levels["leg_velocity"].worse
    before[first] = np.nan
    levels = channel_levels(before, after, known, floor_harm)
    assert levels["leg_velocity"].after > 1.1 * levels["leg_velocity"].before
    assert not levels["leg_velocity"].worse


def test_effects_on_which_channels_disagree_are_not_found(floor, monkeypatch):
    case = case_with(effect("gyro_scale", "z", 0.03))
    assert ("gyro_scale", "z") in names(explained(case, floor))
    monkeypatch.setattr(Chosen, "between_channels", property(lambda self: np.abs(self.sizes)))
    assert not explained(case, floor).found


def test_each_channel_tells_a_size_by_itself(floor):
    """A body whose gyro and reference turn by 3 % more than its feet: the legs alone show a scale
    of the gyro.
    """
    more = 0.03
    log = walk(SCENARIO, SPOT, 3, [effect("gyro_scale", "z", more)], declared=False)
    yaw = np.unwrap(Rotation.from_quat(log.ref_q, scalar_first=True).as_euler("ZYX")[:, 0])
    turn = Rotation.from_rotvec(np.outer(more * (yaw - yaw[0]), [0.0, 0.0, 1.0]))
    v = turn.apply(log.ref_v)
    columns = reference_columns(
        (turn * Rotation.from_matrix(log.ref_R_GI)).as_matrix(),
        log.ref_p[0] + cumulative_trapezoid(v, log.t, axis=0, initial=0.0),
        v,
    )
    case = log_under_model(log.with_columns(columns), SPOT)
    problem = problem_of([case], split_of([case]).fit, several=False)
    metric = zeros_beside(problem, floor.error, ())[1]
    place = 1 + metric.known.keys.index(("gyro_scale", "z"))
    told = {name: (one.S[0, place], one.S[place, place]) for name, one in metric.alone.items()}
    size = {name: pull / weight for name, (pull, weight) in told.items() if weight > 1e4}
    assert size["imu_gyro"] == pytest.approx(0.0, abs=1e-3)
    assert size["leg_velocity"] == pytest.approx(more, rel=0.2)
    assert size["stance_velocity"] == pytest.approx(more, rel=0.2)


@given(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=6), st.floats(0.01, 100.0))
def test_a_mean_is_as_unsure_as_its_values_differ(values, weight):
    """Of equal weights w: the variance of the values by Bessel's formula over n, and 1 / (n w) at
    least.
    """
    found, n = deviation_of_mean(np.array(values), np.full(len(values), weight)), len(values)
    expected = 1.0 / weight if n == 1 else max(1.0 / weight, np.var(values, ddof=1))
    assert found == pytest.approx(np.sqrt(expected / n), rel=1e-6)
