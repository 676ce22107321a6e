"""A robot with two legs of six hinges, flat feet and a waist goes the way of a quadruped."""

import mujoco
import numpy as np
import pytest
from biped import biped, biped_log
from estimates import metrics_of
from refusals import refused
from synthetic import without
from written import written

from studies.measured import measured_folder
from surefoot import Robot, Scenario, import_log, run_filter, walk
from surefoot.extend import Ground, Segment, effect
from surefoot.models.attribution.sensor_noise import ReferenceSampling, resample_reference
from surefoot.scenarios.trace.run import trace_logs
from surefoot.sim.walking.imitation import walking_style


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    return biped(tmp_path_factory.mktemp("biped"))


@pytest.fixture(scope="module")
def log(robot):
    return biped_log(robot)


def test_its_legs_soles_and_joints_are_read(robot):
    assert robot.limbs.legs == ("left", "right")
    assert [len(chain) for chain in robot.limbs.chains] == [6, 6]
    assert robot.limbs.joints[3] == "left_knee"
    assert robot.limbs.joints[-1] == "waist"
    assert robot.foot_bodies == ("left_foot", "right_foot")
    np.testing.assert_allclose(robot.foot_places, [[0.03, 0.0, -0.08]] * 2, atol=1e-12)
    np.testing.assert_allclose(robot.sole, [[0.09, 0.05]] * 2, atol=1e-12)
    assert not robot.foot_radius.any()


def test_its_feet_are_where_mujoco_puts_them_and_move_as_differences_say(robot):
    model = robot.spec().compile()
    data = mujoco.MjData(model)
    q = np.random.default_rng(0).uniform(-0.6, 0.6, (5, len(robot.limbs.joints)))
    base = model.body(robot.base_name).id
    for row in q:
        for name, angle in zip(robot.joint_names, row, strict=True):
            data.qpos[model.joint(name).qposadr[0]] = angle
        mujoco.mj_kinematics(model, data)
        R, p = data.xmat[base].reshape(3, 3), data.xpos[base]
        for leg, body in enumerate(robot.foot_bodies):
            at = model.body(body).id
            sole_G = data.xpos[at] + data.xmat[at].reshape(3, 3) @ robot.foot_places[leg]
            sole_I = robot.R_BI.T @ (R.T @ (sole_G - p) - robot.p_BI)
            np.testing.assert_allclose(robot.feet_I(row[None])[0, leg], sole_I, atol=1e-9)
    J = robot.feet_jacobian_I(q)
    assert J.shape == (5, 2, 3, 6)
    for leg, chain in enumerate(robot.limbs.chains):
        for j, joint in enumerate(chain):
            step = 1e-6 * np.eye(q.shape[1])[joint]
            slope = (robot.feet_I(q + step) - robot.feet_I(q - step))[:, leg] / 2e-6
            np.testing.assert_allclose(J[:, leg, :, j], slope, atol=1e-8)


def test_the_leg_filter_follows_it(robot, log):
    known = Robot.for_log(log)
    leg, imu = (metrics_of(name, log, known) for name in ("leg", "imu"))
    assert leg.ape_trans < 0.01 < 0.1 < imu.ape_trans
    assert leg.nees_position < 6.0


def test_columns_in_another_order_are_the_same_robot(robot, log):
    frame = log.frame[list(log.frame.columns[::-1])]
    other = Robot.for_log(type(log)(frame, log.meta, log.name))
    shuffled = type(log)(frame, log.meta, log.name)
    assert other.limbs.legs == ("right", "left")
    np.testing.assert_allclose(
        other.feet_I(shuffled.q)[:, ::-1], robot.feet_I(log.q), rtol=0, atol=1e-15
    )
    without = frame.drop(columns=["q_waist", "dq_waist"])
    np.testing.assert_array_equal(
        Robot.for_log(type(log)(without, log.meta, "x")).feet_I(log.q[:, -2::-1]),
        other.feet_I(shuffled.q),
    )
    lacking = type(log)(frame.drop(columns=["q_left_knee", "dq_left_knee"]), log.meta, "x")
    refused("x: the log of biped lacks q_left_knee", Robot.for_log, lacking)


@pytest.mark.parametrize(
    ("name", "target", "size"),
    [
        ("encoder_offset", "left_knee", 0.02),
        pytest.param("link_length", "right_knee", 0.01, marks=pytest.mark.long),
    ],
)
def test_what_one_of_its_legs_lacks_is_traced(robot, log, name, target, size):
    one = effect(name, target, size)
    if name == "encoder_offset":
        made = biped_log(robot, **{target: size})
    else:
        made = biped_log(robot, built=one.compensate(log, robot)[1])
    found = trace_logs([made], Robot.for_log(made))
    assert [(e.name, e.target) for e in found.effects] == [(name, target)]
    assert found.effects[0].value == pytest.approx(size, rel=0.02)


def test_it_lacks_nothing_as_declared(log):
    assert trace_logs([log], Robot.for_log(log)).effects == ()


def test_the_noise_of_its_reference_is_no_effect(robot, log):
    """A low-pass of the IMU would be fitted to it, since no simulated walk shows its size."""
    sampling = ReferenceSampling((0.0007, *[0.01] * 500), 5e-4, 2e-3)
    seen = resample_reference(without(log, "ref_v_"), sampling, np.random.default_rng(3))
    found = trace_logs([seen], robot)
    assert found.effects == (), found.verdict


def test_it_does_not_walk_in_simulation_nor_is_its_walk_imitated(robot, log):
    scenario = Scenario("tiny", (Segment(0.5, 0.2),), Ground(0.8))
    refused("only quadrupeds of three hinges a leg walk", walk, scenario, robot, 0)
    refused("only quadrupeds of three hinges a leg walk", walking_style, log, robot)


SHIN = """<body name="{s}_shin" pos="0 {y} 0"><joint name="{s}_hip" axis="0 1 0"
actuatorfrcrange="-30 30"/><inertial pos="0 0 0" mass="1" diaginertia=".1 .1 .1"/>
<body name="{s}_toe" pos="0 0 -.4"/></body>"""


def test_feet_are_named_where_no_shape_says(tmp_path):
    legs = "".join(SHIN.format(s=side, y=y) for side, y in (("a", -0.1), ("b", 0.1)))
    trunk = '<freejoint/><inertial pos="0 0 0" mass="7" diaginertia=".1 .1 .1"/>'
    text = f'<mujoco><worldbody><body name="trunk">{trunk}{legs}</body></worldbody></mujoco>'
    path = written(tmp_path / "bare.xml", text)
    refused("name the feet in the map", Robot.load, path)
    bare = Robot.load(path, feet={"one": "b_toe", "other": "a_toe"})
    assert bare.limbs.legs == ("one", "other")
    assert bare.mass == pytest.approx(9.0)
    np.testing.assert_allclose(bare.torque_limit, 30.0)
    np.testing.assert_allclose(bare.feet_I(np.zeros((1, 2)))[0], [[0, 0.1, -0.4], [0, -0.1, -0.4]])
    refused("no body or site 'heel'", Robot.load, path, feet={"one": "heel"})


RECORDING = measured_folder() / "icub_biped" / "walking.mat"


@pytest.mark.skipif(not RECORDING.is_file(), reason=f"the measured walk is not here ({RECORDING})")
def test_the_leg_filter_follows_a_metre_to_five_centimetres():
    log = import_log(RECORDING, "icub_biped")
    found = run_filter("leg", log, Robot.for_log(log))
    assert found.metrics is not None
    assert found.metrics.rpe_trans < 0.05
    assert found.metrics.ape_trans < 0.05
    assert not found.health.lost
