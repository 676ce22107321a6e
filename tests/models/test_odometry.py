"""Leg odometry in the observer: its kinematics are MuJoCo's; it carries over to other speeds."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
import torch
from synthetic import Body, synthetic_walk

from surefoot.models.observer.data import prepare
from surefoot.models.observer.network import Network
from surefoot.models.observer.observer import (
    Observer,
    ObserverError,
    check_inputs,
    observer_inputs,
)
from surefoot.models.observer.odometry import STILL, Kinematics, contact_points, leg_geometry
from surefoot.models.observer.predict import predict, prediction_errors
from surefoot.models.observer.samples import body_velocity, observer_samples
from surefoot.models.observer.settings import TrainSettings
from surefoot.models.observer.training import train
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.quaternion import matrix_from_quaternion
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot
from surefoot.sim.robot.legs import JOINTS, LEGS

ROBOT = Robot.load("spot_class")
PLAN = TrainSettings(steps=80, batch=10, every=40)


@pytest.fixture(scope="module")
def drawing():
    return leg_geometry(ROBOT, JOINTS)


def turned() -> Robot:
    """The robot with its IMU turned and moved."""
    axis = np.array([0.8, 0.1, -0.3, 0.5])
    R_BI = matrix_from_quaternion(axis / np.linalg.norm(axis))
    return replace(ROBOT, p_BI=np.array([0.1, -0.05, 0.2]), R_BI=R_BI)


@pytest.mark.parametrize("robot", [ROBOT, turned()])
def test_soles_are_mujocos(robot, drawing):
    """The point of the foot's body, a radius below its centre, moved by MuJoCo's own Jacobian."""
    model = robot.spec().compile()
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    q = robot.q_home + 0.3 * rng.standard_normal((20, 12))
    dq = rng.standard_normal((20, 12))
    found = contact_points(Kinematics.of(drawing, robot), q, dq, np.zeros((20, 3)))
    joints = [model.joint(name) for name in robot.joint_names]
    for k in range(len(q)):
        data.qpos[:7] = [0, 0, 0, 1, 0, 0, 0]
        rates = np.zeros(model.nv)
        for joint, angle, rate in zip(joints, q[k], dq[k], strict=True):
            data.qpos[joint.qposadr[0]], rates[joint.dofadr[0]] = angle, rate
        mujoco.mj_forward(model, data)
        for leg in range(4):
            body = model.body(robot.foot_bodies[leg]).id
            centre = data.xpos[body] + data.xmat[body].reshape(3, 3) @ robot.foot_places[leg]
            sole = centre - [0, 0, robot.foot_radius[leg]]
            J = np.zeros((3, model.nv))
            mujoco.mj_jac(model, data, J, None, sole, body)
            base = data.xpos[model.body(robot.base_name).id]
            place = robot.R_BI.T @ (sole - base - robot.p_BI)
            assert found[k, 3 * leg : 3 * leg + 3] == pytest.approx(place, abs=1e-9)
            velocity = robot.R_BI.T @ (J @ rates)
            assert found[k, 12 + 3 * leg : 15 + 3 * leg] == pytest.approx(velocity, abs=1e-9)


def test_a_foot_at_rest_says_how_the_imu_moves_while_the_base_turns(log, drawing):
    """On a simulated walk with turns: with the lever arm, standing feet say the true velocity."""
    known, true = Kinematics.of(drawing, ROBOT), body_velocity(log, np.arange(len(log.t)))[0]
    stands = log.contact & (log.slip > 0.0) & (log.slip < 0.02)  # of those that are loaded
    turning = np.abs(log.gyro[:, 2]) > 0.3
    errors = []
    for omega in (log.gyro, np.zeros_like(log.gyro)):
        u = contact_points(known, log.q, log.dq, omega)[:, 12:].reshape(-1, 4, 3)
        error = np.linalg.norm(-u - true[:, None], axis=2)
        errors.append(np.median(error[stands & turning[:, None]]))
    assert errors[0] < 0.03 < 0.1 < errors[1]


def test_an_untrained_network_is_plain_odometry(drawing):
    log = walk(3, 12)
    inputs = ("gyro", "contact", "feet")
    dataset = prepare([log], ROBOT, inputs)
    network = Network("mlp", 31, 3, 8, legs=4)
    network.initialise(torch.Generator().manual_seed(0))
    assert network.odometry is not None
    network.odometry.set_units(dataset.x_mean, dataset.x_scale, dataset.y_scale)
    v = network(dataset.logs[0].x[:, None])[:, 0].detach().numpy() * dataset.y_scale
    u = observer_inputs(inputs, Kinematics.of(drawing, ROBOT), observer_samples(log, inputs).x)[
        :, -12:
    ]
    assert v == pytest.approx(-u.reshape(-1, 4, 3).mean(axis=1), abs=1e-4)


def test_inputs_are_the_groups_of_the_log_in_their_order():
    log = walk(3, 12)
    inputs = check_inputs("feet,contact,accel,gyro,tau")
    assert inputs == ("tau", "gyro", "accel", "contact", "feet")
    kinematics = Kinematics.of(leg_geometry(ROBOT, log.joints), ROBOT)
    x = observer_inputs(inputs, kinematics, observer_samples(log, inputs).x)
    alone = {name: observer_samples(log, (name,)).x for name in inputs[:-1]}
    feet = ("gyro", "feet")
    alone["feet"] = observer_inputs(feet, kinematics, observer_samples(log, feet).x)[:, 3:]
    np.testing.assert_array_equal(x, np.hstack([alone[name] for name in inputs]))
    assert alone["tau"].any()
    assert alone["accel"].any()


@pytest.mark.parametrize(("speed", "share"), [(0.0, 0.0), (STILL, 0.5), (3.0 * STILL, 0.9)])
def test_corrections_fade_as_body_and_legs_come_to_rest_in_any_posture(speed, share):
    """With velocities of the soles that cancel, the output is the correction's share."""
    rng = np.random.default_rng(0)
    network = Network("mlp", 31, 9, 8, legs=4)
    network.initialise(torch.Generator().manual_seed(0))
    torch.nn.init.normal_(network.head.weight, generator=torch.Generator().manual_seed(1))
    assert network.odometry is not None
    mean, scale, unit = rng.normal(size=31), rng.uniform(0.5, 2.0, 31), np.array([0.5, 0.1, 0.05])
    network.odometry.set_units(mean, scale, unit)
    way = rng.normal(size=3)
    u = np.outer([1.0, -1.0, 1.0, -1.0], speed * way / np.linalg.norm(way)).ravel()
    postures = np.column_stack([rng.normal(size=(20, 19)), np.tile(u, (20, 1))])
    x = torch.from_numpy(((postures - mean) / scale).astype(np.float32))[:, None]
    outputs, features = network(x), network.body(x.clone())
    head = network.head(features)
    np.testing.assert_allclose(outputs[..., :3].detach(), share * head[..., :3].detach(), atol=2e-5)
    np.testing.assert_array_equal(outputs[..., 3:].detach(), head[..., 3:].detach())


@pytest.mark.parametrize("model", ["gru", "mlp", "tcn"])
@pytest.mark.parametrize("loss", ["mse", "gml"])
def test_the_loop_and_the_disk_give_the_whole_log(model, loss, tmp_path):
    log = walk(3, 12)
    plan = TrainSettings(steps=6, batch=2, every=3)
    inputs = "tau,gyro,accel,contact,feet"
    observer = train(log, settings=replace(plan, inputs=inputs, loss=loss, model=model))
    observer.save(tmp_path / "o.safetensors")
    loaded = Observer.load(tmp_path / "o.safetensors")
    assert loaded.hash == observer.hash
    whole = predict(observer, log)
    again = predict(loaded, log)
    assert np.array_equal(whole.v_I, again.v_I)
    running, seen = loaded.running(), observer_samples(log, loaded.inputs)
    for m in range(80):
        (v_I,), covariance, _ = running(seen.x[m : m + 1])
        assert v_I == pytest.approx(whole.v_I[m], abs=2e-5)
        if covariance is not None and whole.covariance is not None:
            assert covariance[0] == pytest.approx(whole.covariance[m], rel=1e-3, abs=1e-8)


def test_it_carries_over_to_another_speed():
    """Taught at one pace and tested at twice that, it errs half as much as raw joints, or less."""
    slow, fast = walk(0, 30), walk(1, 30, pace=2.0)
    rms = {}
    for inputs in ("q,dq,tau", "gyro,contact,feet"):
        observer = train(slow, settings=replace(PLAN, inputs=inputs, model="mlp"))
        rms[inputs] = np.sqrt((prediction_errors(observer, fast)[1] ** 2).sum(axis=1).mean())
    assert rms["gyro,contact,feet"] < 0.5 * rms["q,dq,tau"]


def test_robots_without_known_feet_are_refused(walks):
    with pytest.raises(SurefootError, match=r"joints are not known as those of analytic"):
        train(walks["fit"], Body(), replace(PLAN, inputs="gyro,feet"))


@pytest.mark.parametrize("change", ["absent", "short", "nan", "extra"])
def test_a_damaged_drawing_is_refused(change, tmp_path):
    plan = TrainSettings(steps=2, batch=2, every=2)
    observer = train(walk(3, 12), settings=replace(plan, inputs="gyro,feet", model="mlp"))
    legs = dict(observer.legs)
    if change == "absent":
        legs = {}
    elif change == "extra":
        legs["more"] = np.zeros(1)
    else:
        legs["foot"] = legs["foot"][:3] if change == "short" else legs["foot"] * np.nan
    replace(observer, legs=legs).save(tmp_path / "o.safetensors")
    with pytest.raises(ObserverError, match="not a whole surefoot observer"):
        Observer.load(tmp_path / "o.safetensors")


def walk(seed: int, duration: float, pace: float = 1.0) -> Log:
    """A trot of the robot: its velocity is what the soles in stance, which do not move, say.

    The loaded legs' torques and contacts tell which those are.
    """
    log = synthetic_walk(seed, duration, robot="spot_class")
    frame = log.frame.copy()
    q, dq = ROBOT.q_home + log.q - [0, 0, -1] * 4, pace * log.dq
    # Legs in diagonal pairs carry while they swing back.
    carry = np.stack([dq[:, 3 * leg + 1] > 0 for leg in range(4)], axis=1)
    stance = np.repeat(carry, 3, axis=1)
    for i, joint in enumerate(JOINTS):
        frame[f"q_{joint}"], frame[f"dq_{joint}"] = q[:, i], dq[:, i]
        frame[f"tau_{joint}"] = np.where(stance[:, i], 20.0, 0.0)
    for k, leg in enumerate(LEGS):
        frame[f"contact_{leg}"] = carry[:, k].astype(float)
    known = Kinematics.of(leg_geometry(ROBOT, JOINTS), ROBOT)
    u = contact_points(known, q, dq, log.gyro)[:, 12:].reshape(-1, 4, 3)
    v_I = -(carry[..., None] * u).sum(axis=1) / carry.sum(axis=1, keepdims=True).clip(1)
    v_G = np.einsum("nij,nj->ni", log.ref_R_GI, v_I)
    for i, axis in enumerate("xyz"):
        frame[f"ref_v_{axis}"] = v_G[:, i]
    return Log(frame, log.meta, log.name)
