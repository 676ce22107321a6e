"""Every effect of the catalogue, from a file into a walk, shows in the data as what it says."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from perfect import PERFECT
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation
from turning import mean_rotation

from surefoot.sim.common.quaternion import quaternion_from_matrix
from surefoot.sim.effects import Effect, effect
from surefoot.sim.effects.file import load_effects, save_effects
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.log import Log
from surefoot.sim.physics.scene import TIMESTEP, World, robot_spec
from surefoot.sim.robot import Robot
from surefoot.sim.robot.legs import JOINTS, LEGS
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.walk import plan, simulate_motion, walk

SPOT = Robot.load("spot_class")
# Nothing but the effect: an IMU of steps that are next to none.
EXACT = replace(PERFECT, gyro_range=35, accel_range=1000)
ROUNDED = {"gyro": 35 / 2**15, "accel": 1000 / 2**15}
COURSE = Scenario("short", (Segment(4.0, 0.6, turn=0.4),), Ground(0.8), stand=0.6, sensors=EXACT)
STREAMS = ("gyro", "accel", "q", "dq", "tau", "tau_ff", "force", "contact")
REFERENCE = ("ref_p", "ref_q", "ref_v")
TRUTH = ("slip", "mu")
LEG, J = LEGS.index("RL"), JOINTS.index("RL_calf")


@pytest.fixture(scope="module")
def plain():
    return walk(COURSE, SPOT, 3)


@pytest.fixture
def walked(tmp_path):
    """A walk with an effect that was written to a file and read back."""

    def make(name: str, target: str, value: float) -> Log:
        save_effects(tmp_path / "effects.toml", [effect(name, target, value)])
        return walk(COURSE, SPOT, 3, load_effects(tmp_path / "effects.toml"))

    return make


def test_a_late_reference_is_late_and_nothing_else_changes(plain, walked):
    log = walked("reference_delay", "all", 0.02)
    then = np.maximum(np.arange(len(log.t)) - 10, 0)
    for group in (*STREAMS, *REFERENCE, *TRUTH):
        same = getattr(plain, group)
        wanted = same[then] if group in REFERENCE else same
        assert_allclose(getattr(log, group), wanted, atol=1e-9)


def test_imu_position_swings_on_its_arm(plain, walked):
    """What the moved sensor feels beyond the nominal one carries it along the arm that turns."""
    log = walked("imu_position", "x", 0.2)
    assert_array_equal(log.gyro, plain.gyro)
    assert_array_equal(log.ref_p, plain.ref_p)
    R = plain.ref_R_GI
    mean = R[:-1] @ mean_rotation(plain.gyro[1:] * TIMESTEP)
    apart = np.einsum("nij,nj->ni", mean, (log.accel - plain.accel)[1:])
    moved = np.cumsum(np.cumsum(apart, axis=0), axis=0) * TIMESTEP**2
    arm = R[1:, :, 0] * 0.2
    swing = arm - arm[0]
    assert np.abs(swing).max() > 0.2
    # Rounding leaves a velocity that is a little off, so that a line is free.
    t = np.column_stack([plain.t[1:], np.ones(len(moved))])
    left = (moved - swing) - t @ np.linalg.lstsq(t, moved - swing, rcond=None)[0]
    assert np.abs(left).max() < 5e-3


def test_imu_lowpass_is_of_first_order(plain, walked):
    log, keep = walked("imu_lowpass", "all", 0.004), np.exp(-TIMESTEP / 0.004)
    for group, rounded in ROUNDED.items():
        x, y = getattr(plain, group), getattr(log, group)
        assert_allclose(y[1:], keep * y[:-1] + (1 - keep) * x[1:], atol=2 * rounded)
        assert np.abs(np.diff(y, axis=0)).mean() < 0.9 * np.abs(np.diff(x, axis=0)).mean()
    assert_array_equal(log.q, plain.q)


@pytest.mark.parametrize("target", ["imu", "joints", "feet", "reference"])
def test_clock_scale_drifts_one_stream_against_the_others(plain, walked, target):
    log = walked("clock_scale", target, -0.0101)
    groups = {
        "imu": ("gyro", "accel"), "joints": ("q", "dq", "tau"), "feet": ("force",),
        "reference": ("ref_p", "ref_v"),
    }  # fmt: skip
    then = plain.t[0] + 0.9899 * (plain.t - plain.t[0])
    for group in (*STREAMS, *REFERENCE):
        was, now = getattr(plain, group), getattr(log, group)
        if group in groups[target]:
            drifted = np.column_stack([np.interp(then, plain.t, x) for x in was.T])
            if target == "imu":
                drifted = CubicSpline(plain.t, was)(then)
            if target == "feet":
                drifted = was[np.abs(plain.t[:, None] - then).argmin(axis=0)]
            assert_allclose(now, drifted, atol=2 * ROUNDED.get(group, 1e-9))
        elif (group, target) not in {("contact", "feet"), ("ref_q", "reference")}:
            assert_array_equal(now, was)


def test_mounting_rotation_turns_imu_and_reference_alike(plain, walked):
    log = walked("mounting_rotation", "y", 0.05)
    turn = Rotation.from_rotvec([0, 0.05, 0]).as_matrix()
    assert_allclose(log.ref_R_GI, plain.ref_R_GI @ turn, atol=1e-12)
    assert_allclose(log.gyro, plain.gyro @ turn, atol=3 * ROUNDED["gyro"])
    assert_allclose(log.accel, plain.accel @ turn, atol=3 * ROUNDED["accel"])
    for group in ("q", "tau", "contact", "ref_p", "ref_v"):
        assert_array_equal(getattr(log, group), getattr(plain, group))


def heights(log: Log) -> np.ndarray:
    """Mean height (4,) [m] of the standing feet's centres, by the declared legs."""
    feet = log.ref_p[:, None] + np.einsum("nij,nlj->nli", log.ref_R_GI, SPOT.feet_I(log.q))
    return np.array([feet[log.contact[:, leg], leg, 2].mean() for leg in range(4)])


@pytest.mark.parametrize(
    ("name", "target", "value", "low", "high"),
    [
        ("hip_offset", "RL_z", 0.02, -0.0205, -0.0195),  # straight up: all of it
        ("link_length", "RL_calf", 0.02, 0.010, 0.020),  # a calf leans
        ("foot_rolling", "all", 0.01, 0.0098, 0.0102),
        ("soft_ground", "all", 0.05, -0.010, -0.002),
    ],
)
def test_standing_feet_are_at_another_height(plain, walked, name, target, value, low, high):
    rise = heights(walked(name, target, value)) - heights(plain)
    assert low < rise[LEG] < high
    others = np.delete(rise, LEG)
    assert (((low < others) & (others < high)) if target == "all" else (abs(others) < 1e-3)).all()


def missing_torque(world: World, motion) -> tuple[np.ndarray, ...]:
    """What the swinging knee's motor gives beyond MuJoCo's inverse dynamics of the world, exact
    but for what the world lacks [N m]; beside it the motor's torque [N m], rate [rad/s] and
    acceleration [rad/s^2]."""
    model, data = world.model, mujoco.MjData(world.model)
    model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_INVDISCRETE
    qpos = np.empty((len(motion.t), model.nq))
    qvel = np.empty((len(motion.t), model.nv))
    qpos[:, :3], qpos[:, 3:7] = motion.p_GB, quaternion_from_matrix(motion.R_GB)
    qvel[:, :3], qvel[:, 3:6] = motion.v_GB, motion.w_B
    qpos[:, world.qpos_adr], qvel[:, world.dof_adr] = motion.q, motion.dq
    rate, torque = motion.dq[:, J], []
    swing = np.flatnonzero((motion.force[:, LEG] == 0) & (np.abs(rate[1:]) > 1.0))
    for k in swing:
        data.qpos[:], data.qvel[:] = qpos[k], qvel[k]
        mujoco.mj_integratePos(model, data.qpos, data.qvel, 0.5 * TIMESTEP)  # as simulated
        data.qacc[:] = (qvel[k + 1] - qvel[k]) / TIMESTEP
        mujoco.mj_inverse(model, data)
        torque.append(motion.tau[k, J] - data.qfrc_inverse[world.dof_adr[J]])
    return np.array(torque), motion.tau[swing, J], rate[swing + 1], np.diff(rate)[swing] / TIMESTEP


@pytest.mark.parametrize(
    ("name", "value", "size"),
    [
        ("viscous_friction", 2.0, lambda tau, rate, acceleration: rate),
        ("coulomb_friction", 2.0, lambda tau, rate, acceleration: np.sign(rate)),
        ("load_friction", 0.2, lambda tau, rate, acceleration: np.abs(tau) * np.sign(rate)),
        ("armature", 0.1, lambda tau, rate, acceleration: acceleration),
        (None, 0.0, lambda tau, rate, acceleration: rate),
    ],
)
def test_drives_take_the_torque_that_the_effect_says(name, value, size):
    without = plan(COURSE, SPOT, 3)
    made = plan(COURSE, SPOT, 3, [effect(name, "RL_calf", value)] if name else [])
    motion = simulate_motion(made.world, SPOT, made.gait, made.course)
    torque, *drive = missing_torque(without.world, motion)
    expected = value * size(*drive)
    assert len(torque) > 100
    # Dry friction takes a few samples to change sides and as much to slide at full strength.
    off = np.quantile(np.abs(torque - expected), 0.9)
    assert off < 0.02 * np.abs(expected).max() + 1e-9


def test_a_payload_on_a_payload():
    spec = robot_spec(SPOT)
    for mass in (2.0, 3.0):
        effect("payload", "all", mass).edit_spec(spec, SPOT)
    assert spec.compile().body_mass.sum() == pytest.approx(SPOT.mass + 5.0)


@pytest.mark.parametrize("mode", ["TRUE", "AUTO"])
def test_com_offset_moves_the_base_alone(mode):
    spec = robot_spec(SPOT)
    modes = mujoco.mjtInertiaFromGeom
    spec.compiler.inertiafromgeom = getattr(modes, f"mjINERTIAFROMGEOM_{mode}")
    before = spec.compile()
    effect("com_offset", "y", 0.03).edit_spec(spec, SPOT)
    after = spec.compile()
    base = after.body(SPOT.base_name).id
    moved = after.body_ipos - before.body_ipos
    assert_allclose(moved[base], [0, 0.03, 0], atol=1e-12)
    assert_allclose(np.delete(moved, base, axis=0), 0.0, atol=1e-12)
    assert_allclose(after.body_mass, before.body_mass, rtol=1e-12)
    assert_allclose(after.body_inertia, before.body_inertia, rtol=1e-9)


def test_an_effect_is_named_after_its_class_unless_it_says_otherwise():
    assert type("WetGround", (Effect,), {}).name == "wet_ground"
    assert type("WetGround", (Effect,), {"name": "rain"}).name == "rain"
