"""What effects do to readings, ground and log, each by its formula, without a walk."""

from dataclasses import replace

import mujoco
import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation
from synthetic import synthetic_walk

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.effects.base import with_columns
from surefoot.sim.effects.body import FootRolling
from surefoot.sim.effects.contact import ContactDelay, FootSlip
from surefoot.sim.effects.drive import Armature, Backlash, CoulombFriction, ViscousFriction
from surefoot.sim.effects.imu import AccelScale, GyroBias, GyroScale, ImuRotation
from surefoot.sim.effects.readings import EncoderOffset, TorqueScale
from surefoot.sim.effects.timing import ImuDelay, JointDelay, TorqueDelay
from surefoot.sim.ground.terrain import Ground, Patch, Strip
from surefoot.sim.log import JOINTS, LEGS, Log, MemoisedLog, Meta
from surefoot.sim.physics.drives import foot_parts
from surefoot.sim.physics.scene import robot_spec
from surefoot.sim.robot import Robot
from surefoot.sim.robot.limbs import Limbs
from surefoot.sim.sensors.streams import Streams

ROBOT = Robot.load("spot_class")
COLUMNS = {"gyro": "xyz", "accel": "xyz", "q": JOINTS, "dq": JOINTS, "tau": JOINTS}


@pytest.fixture(scope="module")
def log() -> Log:
    return synthetic_walk(0, 4.0, robot="spot_class")


def streams_of(log: Log) -> Streams:
    return Streams(
        log.t, log.gyro, log.accel, log.q, log.dq, log.tau, log.tau, np.ones((len(log.t), 4))
    )


def changed(name: str, place: int, factor: float = 1.0, by: float = 0.0):
    def readings(before: Streams) -> dict[str, np.ndarray]:
        after = getattr(before, name).copy()
        after[:, place] = factor * after[:, place] + by
        return {name: after}

    return readings


def late(seconds: float, *names: str):
    def readings(before: Streams) -> dict[str, np.ndarray]:
        rows = round(seconds * 500.0)
        return {n: np.roll(getattr(before, n), rows, axis=0) for n in names}

    return readings


def turned(angle: float):
    R = Rotation.from_euler("x", angle)
    return lambda before: {n: R.inv().apply(getattr(before, n)) for n in ("gyro", "accel")}


@pytest.mark.parametrize(
    ("kind", "target", "value", "readings"),
    [
        (AccelScale, "z", 0.05, changed("accel", 2, factor=1.05)),
        (GyroScale, "z", -0.02, changed("gyro", 2, factor=0.98)),
        (GyroBias, "y", 0.03, changed("gyro", 1, by=0.03)),
        (TorqueScale, "FL_calf", 0.1, changed("tau", 2, factor=1.1)),
        (TorqueDelay, "all", 0.006, late(0.006, "tau")),
        (JointDelay, "all", 0.004, late(0.004, "q", "dq", "tau")),
        (ImuDelay, "all", -0.01, late(-0.01, "gyro", "accel")),
        (EncoderOffset, "FR_calf", 0.03, changed("q", 5, by=0.03)),
        (ImuRotation, "x", -0.04, turned(-0.04)),
    ],
)
def test_readings_change_by_the_formula_and_a_model_that_knows_takes_it_back(
    log, kind, target, value, readings
):
    one, before, inside = kind(target, value), streams_of(log), slice(10, -10)
    after = one.alter_streams(before, ROBOT)
    wanted = readings(before)
    for name in COLUMNS:
        same = getattr(before, name)
        assert_allclose(getattr(after, name)[inside], wanted.get(name, same)[inside], atol=1e-9)
    columns = {
        f"{name}_{place}": getattr(after, name)[:, i]
        for name, places in COLUMNS.items()
        for i, place in enumerate(places)
    }
    known, _ = one.compensate(with_columns(log, columns), ROBOT)
    for name in COLUMNS:
        assert_allclose(getattr(known, name)[inside], getattr(log, name)[inside], atol=1e-9)


def test_a_rotor_adds_its_inertia_to_its_own_joint_alone():
    """On the diagonal of the mass matrix: no other joint turns it."""
    matrices = []
    for size in (0.0, 0.02):
        spec = robot_spec(ROBOT)
        Armature("FL_calf", size).edit_spec(spec, ROBOT)
        model = spec.compile()
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        matrices.append(np.zeros((model.nv, model.nv)))
        mujoco.mj_fullM(model, data, matrices[-1])
    added = np.zeros_like(matrices[0])
    at = model.joint(ROBOT.joint_names[JOINTS.index("FL_calf")]).dofadr[0]
    added[at, at] = 0.02
    assert_allclose(matrices[1] - matrices[0], added, atol=1e-12)


def test_a_current_may_say_half_of_a_torque_and_not_less():
    """With half of it, a joint's torque is twice what was read; beyond, it is of another motor."""
    tau = np.full((3, 12), 4.0)
    still, at_rest = np.zeros((3, 3)), np.zeros((3, 12))
    before = Streams(np.arange(3.0), still, still, at_rest, at_rest, tau, tau, tau)
    after = TorqueScale("FL_calf", -0.5).alter_streams(before, ROBOT)
    assert_array_equal(after.tau[:, 2], 2.0)
    with pytest.raises(SurefootError, match=r"torque_scale \S+: value must lie between -0\.5 "):
        TorqueScale("FL_calf", -0.52)


def test_torques_at_1_khz_are_varied_by_a_row_as_it_was_read():
    """Between rows they would be interpolated, which smooths their noise."""
    t = 1e-3 * np.arange(60)
    tau = np.random.default_rng(5).normal(0.0, 1.0, (len(t), len(JOINTS)))
    columns = {f"tau_{joint}": tau[:, i] for i, joint in enumerate(JOINTS)}
    columns |= {f"q_{joint}": 0.0 * t for joint in JOINTS}
    log = Log(pd.DataFrame({"t": t} | columns), Meta(rate=1e3))
    known, _ = TorqueDelay("all", TorqueDelay.traced.step).compensate(log, ROBOT)
    assert_allclose(known.tau[:-1], tau[1:], atol=1e-9)


def test_dry_friction_turns_round_within_a_hundredth_of_a_joints_rate():
    """Of a rate without noise: at a hundredth of its RMS, tanh(1) of the friction is there."""
    t = 0.01 * np.arange(400)
    rate = np.sin(2.0 * np.pi * t + np.arcsin(0.01 * np.sqrt(0.5)))
    rest = {f"{kind}_{joint}": 0.0 * t for kind in ("q", "dq", "tau") for joint in JOINTS}
    log = Log(pd.DataFrame({"t": t} | rest | {"dq_FL_calf": rate}), Meta(rate=100.0))
    known, _ = CoulombFriction("FL_calf", 2.0).compensate(log, ROBOT)
    assert known.tau[::100, 2] == pytest.approx(-2.0 * np.tanh(1.0), rel=1e-6)


def test_a_motor_without_torque_stays_on_the_side_where_it_lay():
    tau = np.array([0.0, 2.0, 0.0, 0.0, -1.0, 0.0, 0.5])
    turned = np.zeros((len(tau), 12))
    torques = turned.copy()
    torques[:, 1] = tau
    flat = np.zeros((len(tau), 3))
    before = Streams(
        0.002 * np.arange(len(tau)), flat, flat, turned, turned, torques, torques, turned[:, :4]
    )
    after = Backlash("FL_thigh", 0.02).alter_streams(before, ROBOT)
    assert_allclose(after.q[:, 1], 0.01 * np.array([0, 1, 1, 1, -1, -1, 1]))


def test_a_foot_that_slips_does_so_on_whatever_it_stands():
    """A strip without a friction of its own goes on taking the floor's."""
    strips = Strip((0.0, 0.0), (1.0, 0.0), 1.0), Strip((1.0, 0.0), (2.0, 0.0), 1.0, mu=0.4)
    ground = Ground(0.8, patches=(Patch(3.0, 0.0, 1.0, 1.0, 0.6),), strips=strips)
    slippery = FootSlip("all", 0.5).alter_ground(ground)
    assert slippery.mu == pytest.approx(0.4)
    assert slippery.patches[0].mu == pytest.approx(0.3)
    assert slippery.strips[0] == strips[0]
    assert slippery.strips[1].mu == pytest.approx(0.2)


@pytest.mark.parametrize(("debounce", "cut"), [(0.0, 15), (0.021, 4), (0.04, 0)])
def test_contacts_that_begin_early_are_cut_by_what_debouncing_has_left(log, debounce, cut):
    """30 ms early at 500 Hz; what is not cut is known to the model."""
    contact = np.ones((len(log.t), 4))
    contact[300:400, 1] = 0.0
    columns = {f"contact_{leg}": contact[:, i] for i, leg in enumerate(LEGS)}
    early = with_columns(log, columns)
    early = replace(early, meta=replace(early.meta, model={"contact_debounce": debounce}))
    known, robot = ContactDelay("touchdown", -0.03).compensate(early, ROBOT)
    assert_array_equal(np.flatnonzero(~known.contact[:, 1]), np.arange(300, 400 + cut))
    assert known.contact[:, [0, 2, 3]].all()
    assert robot.extras.touchdown_late == pytest.approx(cut / 500.0 - 0.03)


def test_delays_of_logs_one_after_the_other_do_not_mix_them_up(log):
    """Splines are kept while the columns are the same arrays."""
    log = MemoisedLog.of(log)
    doubled = log.with_columns({f"q_{joint}": 2.0 * log.q[:, i] for i, joint in enumerate(JOINTS)})
    for value in (1e-3, 4e-3):
        one, other = (
            JointDelay("all", value).compensate(each, ROBOT)[0] for each in (log, doubled)
        )
        assert_allclose(other.q, 2.0 * one.q, rtol=1e-12, atol=1e-12)
        assert_array_equal(other.dq, one.dq)
        assert_allclose(one.q, CubicSpline(log.t, log.q)(np.clip(log.t + value, None, log.t[-1])))


def test_contacts_that_end_late_end_as_much_earlier_in_a_compensated_log(log):
    late, stands = int(0.05 * log.rate), np.zeros((len(log.t), len(LEGS)))
    half = len(log.t) // 2
    stands[late : half - late], stands[half + late :] = 1.0, 1.0
    given = with_columns(log, {f"contact_{leg}": stands[:, i] for i, leg in enumerate(LEGS)})
    found, robot = ContactDelay("liftoff", 0.05).compensate(given, ROBOT)
    stands[half - 2 * late : half - late] = 0.0
    assert_array_equal(found.contact, stands.astype(bool))
    assert robot.extras.liftoff_late == pytest.approx(0.0, abs=1.0 / log.rate)


def test_what_was_declared_of_one_joint_may_be_less_there_alone():
    limbs = Limbs((), ("a", "b"), (), declared=((("coulomb_friction", "a"), 0.4),))
    most = CoulombFriction.bounds[1]
    assert CoulombFriction.bounds_on(limbs, "a") == (-0.5, most)
    assert CoulombFriction.bounds_on(limbs, "b") == (0.0, most)
    assert CoulombFriction.bounds_on(limbs) == CoulombFriction.bounds_on(None, "a") == (0.0, most)
    assert ViscousFriction.bounds_on(limbs, "a") == ViscousFriction.bounds


@pytest.mark.parametrize("size", [0.01, -0.01])
def test_a_foot_that_rolls_has_a_larger_radius_in_the_simulator(size):
    spec = robot_spec(ROBOT)
    before = [foot_parts(spec, leg)[0].size[0] for leg in LEGS]
    FootRolling("FR", size).edit_spec(spec, ROBOT)
    after = [foot_parts(spec, leg)[0].size[0] for leg in LEGS]
    assert_allclose(np.subtract(after, before), size * (np.array(LEGS) == "FR"), atol=1e-12)
    assert foot_parts(spec, "FR")[1].size[0] == pytest.approx(1.3 * after[LEGS.index("FR")])
