"""Inverse dynamics against MuJoCo's own, also of legs that are not where their file has them."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from surefoot.sim.effects import effect
from surefoot.sim.robot import Robot
from surefoot.sim.robot.body_changes import LinkChange
from surefoot.sim.robot.inverse_dynamics import BodyChanges, dynamics_of


@pytest.mark.parametrize(("joint", "name", "target"), [
    (3, "hip_offset", "FR_y"), (6, "hip_offset", "RL_z"), (2, "link_length", "FL_thigh"),
    (0, "leg_heading", "FL_z"), (9, "leg_heading", "RR_x"),
])  # fmt: skip
def test_a_leg_takes_its_masses_along(joint, name, target):
    robot = Robot.load("spot_class")
    one = effect(name, target, 0.02)
    spec = robot.spec()
    one.edit_spec(spec, robot)
    edited = spec.compile()
    known = one.compensate(None, robot)[1]  # type: ignore[arg-type]
    moved = np.abs(known.legs.offset - robot.legs.offset).sum(axis=2)
    moved += np.abs(known.legs.rotation - robot.legs.rotation).sum(axis=(2, 3))
    assert np.flatnonzero(moved).tolist() == [joint]

    rng = np.random.default_rng(3)
    q = robot.q_home + 0.3 * rng.standard_normal((4, 12))
    dq, ddq = rng.standard_normal((2, 4, 12))
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
    # Nothing stays behind in the model.
    assert_array_equal(dynamics.inverse(q, dq, ddq, base)[0], before[0])


def test_slopes_skip_work_and_nothing_else():
    """What is not recomputed changes no bit of a difference."""
    robot, rng, step = Robot.load("spot_class"), np.random.default_rng(5), 1e-5
    motion = list(rng.standard_normal((3, 6, 12)))
    base, turn = rng.standard_normal((6, 9)), np.tile(np.eye(3), (12, 1, 1))
    shift = BodyChanges(np.zeros((12, 3)), 0.01 * rng.standard_normal((12, 3)), turn)
    dynamics = replace(robot.dynamics, changes=shift)
    before = dynamics.inverse(motion[0], motion[1], motion[2], base)
    slopes = dynamics.derivatives(motion[0], motion[1], motion[2], base, step)
    for kind in range(3):
        for joint in range(12):
            q, dq, ddq = (x + step * (k == kind) * np.eye(12)[joint] for k, x in enumerate(motion))
            after = dynamics.inverse(q, dq, ddq, base)
            for slope, there, here in zip(slopes, after, before, strict=True):
                assert_array_equal(slope[kind, joint], (there - here) / step)


@pytest.mark.parametrize("joint", [0, 2, 7])
def test_derivatives_by_a_links_inertia(joint):
    robot, rng, step = Robot.load("spot_class"), np.random.default_rng(5), 1e-6
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
    dynamics, rng = dynamics_of(file, ("a", "b", "c")), np.random.default_rng(11)
    q, dq, ddq = rng.standard_normal((3, 50, 3)) * [[[1.0]], [[scale]], [[scale]]]
    _, torque = dynamics.inverse(q, dq, ddq)
    data = mujoco.MjData(dynamics.model)
    for k in range(50):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[k], dq[k], ddq[k]
        mujoco.mj_inverse(dynamics.model, data)
        assert_allclose(torque[k], data.qfrc_inverse, atol=1e-9)
    assert np.abs(torque).max() > 1.0
