"""Sizes measured on one robot, carried to another: what they do is a share of leg and stride."""

from dataclasses import replace

import numpy as np
import pytest
from refusals import refused

from surefoot.sim.effects import effect, known_effects
from surefoot.sim.effects.carry import DIMENSIONS, BodyScale, carried, scale_of
from surefoot.sim.gait.controller import gait_for
from surefoot.sim.robot import Robot

SMALL, LARGE = BodyScale(120.0, 0.42, 0.02, 0.5), BodyScale(480.0, 0.84, 0.05, 0.7)


def one(name, target, value, to=LARGE):
    return carried([effect(name, target, value)], SMALL, to)[0].value


def test_each_size_is_carried_by_its_dimension():
    give = one("joint_compliance", "all", 3e-3)  # by the same angle under the robot's own weight
    assert give * LARGE.weight * LARGE.leg_length == pytest.approx(3e-3 * 120.0 * 0.42)
    assert one("foot_rolling", "all", 0.02) == pytest.approx(0.05)  # by the foot, not by the leg
    assert one("hip_offset", "FL_x", 0.01) == pytest.approx(0.02)
    assert one("contact_delay", "liftoff", 0.02) == pytest.approx(0.028)
    assert one("encoder_offset", "FL_calf", 0.01) == 0.01
    assert one("gyro_bias", "x", 0.01) == 0.01
    assert one("payload", "all", 1.0) == pytest.approx(4.0)
    assert one("payload", "all", 20.0) == known_effects()["payload"].bounds[1]


def test_sizes_stay_within_the_bounds_of_legs():
    found = one("coulomb_friction", "FL_calf", 90.0)  # eight times as much is within a gantry's
    assert found == known_effects()["coulomb_friction"].traced.bounds_on_legs[1]


def test_to_itself_nothing_changes_and_there_and_back_is_where_one_was():
    effects = [effect("joint_compliance", "all", 2e-3), effect("contact_delay", "touchdown", 0.01)]
    assert carried(effects, SMALL, SMALL) == tuple(effects)
    back = carried(carried(effects, SMALL, LARGE), LARGE, SMALL)
    np.testing.assert_allclose([e.value for e in back], [e.value for e in effects])


def test_the_scale_is_the_robots_own_whatever_feet_are_declared():
    robot = Robot.load("spot_class")
    scale = scale_of(replace(robot, foot_radius=np.zeros(4)))
    assert scale.foot_radius == pytest.approx(robot.foot_radius.mean())
    assert scale.weight == pytest.approx(9.81 * robot.mass)
    assert scale.period == pytest.approx(gait_for(robot, 0.0).period)
    assert scale_of(robot, 0.9).period == 0.9


def test_every_unit_of_the_catalogue_has_a_rule(monkeypatch):
    assert not {kind.unit for kind in known_effects().values()} - set(DIMENSIONS)
    assert one("gyro_g_sensitivity", "x", 1e-4) == 1e-4  # an error of the IMU, not of the body
    monkeypatch.delitem(DIMENSIONS, "kg")
    refused("payload: no rule carries 'kg'", one, "payload", "all", 1.0)
