"""Feet on ground that gives: a model that knows of it is told where they are."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from synthetic import synthetic_walk

from surefoot.models.attribution.evidence import linearise, log_under_model
from surefoot.models.residuals.binning import binned, reference_motion
from surefoot.models.residuals.jacobians import Regressor, ResidualJacobians, explained_share
from surefoot.models.residuals.layout import layout_for, residual
from surefoot.models.residuals.soft_ground import (
    Stances,
    _add_stances,
    _integrate_stance,
    acceleration_at_constant_rates,
    foot_loads,
    foot_stances,
)
from surefoot.sim.common.quaternion import quaternion_from_matrix
from surefoot.sim.effects import effect
from surefoot.sim.effects.base import with_columns
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.ground.tiles import SOLIMP
from surefoot.sim.log import LEGS, Log
from surefoot.sim.physics.scene import build_world
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.sensors.stances import stances_between_swings
from surefoot.sim.walk import walk

COURSE = (Segment(4.0, 0.5), Segment(4.0, 0.4, turn=0.4))
SOFT = 0.03


def walked(robot: Robot, *effects) -> Log:
    return walk(Scenario("soft", COURSE, Ground(0.8)), robot, 4, effects, declared=False)


@pytest.fixture(scope="module", params=["spot_class", "go2"])
def on_soft_ground(request):
    robot = Robot.load(request.param)
    return robot, walked(robot, effect("soft_ground", "all", SOFT))


def knowing(robot: Robot, softness: float) -> Robot:
    return replace(robot, extras=replace(robot.extras, softness=softness))


def test_a_stance_begins_with_a_landing_and_the_first_with_the_log():
    t = 0.1 * np.arange(8)
    first, last = stances_between_swings(t, np.array([1, 1, 0, 0, 1, 1, 0, 1], dtype=bool))
    assert_array_equal([first, last], [[0, 4, 7], [2, 6, 8]])
    assert len(stances_between_swings(t, np.zeros(8, dtype=bool))[0]) == 0


def test_a_foot_that_bounces_has_not_landed_again():
    t = 0.02 * np.arange(9)
    first, last = stances_between_swings(t, np.array([1, 0, 0, 0, 0, 1, 0, 1, 1], dtype=bool))
    assert_array_equal([first, last], [[0, 5], [1, 9]])


def test_a_foot_sinks_as_a_critically_damped_spring_does():
    """Without a load v t exp(-t / T), with one its share of the load, along the ground less and
    less: all in closed form, where the impedance is what it is at depth."""
    t, T, speed, give, load = 1e-4 * np.arange(5001), 0.05, 0.4, 5.0, 200.0
    end = SOLIMP[1] * T
    depth, v = np.zeros(len(t)), np.zeros((len(t), 3))
    _integrate_stance(
        t, np.zeros((len(t), 4)), 0, len(t), 0.0, np.array([0.3, 0, -speed]), give, T, depth, v
    )
    assert_allclose(depth, speed * t * np.exp(-t / end), atol=0.01 * depth.max())
    assert_allclose(v[:, 0], 0.3 * np.exp(-2.0 * t / end), atol=0.003)
    assert_allclose(0.5 * (v[1:, 2] + v[:-1, 2]), -np.diff(depth) / np.diff(t), atol=1e-9)
    rows = np.tile([0.2, 0.0, 0.0, load], (len(t), 1))
    _integrate_stance(t, rows, 0, len(t), 0.0, np.zeros(3), give, T, depth, v)
    assert depth[-1] == pytest.approx((1 / SOLIMP[1] - 1) * give * load * end**2 / SOLIMP[1], 1e-3)
    assert v[-1, 0] == pytest.approx(0.2 * end / 2, 1e-3)


def test_a_landed_stance_moves_the_foot_by_what_it_sinks():
    """And what was added is taken away again with the other sign."""
    t = 1e-3 * np.arange(400)
    landing = np.array([[0.0, 0.0, -0.3], [0.0, 0.0, -0.3]])
    stances = Stances(np.array([0, 200]), np.array([150, 400]), np.ones(2, dtype=bool), landing)
    rows, height = np.tile([0.0, 0.0, 0.0, 100.0], (400, 1)), np.zeros(400)
    depth, v = np.zeros(400), np.zeros((400, 3))
    _add_stances(t, height, rows, stances, 5.0, 0.02, 1.0, depth, v)
    assert depth.max() > 1e-3
    assert not depth[150:200].any()
    for a, b in ((0, 150), (200, 400)):
        means = 0.5 * (v[a + 1 : b, 2] + v[a : b - 1, 2])
        assert_allclose(means, -np.diff(depth[a:b]) / np.diff(t[a:b]), atol=1e-9)
    _add_stances(t, height, rows, stances, 5.0, 0.02, -1.0, depth, v)
    assert_allclose(depth, 0.0, atol=1e-12)
    assert_allclose(v, 0.0, atol=1e-12)


def test_what_a_reference_says_of_a_foot_that_still_sinks_does_not_move_the_ground():
    """It lies above the foot by its depth in the second half of a stance, when it has settled."""
    t, landing = 1e-3 * np.arange(200), np.array([[0.0, 0.0, -0.3]])
    stance = Stances(np.array([0]), np.array([200]), np.ones(1, dtype=bool), landing)
    rows = np.tile([0.0, 0.0, 0.0, 100.0], (200, 1))
    depths = []
    for trembling in (0.0, 0.01):
        height, depth = np.zeros(200), np.zeros(200)
        height[1:99] = trembling
        _add_stances(t, height, rows, stance, 5.0, 0.02, 1.0, depth, np.zeros((200, 3)))
        depths.append(depth)
    assert depths[0].max() > 1e-3
    assert_array_equal(*depths)


def test_a_foot_lands_as_fast_as_its_own_joints_say_about_its_touchdown():
    """In the row of the touchdown and one beside it at 100 Hz; the leg moves in no other."""
    robot, leg = Robot.load("spot_class"), LEGS.index("FR")
    log = synthetic_walk(0, 0.6, 100.0, robot="spot_class")
    columns = {f"contact_{one}": (log.t >= 0.3).astype(float) for one in LEGS}
    log = with_columns(log, columns)
    dq = np.zeros_like(log.q)
    dq[29:32, robot.legs.joints[leg]] = rates = np.array([0.5, -1.0, 2.0])
    points = replace(robot, foot_radius=np.zeros(4))
    motion = reference_motion(log, robot.limbs)
    still = replace(motion, v_I=0.0 * motion.v_I, gyro=0.0 * motion.gyro)
    found = foot_stances(log, points, still, leg, dq)
    assert_array_equal(found.first, [30])
    velocity_I = robot.feet_jacobian_I(log.q[29:32])[:, leg] @ rates
    velocity_G = np.einsum("nij,nj->ni", motion.R_GI[29:32], velocity_I)
    assert_allclose(found.v_G[0], velocity_G.mean(axis=0), atol=1e-9)


def test_a_joint_that_turns_faster_moves_the_body_by_the_lever_of_its_foot():
    """Against the foot, where that stands; so does the turning of the body, across its arm."""
    robot = replace(Robot.load("spot_class"), foot_radius=np.zeros(4))
    log = synthetic_walk(0, 0.2, robot="spot_class")
    log = with_columns(log, {f"contact_{one}": np.ones(len(log.t)) for one in LEGS})
    motion = reference_motion(log, robot.limbs)
    motion = replace(motion, standing=np.ones_like(motion.standing))
    parts = residual(log, robot, motion, ["leg_velocity"])
    found, bins = ResidualJacobians(parts), parts.inputs.bins
    assert_allclose(found.legs["dq"], -robot.feet_jacobian_I(bins.q), atol=1e-6)
    arm = robot.feet_I(bins.q)
    for axis, along in enumerate(np.eye(3)):
        assert_allclose(found.turning[..., axis], -np.cross(along, arm), atol=1e-6)


def test_a_share_explained_does_not_depend_on_the_columns_units():
    """A column of millimetres beside one of radians counts as one of metres does."""
    rng = np.random.default_rng(7)
    size, noise = rng.uniform(-1.0, 1.0, (400, 2)), rng.uniform(-1.0, 1.0, (400, 2))
    table = size + [0.0, 2.0] * noise
    shares = []
    for units in ([1.0, 1.0], [1000.0, 1.0], [1.0, 1e-4]):
        one = Regressor(np.arange(2), size * units)
        shares.append(explained_share(one, table * units))
    assert_allclose(shares, shares[0], rtol=1e-9)
    assert 0.3 < shares[0] < 0.7
    alone = Regressor(np.arange(1), 1000.0 * table[:, :1])
    assert explained_share(alone, 1000.0 * table) == pytest.approx(1.0, abs=1e-3)


def test_what_the_rates_alone_do_is_what_mujoco_says(on_soft_ground):
    robot, log = on_soft_ground
    frame = log_under_model(log, robot).motion
    bins, world = binned(log, robot, frame), build_world(robot, Ground(0.8))
    ours, model = acceleration_at_constant_rates(robot, bins), world.model
    data = mujoco.MjData(model)
    for k in range(50, 150, 20):
        R_GB = bins.R_GI[k] @ robot.R_BI.T
        data.qpos[3:7] = quaternion_from_matrix(R_GB[None])[0]
        data.qpos[world.qpos_adr], data.qvel[world.dof_adr] = bins.q[k], bins.dq[k]
        data.qvel[3:6] = robot.R_BI @ bins.omega[k]
        mujoco.mj_forward(model, data)
        for leg, (body, place) in enumerate(zip(robot.foot_bodies, robot.foot_places, strict=True)):
            p, r = np.zeros((3, model.nv)), np.zeros((3, model.nv))
            at = model.body(body).id
            centre = data.xpos[at] + data.xmat[at].reshape(3, 3) @ place
            mujoco.mj_jacDot(model, data, p, r, centre, at)
            sole = -robot.foot_radius[leg] * np.array([0.0, 0.0, 1.0])
            expected = p @ data.qvel + np.cross(r @ data.qvel, sole)
            assert_allclose(bins.R_GI[k] @ ours[k, leg], expected, rtol=2e-3, atol=5e-3)


def test_a_foots_load_is_read_from_its_legs_torques(on_soft_ground):
    robot, log = on_soft_ground
    frame = log_under_model(log, robot).motion
    bins = binned(log, robot, frame)
    of_torques = foot_loads(log, robot, frame, bins)
    shared = foot_loads(log, robot, frame, replace(bins, tau=np.full_like(bins.tau, np.nan)))
    inside, true = frame.standing, log.force
    weight = 9.81 * robot.mass
    assert np.std((of_torques - true)[inside]) < 0.03 * weight
    assert abs(np.mean((of_torques - true)[inside])) < 0.01 * weight
    assert_allclose(shared.sum(axis=1)[log.contact.any(axis=1)], weight, rtol=1e-2)
    assert abs(np.mean((shared - true)[inside])) < 0.05 * weight


@pytest.mark.parametrize("torques", [True, False])
def test_a_model_that_knows_of_soft_ground_finds_the_feet_where_they_are(on_soft_ground, torques):
    """What is left is what hard ground leaves; without torques, half of it is."""
    robot, log = on_soft_ground
    if not torques:
        kept = [c for c in log.frame if not str(c).startswith("tau_")]
        log = Log(log.frame[kept], log.meta, log.name)
    frame = replace(log_under_model(log, robot).motion, level=True)
    left = {
        size: residual(log, knowing(robot, size), frame).table
        for size in (0.0, 0.9 * SOFT, SOFT, 1.1 * SOFT)
    }
    layout = layout_for(robot.limbs)
    height = {size: typical(table[:, layout.of("foot_height")]) for size, table in left.items()}
    speed = {size: typical(table[:, layout.of("leg_velocity")]) for size, table in left.items()}
    assert height[SOFT] < (0.1 if torques else 0.5) * height[0.0]
    assert speed[SOFT] < 0.6 * speed[0.0]
    if torques:
        assert height[SOFT] < 0.7 * min(height[0.9 * SOFT], height[1.1 * SOFT])
        assert speed[SOFT] < 0.0025


def typical(values: np.ndarray) -> float:
    """Standard deviation of the bulk: a foot that slides sinks otherwise."""
    values = values - np.nanmedian(values, axis=0)
    return float(1.4826 * np.nanmedian(np.abs(values)))


def test_a_model_of_hard_ground_says_what_it_said(on_soft_ground):
    """The form vanishes with the softness: no step where a candidate is first varied."""
    robot, log = on_soft_ground
    frame = replace(log_under_model(log, robot).motion, level=True)
    hard, nearly = (residual(log, knowing(robot, size), frame).table for size in (0.0, 1e-6))
    legs = layout_for(robot.limbs).of("imu_gyro", "imu_accel", "leg_velocity", "foot_height")
    assert_allclose(nearly[:, legs], hard[:, legs], atol=1e-5)


def test_derivatives_by_readings_know_of_the_depth(on_soft_ground):
    """On ground known to be soft, an encoder's offset changes the height of its own foot by the
    lever of its leg, and the other feet's by nothing."""
    robot, log = on_soft_ground
    case = log_under_model(log, knowing(robot, SOFT))
    case = replace(case, motion=replace(case.motion, level=True))
    (one,) = linearise([case], (), [("encoder_offset", "FL_calf")]).X
    own, *others = layout_for(robot.limbs).of("foot_height")
    assert own in one.columns
    heights = one.values[:, np.searchsorted(one.columns, own)]
    assert np.abs(heights).max() < robot.leg_length
    assert not np.isin(others, one.columns).any()


@pytest.mark.parametrize("size", [0.012, 0.06])
def test_a_small_and_a_large_softness_both_look_like_the_candidate(size):
    """How a foot sinks is far from linear in the size: the candidate begins where it is like."""
    robot = Robot.load("spot_class")
    case = log_under_model(walked(robot, effect("soft_ground", "all", size)), robot)
    (one,) = (evidence := linearise([case], (), [("soft_ground", "all")])).X
    assert explained_share(one, evidence.table) > 0.25
    assert explained_share(Regressor(one.columns, -one.values), evidence.table) < -0.25
