"""Legs that give: what springs do in MuJoCo, against what a model makes of the log."""

import mujoco
import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from synthetic import without

from surefoot.sim.effects import effect
from surefoot.sim.effects.elastic import _deflection
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.log import Log, Meta
from surefoot.sim.physics.drives import share_moved_at_once
from surefoot.sim.physics.loads import foot_loads_B, joint_loads
from surefoot.sim.physics.scene import build_world, robot_spec
from surefoot.sim.robot import Robot
from surefoot.sim.robot.kinematics import last_links
from surefoot.sim.robot.legs import find_legs
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.sensors.stances import inside_stances
from surefoot.sim.walk import SETTLING_TIME, plan, record, simulate_motion

GO1 = Robot.load("go1")
COURSE = Scenario("short", (Segment(3.0, 0.4, turn=0.3),), Ground(0.8), stand=0.3)


def walked(*one):
    """The log of a walk with an effect, and the motion behind it, row by row."""
    made = plan(COURSE, GO1, 3, [effect(*one)] if one else [])
    motion = simulate_motion(made.world, GO1, made.gait, made.course)
    return record(made, motion), motion.after(SETTLING_TIME)


def rms(x):
    return np.sqrt(np.mean(x**2, axis=0))


@pytest.fixture(scope="module")
def calves():
    return walked("leg_compliance", "calf", 2e-3)


def test_a_spring_gives_by_its_load_and_the_encoder_stays_with_the_motor(calves):
    log, motion = calves
    load, given = joint_loads(log, GO1)[:, 2::3], motion.give.q[1:, 2::3]
    sizes = -np.sum(load * given, axis=0) / np.sum(load**2, axis=0)
    assert_allclose(sizes, 2e-3, rtol=0.02)
    assert rms(given + 2e-3 * load).max() < 0.3 * rms(given).min()
    assert not motion.give.q[:, [0, 1]].any()
    assert_allclose(log.q[:, 2::3], motion.q[1:, 2::3], atol=4e-4)


@pytest.mark.parametrize("torques", [True, False])
def test_a_model_that_knows_the_spring_has_the_joints_angles_again(calves, torques):
    """Also by the balance of momentum alone, of a log without torques."""
    log, motion = calves
    log = log if torques else without(log, "tau_")
    known, _ = effect("leg_compliance", "calf", 2e-3).compensate(log, GO1)
    truth = motion.q[1:] + motion.give.q[1:]
    before, after = rms(log.q - truth), rms(known.q - truth)
    assert (after[2::3] < (0.25 if torques else 0.35) * before[2::3]).all()
    assert_allclose(known.q[:, :2], log.q[:, :2])


def test_how_fast_a_spring_gives_is_not_smoothed_away():
    """Of rates that a model adds too little of, springs would seem softer than they are."""
    t, w = 0.002 * np.arange(1000), 2 * np.pi * 10.0
    log = Log(pd.DataFrame({"t": t}), Meta(500.0))
    angle, rate = _deflection(log, np.sin(w * t)[:, None])
    assert_allclose(angle[:, 0], np.sin(w * t))
    amplitude = 2 * np.mean(rate[50:-50, 0] * np.cos(w * t[50:-50]))
    assert amplitude == pytest.approx(w, rel=0.03)  # a mean over 0.03 s leaves 0.86 of it


def test_rotor_and_damping_keep_the_rates_smooth(calves):
    """A massless motor would read q + tau / k: its rate is as rough as the torque's slope."""
    log, _ = calves
    massless = 2e-3 * np.diff(log.tau[:, 2::3], axis=0) * log.rate
    steps = np.diff(log.dq[:, 2::3], axis=0)
    assert np.sqrt(np.mean(steps**2)) < 0.5 * np.sqrt(np.mean(np.diff(massless, axis=0) ** 2))
    rigid, _ = walked()
    assert np.sqrt(np.mean(steps**2)) < 1.5 * np.sqrt(
        np.mean(np.diff(rigid.dq[:, 2::3], axis=0) ** 2)
    )


def test_truth_knows_that_elastic_legs_stand(calves):
    """Feet that only follow their springs do not slip."""
    log, _ = calves
    assert np.mean(log.slip > 0.05) < 0.01


def test_a_foot_gives_along_the_axes_that_it_says_and_by_its_load():
    log, motion = walked("foot_elasticity", "normal", 2e-5)
    inside = inside_stances(log.t, log.contact, 0.03, 0.03)
    R = last_links(GO1.legs, motion.q[1:])
    assert motion.give is not None
    given_B = np.einsum("nlij,nlj->nli", R, motion.give.foot[1:])
    known, _ = effect("foot_elasticity", "normal", 2e-5).compensate(log, GO1)
    moved_B = (GO1.feet_I(known.q) - GO1.feet_I(log.q)) @ GO1.R_BI.T
    along, taken = given_B[inside][:, 2], moved_B[inside][:, 2]
    assert np.sum(along * taken) / np.sum(taken**2) == pytest.approx(1.0, abs=0.1)
    assert rms(along - taken) < 0.3 * rms(along)
    # Upwards, by twenty millionths of a metre a newton.
    load = foot_loads_B(log, GO1)[inside][:, 2]
    assert np.sum(along * load) / np.sum(load**2) == pytest.approx(2e-5, rel=0.1)


def test_springs_in_series_add_up():
    spec = robot_spec(GO1)
    for target in ("FL_calf", "calf", "all"):
        effect("leg_compliance", target, 1e-3).edit_spec(spec, GO1)
    for _ in range(2):
        effect("foot_elasticity", "normal", 1e-5).edit_spec(spec, GO1)
    model = spec.compile()
    stiffness = [
        float(model.joint(f"{n}_joint_spring").stiffness[0]) for n in ("FL_calf", "FR_calf")
    ]
    assert_allclose(stiffness, [1 / 3e-3, 1 / 2e-3])
    assert float(model.joint("FL_foot_spring_z").stiffness[0]) == pytest.approx(5e4)
    legs = find_legs(model, "go1").constants
    assert_allclose(legs.offset, GO1.legs.offset, atol=1e-12)
    assert_allclose(legs.foot, GO1.legs.foot, atol=1e-12)


@pytest.mark.parametrize("robot", [GO1, Robot.load("spot_class")])
def test_a_foot_on_springs_has_sphere_and_mass_of_its_file(robot):
    bare, spec = robot_spec(robot).compile(), robot_spec(robot)
    effect("foot_elasticity", "tangential", 1e-5).edit_spec(spec, robot)
    model = spec.compile()
    assert model.ngeom == bare.ngeom
    assert (model.geom_contype > 0).sum() == (bare.geom_contype > 0).sum()
    found = []
    for one in (bare, model):
        data, M = mujoco.MjData(one), np.zeros((one.nv, one.nv))
        mujoco.mj_forward(one, data)
        mujoco.mj_fullM(one, data, M)
        of_joints = [one.joint(name).dofadr[0] for name in robot.joint_names]
        rigid = np.ix_([*range(6), *of_joints], [*range(6), *of_joints])
        found.append((data.site("sole_FL").xpos.copy(), M[rigid]))
    # It is where it was, and the leg weighs what it weighed.
    assert_allclose(found[1][0], found[0][0], atol=1e-12)
    assert_allclose(found[1][1], found[0][1], atol=1e-9)


def test_motors_move_at_once_what_stiff_springs_draw_along():
    def share(*one):
        spec = robot_spec(GO1)
        if one:
            effect(*one).edit_spec(spec, GO1)
        world = build_world(GO1, Ground(0.8), spec)
        return share_moved_at_once(world.model, world.springs, world.start, world.dof_adr)

    assert share() == share("foot_elasticity", "normal", 1e-5) == 1.0
    shares = [share("leg_compliance", "all", k) for k in (1e-9, 1e-6, 1e-3, 0.02)]
    assert shares == sorted(shares, reverse=True)
    assert shares[0] == pytest.approx(1.0, abs=1e-3)
    # Of a soft spring only the rotor is left: 0.01 of the 0.03 kg m^2 that a hip or thigh turns.
    assert 0.2 < shares[-1] < 0.5


def test_the_old_name_is_the_same_effect():
    assert effect("joint_compliance", "FL_calf", 1e-3) == effect("leg_compliance", "FL_calf", 1e-3)
