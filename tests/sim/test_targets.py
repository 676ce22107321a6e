"""Targets: which parts of a machine an effect may be on, alone or several with one size."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from refusals import refused

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.effects import CATALOGUE, effect
from surefoot.sim.effects.base import groups, parts
from surefoot.sim.effects.catalogue import add
from surefoot.sim.effects.elastic import LegCompliance
from surefoot.sim.effects.readings import EncoderOffset
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.physics.scene import robot_spec
from surefoot.sim.robot import Robot
from surefoot.sim.robot.legs import find_legs
from surefoot.sim.robot.limbs import QUADRUPED, Limbs, limbs_by_name
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.walk import plan, walk

SPOT = Robot.load("spot_class")
SCENARIO = Scenario("tiny", (Segment(0.5, 0.2),), Ground(0.8), stand=0.2)
BIPED = Limbs(
    ("left", "right"),
    ("waist", "l_hip_yaw", "l_knee", "r_hip_yaw", "r_knee"),
    ((1, 2), (3, 4)),
    ("l_knee", "r_knee"),
)


@pytest.fixture(scope="module")
def log():
    return walk(SCENARIO, SPOT, 1)


def test_a_quadruped_has_the_groups_of_its_kinds_and_sides():
    of_joints = groups("joint", QUADRUPED)
    assert list(of_joints) == ["hip", "thigh", "calf", "left", "right", "all"]
    assert of_joints["thigh"] == ("FL_thigh", "FR_thigh", "RL_thigh", "RR_thigh")
    assert of_joints["left"] == tuple(j for j in QUADRUPED.joints if j[1] == "L")
    assert groups("leg", QUADRUPED)["rear"] == ("RL", "RR")
    assert list(groups("leg_link", QUADRUPED)) == ["thigh", "calf"]
    assert groups("leg_axis", QUADRUPED) == {}
    assert parts("leg_axis", QUADRUPED)[:4] == ("FL_x", "FL_y", "FL_z", "FR_x")


def test_other_machines_have_the_groups_that_they_can():
    assert list(groups("joint", BIPED)) == ["hip_yaw", "knee", "left", "right", "all"]
    assert groups("joint", BIPED)["hip_yaw"] == ("l_hip_yaw", "r_hip_yaw")
    assert groups("joint", BIPED)["all"] == BIPED.joints
    assert groups("leg", BIPED) == {"all": ("left", "right")}
    assert parts("leg_link", BIPED) == ("l_knee", "r_knee")
    arm, pendulum = limbs_by_name((), ("shoulder", "elbow")), limbs_by_name((), ("shoulder",))
    assert groups("joint", arm) == {"all": ("shoulder", "elbow")}
    assert groups("joint", pendulum) == {}
    assert parts("leg", arm) == ()


def test_a_target_is_of_the_machine_that_it_is_asked_of():
    assert LegCompliance.members_of("calf", QUADRUPED)[0] == "FL_calf"
    refused("unknown target 'calf'; known: waist", LegCompliance.members_of, "calf", BIPED)
    # Zeros of encoders are each joint's own: one for all makes no sense.
    refused("encoder_offset: unknown target 'calf'", EncoderOffset.members_of, "calf", QUADRUPED)
    with pytest.raises(SurefootError, match="unknown target 'FL_hop'; known: FL_hip"):
        plan(SCENARIO, SPOT, 0, [effect("encoder_offset", "FL_hop", 0.02)])


def test_a_sort_of_part_that_there_is_not_is_refused():
    class Typo(EncoderOffset):
        name = "typo"
        targets = "joints"  # pyright: ignore[reportAssignmentType]

    refused("a tuple of words or one of joint, link, link_axis", add, Typo)
    assert "typo" not in CATALOGUE


GROUPED = [
    (kind.name, target)
    for kind in CATALOGUE.values()
    for target in list(kind.group_targets(QUADRUPED))[:2]
]


@pytest.mark.parametrize(("name", "group"), GROUPED)
def test_a_group_is_its_members_one_after_the_other(log, name, group):
    """Injected and compensated alike: one size on each member."""
    kind = CATALOGUE[name]
    size = 10 * kind.traced.step
    whole, members = kind(group, size), kind.members_of(group, SPOT.limbs)
    assert len(members) > 1
    log_1, robot_1 = whole.compensate(log, SPOT)
    log_2, robot_2 = log, SPOT
    for member in members:
        log_2, robot_2 = kind(member, size).compensate(log_2, robot_2)
    assert_allclose(log_1.frame, log_2.frame, atol=1e-12)
    assert_allclose(robot_1.foot_radius, robot_2.foot_radius)
    for a, b in zip(robot_1.legs, robot_2.legs, strict=True):
        assert_allclose(a, b, atol=1e-12)
    injected = []
    for effects in ([whole], [kind(member, size) for member in members]):
        spec, radius = robot_spec(SPOT), SPOT.foot_radius
        for one in effects:
            one.edit_spec(spec, SPOT)
        model = spec.compile()
        tree = find_legs(model, "edited")
        injected.append((model.dof_damping, model.dof_armature, model.dof_frictionloss))
        injected[-1] += (tree.foot_radius - radius, *tree.constants)
    for a, b in zip(*injected, strict=True):
        assert_allclose(a, b, atol=1e-12)


@pytest.mark.parametrize("name", ["torque_scale", "backlash"])
def test_a_group_of_readings_is_on_its_members_alone(name):
    made = walk(SCENARIO, SPOT, 1, [effect(name, "thigh", 0.01)], declared=False)
    plain = walk(SCENARIO, SPOT, 1)
    apart = np.abs(made.q - plain.q).max(axis=0) + np.abs(made.tau - plain.tau).max(axis=0)
    assert [j for j, x in zip(SPOT.limbs.joints, apart, strict=True) if x] == list(
        CATALOGUE[name].members_of("thigh", SPOT.limbs)
    )
    assert replace(made.meta, effects=()) == plain.meta
