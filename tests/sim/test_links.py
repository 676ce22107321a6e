"""Links that are not as their file says: MuJoCo's edited bodies against what a model knows."""

from types import SimpleNamespace
from typing import cast

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose
from refusals import refused

from surefoot.sim.effects import CATALOGUE, effect
from surefoot.sim.log import Log
from surefoot.sim.physics.scene import robot_spec
from surefoot.sim.robot import Robot
from surefoot.sim.robot.kinematics import feet
from surefoot.sim.robot.legs import LEGS, find_legs
from surefoot.sim.robot.limbs import Limbs

SPOT = Robot.load("spot_class")
LOG = cast(Log, SimpleNamespace())
"""These effects are of the robot alone and read no log."""


@pytest.mark.parametrize(
    ("name", "target"),
    [
        *(("leg_heading", target) for target in ("FL_z", "RR_x", "FR_y")),
        *(("link_length", f"{leg}_{link}") for leg in LEGS for link in ("thigh", "calf")),
        ("hip_offset", "RL_y"),
    ],
)
def test_an_altered_leg_has_the_feet_of_the_compiled_model(name, target):
    """Two roads to the same leg: MuJoCo's edited bodies, and the constants that a filter uses."""
    spec, one = robot_spec(SPOT), effect(name, target, 0.02)
    one.edit_spec(spec, SPOT)
    q = SPOT.q_home + np.random.default_rng(1).normal(0, 0.3, (20, 12))
    simulated = feet(find_legs(spec.compile(), "spot").constants, q, SPOT.R_BI, SPOT.p_BI)[0]
    _, known = one.compensate(LOG, SPOT)
    assert_allclose(known.feet_I(q), simulated, atol=1e-12)
    moved = np.linalg.norm(simulated - SPOT.feet_I(q), axis=2)
    leg = LEGS.index(target[:2])
    if name != "leg_heading":
        assert_allclose(moved[:, leg], 0.02, atol=1e-12)
    assert moved[:, leg].max() > 2e-3
    assert_allclose(np.delete(moved, leg, axis=1), 0.0, atol=1e-12)


def test_a_leg_whose_file_gives_angles_is_turned_too():
    """MuJoCo takes angles before a quaternion."""
    spec = robot_spec(SPOT)
    spec.joint("FL_hip").parent.alt.type = mujoco.mjtOrientation.mjORIENTATION_EULER
    effect("leg_heading", "FL_z", 0.05).edit_spec(spec, SPOT)
    found = feet(
        find_legs(spec.compile(), "spot").constants, SPOT.q_home[None], SPOT.R_BI, SPOT.p_BI
    )
    _, known = effect("leg_heading", "FL_z", 0.05).compensate(LOG, SPOT)
    assert_allclose(known.feet_I(SPOT.q_home[None]), found[0], atol=1e-9)


def test_a_leg_turned_about_its_hips_axis_is_an_error_of_the_hips_encoder():
    q = np.random.default_rng(0).uniform(-0.5, 0.5, (5, 12))
    kind = CATALOGUE["leg_heading"]
    for target in kind.single_targets(SPOT.limbs):
        _, turned = effect("leg_heading", target, 0.05).compensate(LOG, SPOT)
        wrong = q.copy()
        wrong[:, SPOT.limbs.joints.index(f"{target[:2]}_hip")] += 0.05
        there, by_encoder = turned.feet_I(q), SPOT.feet_I(wrong)
        assert kind.equals_another(target, SPOT) == np.allclose(
            there, by_encoder, rtol=0, atol=1e-9
        )
        assert kind.equals_another(target, SPOT) == target.endswith("x")


@pytest.mark.parametrize(
    ("name", "target", "least", "most", "of_legs"),
    [
        ("link_mass", "FL_thigh", -20.0, 200.0, -0.5),  # a fifth of the thigh
        ("link_com", "FL_thigh_z", -0.5, 0.5, -0.1),  # a third of its length
        ("link_inertia", "FL_calf", -20.0, 20.0, 0.0),
    ],
)
def test_what_a_file_may_say_of_a_link_and_up_to_which_size_it_is_looked_for(
    name, target, least, most, of_legs
):
    """A bound is part of the file's format: what was written at it must stay of use. Parts of legs
    are off by less than a gantry's."""
    for value in (least, most):
        one = effect(name, target, value)
        assert one.value == value
        assert len(one.compensate(LOG, SPOT)[1].extras.links) == 1
    for value in (least - 0.01, most + 0.01):
        refused(name, effect, name, target, value)
    kind = CATALOGUE[name]
    assert kind.bounds_on(SPOT.limbs, target)[0] == of_legs
    assert kind.bounds_on(Limbs((), ("slide", "lift"), ()))[0] <= 5.0 * of_legs


@pytest.mark.parametrize(
    ("name", "less", "unit"), [("link_mass", -15.0, "kg"), ("link_inertia", -10.0, "kg m")]
)
def test_a_link_cannot_lose_more_than_it_has(name, less, unit):
    one = effect(name, "FL_calf", less)
    refused(rf"the link of FL_calf has only .* {unit}", one.edit_spec, robot_spec(SPOT), SPOT)


def test_the_largest_moment_of_a_link_stays_at_most_the_sum_of_the_others():
    spec = robot_spec(SPOT)
    least, middle, most = np.sort(spec.compile().body(spec.joint("FL_calf").parent.name).inertia)
    spare = least + middle - most
    assert 0.0 < spare < least
    effect("link_inertia", "FL_calf", -0.99 * spare).edit_spec(spec, SPOT)
    assert spec.compile() is not None
    more = effect("link_inertia", "FL_calf", -1.01 * spare)
    refused("cannot be taken", more.edit_spec, robot_spec(SPOT), SPOT)


def test_inertias_that_logs_show_are_no_bound():
    """Less than 1e-3 kg m^2 of a calf is seen; a size at its bound is never found."""
    for name in ("link_inertia", "armature"):
        assert CATALOGUE[name].interior_bounds("FL_calf")[0] < 1e-4
