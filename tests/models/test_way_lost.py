"""Way that standing feet lose: the law and its size recovered, and taken off the readings."""

import numpy as np
import pytest
from creeping import LEG_SPEED, LOST, creeping

from surefoot.models.attribution.evidence import log_under_model
from surefoot.models.attribution.way_lost import way_lost
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.effects import compensate_all, effect
from surefoot.sim.effects.creep import way_by_feet, without_way
from surefoot.sim.robot import Robot
from surefoot.sim.robot.machine import machine_for_log


def case_of(log):
    return log_under_model(log, machine_for_log(log))


def path(log):
    return np.sum(np.linalg.norm(way_by_feet(log).step_I, axis=1))


def way_of_body(log):
    shown = way_by_feet(log).shown
    return np.sum(np.linalg.norm(np.diff(log.ref_p, axis=0, prepend=log.ref_p[:1])[shown], axis=1))


def test_the_feet_turn_as_far_as_the_body_if_they_do_not_yaw_and_not_at_all_if_they_stick():
    calm, wild = way_by_feet(creeping(0.2)), way_by_feet(creeping(0.4))
    # The mean of |cos| is 2 / pi, less without the rows of the exchanges, in which it is largest.
    expected = 0.3 * 2.0 / np.pi / LEG_SPEED
    assert calm.turned.sum() / calm.length.sum() == pytest.approx(expected, rel=0.05)
    assert wild.turned.sum() == pytest.approx(2.0 * calm.turned.sum(), rel=0.01)
    sticks = way_by_feet(creeping(0.4, sticks=True))
    assert sticks.turned.sum() < 0.02 * wild.turned.sum()


@pytest.mark.parametrize("swings", [(0.2,), (0.2, 0.4), (0.1, 0.2, 0.3, 0.4)])
def test_way_lost_by_turning_is_found_with_its_size(swings):
    (one,) = way_lost([case_of(creeping(swing)) for swing in swings]).found
    assert one.effect.name == "foot_scrub"
    assert one.effect.value == pytest.approx(LOST, rel=0.06)
    assert one.interval[0] < one.effect.value < one.interval[1]


@pytest.mark.parametrize("share", [-0.08, 0.06])
def test_a_share_of_the_way_is_found_where_turning_does_not_explain_it(share):
    logs = []
    for swing in (0.1, 0.2, 0.3, 0.4):
        mended, _ = compensate_all([effect("foot_scrub", "all", LOST)], creeping(swing), FEET)
        way = way_by_feet(mended)
        logs.append(without_way(mended, way, np.full(len(way.length), -share / (1.0 - share))))
    (one,) = way_lost([case_of(log) for log in logs]).found
    assert one.effect.name == "foot_creep"
    assert one.effect.value == pytest.approx(share, abs=0.015)


FEET = machine_for_log(creeping(0.2))


def test_the_compensated_feet_go_as_far_as_the_body():
    log = creeping(0.4)
    mended, _ = compensate_all([effect("foot_scrub", "all", LOST)], log, FEET)
    assert path(log) > 1.2 * way_of_body(log)
    assert path(mended) == pytest.approx(way_of_body(log), rel=0.04)
    # A foot lands where the log says.
    for leg in range(4):
        lands = np.flatnonzero(log.contact[1:, leg] & ~log.contact[:-1, leg]) + 1
        np.testing.assert_allclose(mended.foot_I[lands, leg], log.foot_I[lands, leg], atol=1e-12)


def test_feet_that_stick_lose_nothing():
    log = creeping(0.0)
    assert not way_lost([case_of(log)]).found
    assert not way_lost([]).found


@pytest.mark.parametrize("seed", [0, 1])
def test_a_body_that_steps_on_the_spot_shows_nothing(seed):
    """Noise alone turns the feet, and any size would seem to explain it."""
    log, rng = creeping(0.3), np.random.default_rng(seed)
    noise = {
        name: x[0] + (3e-2 if name.startswith("gyro") else 1e-3) * rng.normal(size=len(x))
        for name, x in log.columns.items()
        if name.startswith(("foot_", "gyro_", "ref_p"))
    }
    assert not way_lost([case_of(log.with_columns(noise))]).found


def test_an_effect_that_held_out_runs_contradict_is_not_found():
    loses, sticks = case_of(creeping(0.4)), case_of(creeping(0.0))
    turned = sticks.log.with_columns({"gyro_z": 0.4 * np.cos(4.0 * np.pi * sticks.log.t)})
    found = way_lost([loses], [case_of(turned)])
    assert not found.found
    assert "held-out" in found.notes[0]


@pytest.mark.parametrize("name", ["foot_creep", "foot_scrub"])
def test_a_robot_with_joints_has_no_such_effect(name):
    with pytest.raises(SurefootError, match=f"{name}: no part of this machine"):
        effect(name, "all", 0.1).members(Robot.load("spot_class").limbs)
