"""Regressors against the residual itself: one small effect at a time, on a walk."""

from dataclasses import replace

import numpy as np
import pytest
from own_package import found
from slopes import apart, regressor_of, slope_of, step_of, written_out

from surefoot.models.attribution.evidence import (
    _Linear,
    all_keys,
    linearise,
    log_under_model,
)
from surefoot.models.residuals.layout import layout_for
from surefoot.sim.effects import CATALOGUE, effect
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.robot import Robot
from surefoot.sim.robot.limbs import QUADRUPED
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.walk import walk

SPOT = Robot.load("spot_class")
SCENARIO = Scenario("short", (Segment(4.0, 0.5, 0.1, 0.3),), Ground(0.8))
CHAINED = [kind for kind in CATALOGUE.values() if kind.traced.chain_rule]


def one_of_each_kind(targets):
    """Of targets named <leg>_<kind>, one a kind, each of another leg; of others, all."""
    kinds = list(dict.fromkeys(target.split("_")[-1] for target in targets))
    alike = [[t for t in targets if t.split("_")[-1] == kind] for kind in kinds]
    return [group[k % len(group)] for k, group in enumerate(alike)]


KEYS = [
    (kind.name, target)
    for kind in CHAINED
    for target in one_of_each_kind(
        [t for t in kind.single_targets(QUADRUPED) if not kind.equals_another(t, SPOT)]
    )
    + list(kind.group_targets(QUADRUPED))[:1]
]


@pytest.fixture(scope="module")
def case():
    return log_under_model(walk(SCENARIO, SPOT, 7), SPOT)


@pytest.mark.parametrize("key", KEYS, ids=" ".join)
def test_a_regressor_by_the_chain_rule_is_the_slope_of_the_residual(case, key):
    assert key in all_keys(case)
    kind = CATALOGUE[key[0]]
    # A delay is not linear over its step, which is longer than a row of the log.
    step = kind.traced_at(key[1]).step * (1.0 if kind.unit == "s" else 1e-2)
    slope = slope_of(case, key, step)
    whole = regressor_of(case, key, slope)
    for name, columns in layout_for(QUADRUPED).channels.items():
        # What is left of two changes that cancel; and when feet move, which is for delays to say.
        if name in ("joint_rate", "contact_timing", "stance_displacement"):
            continue
        # Products of means over a bin are not quite the means of products.
        off = np.linalg.norm(whole[:, columns] - slope[:, columns])
        assert off <= 0.03 * np.linalg.norm(slope[:, columns]) + 1e-6 * np.linalg.norm(slope)


def test_ground_that_slopes_does_so_still_where_the_reference_is_moved(case):
    normal = np.tile([-0.1, 0.0, 1.0], (len(case.log.t), 1)) / np.hypot(1.0, 0.1)
    sloping = replace(case, motion=replace(case.motion, normal_G=normal))
    key = ("reference_delay", "all")
    slope = slope_of(sloping, key, CATALOGUE[key[0]].traced_at(key[1]).step)
    whole = regressor_of(sloping, key, slope)
    columns = layout_for(QUADRUPED).of("leg_velocity")
    np.testing.assert_allclose(whole[:, columns], slope[:, columns], atol=1e-9)


DIFFERENCED = [
    (kind.name, kind.single_targets(QUADRUPED)[-1])
    for kind in CATALOGUE.values()
    if kind.is_compensated() and kind.traced.by_search and not kind.traced.chain_rule
]


@pytest.mark.parametrize("key", DIFFERENCED, ids=" ".join)
def test_what_is_not_computed_again_is_the_same(case, key):
    """Channels that a change leaves as they are, and means of readings that a log keeps."""
    forgets = replace(case, log=replace(case.log))
    found = _Linear(case, ()).regressor(key)
    # By one of several sizes, where the residual is far from linear.
    slopes = [slope_of(forgets, key, x) for x in CATALOGUE[key[0]].starts_on(key[1], case.log)]
    if CATALOGUE[key[0]].traced.channels == ("contact_timing",):
        # Of contacts only the times count, not what more or fewer samples do to other channels.
        timing = layout_for(QUADRUPED).of("contact_timing")
        slopes = [np.where(np.isin(np.arange(x.shape[1]), timing), x, 0.0) for x in slopes]
    fitted = layout_for(QUADRUPED).fitted
    gaps = [
        np.abs(written_out(found, x) - x)[:, fitted].max() / np.abs(x[:, fitted]).max()
        for x in slopes
    ]
    assert min(gaps) < 1e-9


@pytest.mark.parametrize(
    "key", [("encoder_scale", "FL_thigh"), ("leg_compliance", "RR_calf"), ("leg_compliance", "all")]
)
def test_rates_that_were_not_logged_change_with_the_angles(case, key):
    log = case.log
    names = [name for name in log.frame if str(name).startswith(("dq_", "tau_"))]
    without = log_under_model(replace(log, frame=log.frame.drop(columns=names)), SPOT)
    slope = slope_of(without, key, step_of(key))
    whole = regressor_of(without, key, slope)
    for name in ("leg_velocity", "stance_velocity", "foot_height"):
        assert apart(whole, slope, layout_for(QUADRUPED).channels[name]) <= 0.05


def test_an_effect_of_readings_and_of_the_robot_has_the_slope_of_the_residual(case):
    """Its path was guessed by what changed: 126 % wrong on its leg, and zero on foot height."""
    key = ("rubber_boots", "all")
    with found("own_effect"):
        slope = slope_of(case, key, 1e-3)
        data = linearise([case], (), [key])
    whole = written_out(data.X[0], slope)
    layout = data.layout
    leg, height = layout.by_leg("leg_velocity")[0], layout.by_leg("foot_height")[0]
    assert np.linalg.norm(slope[:, height]) > 1.0
    for columns in (leg, height, layout.of("base_wrench")):
        assert apart(whole, slope, columns) <= 1e-6


def test_channels_that_no_fit_uses_have_no_regressors(case):
    moved = layout_for(QUADRUPED).of("stance_displacement")
    linear = _Linear(case, [effect("foot_rolling", "all", 0.004)])
    assert np.isfinite(linear.table[:, moved]).any()
    for key in (("rate_delay", "all"), ("mounting_rotation", "x"), ("foot_rolling", "all")):
        assert not np.isin(linear.regressor(key).columns, moved).any(), key
