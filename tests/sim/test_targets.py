"""Targets: which parts of a machine an effect may be on, alone or several with one size."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from refusals import refused

from surefoot.sim.effects import CATALOGUE, compensate_all, effect
from surefoot.sim.effects.base import Effect, groups, parts
from surefoot.sim.effects.catalogue import add
from surefoot.sim.effects.elastic import LegCompliance
from surefoot.sim.effects.readings import EncoderOffset
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.physics.scene import robot_spec
from surefoot.sim.robot import Robot
from surefoot.sim.robot.legs import find_legs
from surefoot.sim.robot.limbs import QUADRUPED, Limbs
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.sensors.streams import Reference, Streams
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
    arm, pendulum = Limbs((), ("shoulder", "elbow"), ()), Limbs((), ("shoulder",), ())
    assert groups("joint", arm) == {"all": ("shoulder", "elbow")}
    assert groups("joint", pendulum) == {}
    assert parts("leg", arm) == ()


def test_a_target_is_of_the_machine_that_it_is_asked_of():
    assert LegCompliance.members_of("calf", QUADRUPED)[0] == "FL_calf"
    refused("unknown target 'calf'; known: waist", LegCompliance.members_of, "calf", BIPED)
    # Zeros of encoders are each joint's own: one for all makes no sense.
    refused("encoder_offset: unknown target 'calf'", EncoderOffset.members_of, "calf", QUADRUPED)
    hop = [effect("encoder_offset", "FL_hop", 0.02)]
    refused("unknown target 'FL_hop'; known: FL_hip", plan, SCENARIO, SPOT, 0, hop)


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


def sized(name: str) -> Effect:
    """A tenth of the way to the upper bound, on the last single target: a foot's end of a leg."""
    kind = CATALOGUE[name]
    return effect(name, kind.single_targets(SPOT.limbs)[-1], 0.1 * kind.bounds[1])


EFFECTS = {n: sized(n) for n, kind in CATALOGUE.items() if kind.single_targets(SPOT.limbs)}
BODILY = [n for n in EFFECTS if type(EFFECTS[n]).edit_spec is not Effect.edit_spec]


def without_order(model) -> tuple:
    """What a compiled robot is, whatever the order of what was done to it."""
    legs = find_legs(model, "spot").constants
    numbers = (model.body_mass, model.dof_armature, model.jnt_stiffness, model.actuator_delay)
    return (
        *(np.round(part, 9) for part in (legs.offset, legs.foot, legs.rotation)),
        *(np.sort(np.round(part.ravel(), 9)) for part in numbers),
    )


@pytest.mark.parametrize("first", BODILY)
def test_a_robot_may_have_any_two_in_either_order(first):
    for second in BODILY[: BODILY.index(first) + 1]:
        built = []
        for names in ((first, second), (second, first)):
            spec = robot_spec(SPOT)
            for name in names:
                EFFECTS[name].edit_spec(spec, SPOT)
            built.append(spec.compile())
        one, other = map(without_order, built)
        # A leg that is turned and then longer is not quite one that is longer and then turned.
        exact = "link_length" not in names or "leg_heading" not in names
        for a, b in zip(one, other, strict=True):
            np.testing.assert_allclose(a, b, atol=1e-9 if exact else 1e-3)


@pytest.mark.parametrize("first", EFFECTS)
def test_streams_and_models_bear_any_other_effect_after_it(log, first):
    streams = (log.t, log.gyro, log.accel, log.q, log.dq, log.tau, log.tau_ff, log.force)
    seen = EFFECTS[first].alter_streams(Streams(*streams), SPOT)
    mounted = EFFECTS[first].alter_mounting(SPOT)
    truth = Reference(log.t, log.ref_R_GI, log.ref_p, log.ref_v)
    reference = EFFECTS[first].alter_reference(truth)
    after = compensate_all([EFFECTS[first]], log, SPOT)
    for second in EFFECTS.values():
        altered = vars(second.alter_streams(seen, SPOT))
        assert all(np.isfinite(part).all() for part in altered.values())
        assert np.isfinite(second.alter_mounting(mounted).p_BI).all()
        assert np.isfinite(second.alter_reference(reference).p_GI).all()
        known, robot = compensate_all([second], *after)
        assert np.isfinite(known.frame.to_numpy()).all(), second.name
        assert np.isfinite(robot.feet_I(known.q)).all()
