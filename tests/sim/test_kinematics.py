"""Kinematics, inverse dynamics and the balance of momentum against MuJoCo and differences."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from refusals import refused
from synthetic import without

from surefoot.sim.common.gravity import GRAVITY_G
from surefoot.sim.effects import effect
from surefoot.sim.log.schema import named_columns
from surefoot.sim.physics.loads import momentum_balance
from surefoot.sim.robot import Robot
from surefoot.sim.robot.body_changes import LinkChange
from surefoot.sim.robot.inverse_dynamics import BodyChanges, dynamics_of


@pytest.mark.parametrize("name", ["spot_class", "v60_class"])
def test_foot_jacobians_are_the_derivatives_of_the_feet(name):
    robot = Robot.load(name)
    lower, upper = robot.joint_range.T
    q = np.random.default_rng(0).uniform(lower, upper, (50, 12))
    J = robot.feet_jacobian_I(q)
    e = 1e-6
    for joint in range(12):
        step = np.zeros(12)
        step[joint] = e
        slope = (robot.feet_I(q + step) - robot.feet_I(q - step)) / (2 * e)
        leg = joint // 3
        np.testing.assert_allclose(J[:, leg, :, joint % 3], slope[:, leg], atol=1e-8)
        others = np.delete(slope, leg, axis=1)
        np.testing.assert_allclose(others, 0.0, atol=1e-9)


def test_foot_rate_is_that_of_a_rigid_last_link(robot):
    """Of two points on one link: their relative velocity is rate x arm."""
    rng = np.random.default_rng(1)
    q, dq = rng.uniform(-0.5, 0.5, (20, 12)) + robot.q_home, rng.normal(size=(20, 12))
    longer = robot.legs._replace(foot=robot.legs.foot + rng.normal(size=(4, 3)))
    other = replace(robot, legs=longer)
    arm = other.feet_I(q) - robot.feet_I(q)
    e = 1e-6
    spread = [o.feet_I(q + e * dq) - o.feet_I(q - e * dq) for o in (other, robot)]
    relative = (spread[0] - spread[1]) / (2 * e)
    np.testing.assert_allclose(np.cross(robot.feet.rates_I(q, dq), arm), relative, atol=1e-7)


def test_joint_angles_of_another_shape_are_refused(robot):
    refused(r"\(N, 12\)", robot.feet_I, np.zeros(12), error=ValueError)


@pytest.mark.parametrize(
    ("name", "target", "value", "moves"),
    [
        ("hip_offset", "FR_y", 0.02, [3]),
        ("hip_offset", "RL_z", 0.02, [6]),
        ("link_length", "FL_thigh", 0.02, [2]),
        ("leg_heading", "FL_z", 0.02, [0]),
        ("leg_heading", "RR_x", 0.02, [9]),
        ("link_mass", "FL_calf", 0.2, []),
        ("link_mass", "thigh", -0.3, []),
        ("link_com", "RR_thigh_z", -0.03, []),
        ("link_com", "FR_hip_y", 0.02, []),
        ("link_inertia", "RL_calf", 0.02, []),
    ],
)
def test_what_a_leg_has_otherwise_is_in_the_inverse_dynamics(robot, name, target, value, moves):
    """Joints that are elsewhere take their masses along."""
    one = effect(name, target, value)
    spec = robot.spec()
    one.edit_spec(spec, robot)
    edited = spec.compile()
    known = one.compensate(None, robot)[1]  # type: ignore[arg-type]
    moved = np.abs(known.legs.offset - robot.legs.offset).sum(axis=2)
    moved += np.abs(known.legs.rotation - robot.legs.rotation).sum(axis=(2, 3))
    assert np.flatnonzero(moved).tolist() == moves

    rng = np.random.default_rng(3)
    q = robot.q_home + 0.3 * rng.standard_normal((4, 12))
    dq, ddq = rng.standard_normal((2, 4, 12)) * [[[3.0]], [[40.0]]]
    base = rng.standard_normal((4, 9))
    base[:, 8] += 9.8
    dynamics = robot.dynamics
    before = dynamics.inverse(q, dq, ddq, base)
    wrench, torque = known.dynamics.inverse(q, dq, ddq, base)

    data = mujoco.MjData(edited)
    edited.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    edited.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT
    at, dof = dynamics.qpos_adr, dynamics.dof_adr
    for k in range(4):
        data.qpos[:7], data.qpos[at], data.qvel[dof] = [0, 0, 0, 1, 0, 0, 0], q[k], dq[k]
        data.qacc[dof], data.qvel[3:6], data.qacc[3:6] = ddq[k], base[k, :3], base[k, 3:6]
        data.qvel[:3], data.qacc[:3] = 0.0, base[k, 6:] + edited.opt.gravity
        mujoco.mj_inverse(edited, data)
        assert_allclose(wrench[k], data.qfrc_inverse[:6], atol=1e-9)
        assert_allclose(torque[k], data.qfrc_inverse[dof], atol=1e-9)
    assert np.abs(wrench - before[0]).max() > 0.05
    at_rest = np.tile([*np.zeros(6), *-GRAVITY_G], (4, 1))
    assert_array_equal(dynamics.inverse(q, dq, ddq)[1], dynamics.inverse(q, dq, ddq, at_rest)[1])
    # Nothing stays behind in the model.
    assert_array_equal(dynamics.inverse(q, dq, ddq, base)[0], before[0])


def test_slopes_skip_work_and_nothing_else(robot):
    """What is not recomputed changes no bit of a difference."""
    rng, step = np.random.default_rng(5), 1e-5
    motion = list(rng.standard_normal((3, 6, 12)))
    base, legs = rng.standard_normal((6, 9)), robot.legs
    moved = legs._replace(offset=legs.offset + 0.01 * rng.standard_normal((4, 3, 3)))
    dynamics = replace(robot, legs=moved).dynamics
    before = dynamics.inverse(motion[0], motion[1], motion[2], base)
    slopes = dynamics.derivatives(motion[0], motion[1], motion[2], base, step)
    for kind in range(3):
        for joint in range(12):
            q, dq, ddq = (x + step * (k == kind) * np.eye(12)[joint] for k, x in enumerate(motion))
            after = dynamics.inverse(q, dq, ddq, base)
            for slope, there, here in zip(slopes, after, before, strict=True):
                assert_array_equal(slope[kind, joint], (there - here) / step)


@pytest.mark.parametrize("joint", [0, 2, 7])
def test_derivatives_by_a_links_inertia(robot, joint):
    rng, step = np.random.default_rng(5), 1e-6
    dynamics = robot.dynamics
    (q, dq, ddq), base = rng.standard_normal((3, 6, 12)), rng.standard_normal((6, 9))
    known = LinkChange(2, mass=0.1, com=(0.01, 0.0, 0.02), inertia=1e-3)
    changed = replace(dynamics, changes=BodyChanges(links=(known,)))
    found = changed.link_derivatives(q, dq, ddq, base)
    for kind, size in enumerate(step * np.eye(5)):
        change = LinkChange(joint, size[0], tuple(size[1:4]), size[4])
        there, here = (
            replace(dynamics, changes=BodyChanges(links=links)).inverse(q, dq, ddq, base)
            for links in ((known, change), (known,))
        )
        slopes = dynamics.parted(found[kind, joint].T)
        for slope, after, before in zip(slopes, there, here, strict=True):
            assert_allclose(slope, (after - before) / step, atol=2e-4)


@pytest.mark.parametrize("friction", ["", "solreffriction='0.01 1'", "solreffriction='-100 -5'"])
@pytest.mark.parametrize("scale", [1e-5, 1.0])  # sticking and sliding
def test_it_is_mujocos_with_everything_that_a_joint_may_have(tmp_path, friction, scale):
    file = tmp_path / "arm.xml"
    file.write_text(f"""<mujoco><worldbody><body>
      <joint name="a" axis="0 1 0" armature="0.02" damping="0.3" frictionloss="0.4" {friction}
        solimpfriction="0.8 0.95 0.001"/>
      <geom size="0.1" pos="0.3 0 0" mass="2"/>
      <body pos="0.5 0 0"><joint name="b" axis="0 1 1" stiffness="5" springref="20"/>
      <geom type="box" size="0.1 0.05 0.02" pos="0.1 0.02 0" mass="1"/>
      <body pos="0.3 0 0" gravcomp="0.5"><joint name="c" type="slide" frictionloss="0.2"/>
      <geom size="0.05" mass="0.5"/></body></body></body></worldbody>
      <tendon><fixed stiffness="3" damping="0.1"><joint joint="a" coef="1"/>
      <joint joint="b" coef="-1"/></fixed></tendon></mujoco>""")
    dynamics, rng = dynamics_of(file, ("a", "b", "c"), BodyChanges()), np.random.default_rng(11)
    q, dq, ddq = rng.standard_normal((3, 50, 3)) * [[[1.0]], [[scale]], [[scale]]]
    _, torque = dynamics.inverse(q, dq, ddq)
    data = mujoco.MjData(dynamics.model)
    for k in range(50):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[k], dq[k], ddq[k]
        mujoco.mj_inverse(dynamics.model, data)
        assert_allclose(torque[k], data.qfrc_inverse, atol=1e-9)
    assert np.abs(torque).max() > 1.0


def test_feet_carry_the_robot_and_nothing_in_the_air(log, robot):
    force = momentum_balance(log, robot).force
    assert_allclose(force[log.force == 0.0], 0.0)
    assert_allclose(momentum_balance(without(log, "force_"), robot).force[~log.contact], 0.0)
    carried = force[log.t - log.t[0] > 1.0].sum(axis=1).mean(axis=0)
    assert_allclose(carried[2], -GRAVITY_G[2] * robot.mass, rtol=0.05)
    assert np.all(np.abs(carried[:2]) < 0.1 * carried[2])


def test_feet_share_the_load_by_their_sensors_in_any_unit_before_they_count_as_standing(log, robot):
    """Of contacts that begin and end at half the load, as those of a pad that is read so."""
    half = 0.5 * np.median(log.force[log.contact])
    delayed = named_columns("contact", 1.0 * (log.force > half), log.legs)
    by_counts = named_columns("force", 7.0 + 3.0 * log.force, log.legs)
    seen = log.with_columns(delayed)
    up_B = log.ref_R_GI[:, 2] @ robot.R_BI.T
    walks = log.t - log.t[0] > 1.0

    def error(one):
        found = np.einsum("nli,ni->nl", momentum_balance(one, robot).force, up_B)
        return np.sqrt(np.mean((found - log.force)[walks] ** 2))

    assert error(seen) < 0.9 * error(without(seen, "force_"))
    in_counts = momentum_balance(seen.with_columns(by_counts), robot).force
    assert_allclose(in_counts, momentum_balance(seen, robot).force, atol=1e-6)
