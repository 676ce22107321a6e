"""Effects: what they put into the simulation is what they say, and files of them are checked."""

from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from refusals import refused
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation
from synthetic import synthetic_walk

from surefoot.sim.common.gravity import GRAVITY
from surefoot.sim.effects import CATALOGUE, effect
from surefoot.sim.effects.body import FootRolling
from surefoot.sim.effects.contact import ContactDelay, FootSlip
from surefoot.sim.effects.drive import Backlash, CoulombFriction, ViscousFriction
from surefoot.sim.effects.file import load_effects, save_effects
from surefoot.sim.effects.readings import TorqueScale
from surefoot.sim.effects.timing import (
    JointDelay,
    TorqueDelay,
    reference_lag,
    reference_lag_drift,
)
from surefoot.sim.ground.terrain import Ground, Patch, Strip
from surefoot.sim.log import JOINTS, LEGS, Log, MemoisedLog, Meta
from surefoot.sim.log.schema import named_columns
from surefoot.sim.physics.drives import foot_parts
from surefoot.sim.physics.scene import TIMESTEP, robot_spec
from surefoot.sim.robot.limbs import QUADRUPED, Limbs
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.sensors.streams import Streams
from surefoot.sim.walk import walk


@pytest.fixture(scope="module")
def walked(robot):
    """A short walk: lags are sought in it often."""
    segments = (Segment(2.0, 0.5, turn=0.4),)
    return walk(Scenario("short", segments, Ground(0.8), stand=0.3), robot, seed=3)


def test_foot_rolling_leaves_every_foot_a_radius(robot):
    larger = effect("foot_rolling", "all", -0.04)
    refused(r"foot FL has only .* m, from which 0.04", larger.edit_spec, robot_spec(robot), robot)


@settings(deadline=None)
@given(st.data())
def test_files_give_back_what_was_saved(tmp_path_factory, data):
    name = data.draw(st.sampled_from(sorted(CATALOGUE)))
    kind = CATALOGUE[name]
    target = data.draw(st.sampled_from(kind.targets_on(QUADRUPED) or kind.targets))
    bounds = kind.interior_bounds(target) if kind.is_compensated() else kind.bounds
    one = effect(name, target, data.draw(st.floats(*bounds)))
    for effects in ((one,), ()):
        path = tmp_path_factory.mktemp("effects") / "e.toml"
        save_effects(path, effects)
        assert load_effects(path) == effects


@pytest.mark.parametrize("name", sorted(CATALOGUE))
def test_bounds_are_those_of_either_sign_and_leave_room_for_a_step(name):
    kind = CATALOGUE[name]
    low, high = kind.bounds
    # Contacts are sensed late rather than early; a link may weigh six times as much, and half.
    assert low in (0.0, -high) or name in ("contact_delay", "link_mass")
    if kind.is_compensated() and name != "contact_delay":  # no touch-down is sensed early
        for target in kind.single_targets(QUADRUPED):
            inner, step = kind.interior_bounds(target), kind.traced_at(target).step
            assert_allclose([inner[0] - low, high - inner[1]], 1.1 * step)


GOOD = 'name = "encoder_offset"\ntarget = "FL_hip"\nvalue = 0.02\nunit = "rad"\n'


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[[effect]]\n" + GOOD.replace('"rad"', '"deg"'), "unit of encoder_offset must be 'rad'"),
        (
            "[[effect]]\n" + GOOD.replace("encoder_offset", "gyro_bias").replace("rad", "rad/s"),
            "unknown target 'FL_hip'; known: x, y, z",
        ),
        ("[[effect]]\n" + GOOD + "[[effect]]\n" + GOOD, r"\[\[effect\]\] 2 .* twice"),
    ],
)
def test_a_bad_file_is_one_clear_line(tmp_path, text, said):
    path = tmp_path / "effects.toml"
    path.write_text(text)
    assert str(path) in refused(said, load_effects, path)


@pytest.mark.parametrize("target", ["touchdown", "liftoff"])
def test_contact_delay_leaves_a_foot_that_never_swings(robot, target):
    streams = still(500, force=np.ones((500, 4)))
    late = effect("contact_delay", target, 0.03).alter_streams(streams, robot)
    assert_array_equal(late.force, streams.force)


@pytest.mark.parametrize("late", [-0.03, 0.0, 0.028])
def test_a_search_for_a_delay_begins_where_gyro_and_reference_turn_alike(walked, robot, late):
    """Shaking is far from linear in 28 ms; that the two agree elsewhere is seen at once."""
    moved, _ = effect("reference_delay", "all", -late).compensate(walked, robot)
    assert reference_lag(moved, 0.2) == pytest.approx(late, abs=1.5 / walked.rate)
    found = {n: CATALOGUE[n].starts_on("all", moved) for n in ("reference_delay", "imu_delay")}
    assert len(found["imu_delay"]) == len(found["reference_delay"]) == (2 if late else 1)
    if late:
        assert found["imu_delay"][1] == -found["reference_delay"][1]


def test_a_tenth_of_a_row_of_delay_keeps_the_noise_of_a_references_attitude(walked, robot):
    """Else a search for a delay finds the half of a row that leaves the least noise."""
    noise = np.random.default_rng(0).normal(0.0, 1e-3, (len(walked.t), 3))
    q = Rotation.from_rotvec(noise).as_quat(scalar_first=True)
    noisy = walked.with_columns(named_columns("ref_q", q, "wxyz"))
    late, _ = effect("reference_delay", "all", 0.1 / walked.rate).compensate(noisy, robot)
    before, after = (np.std(np.diff(one.ref_q, axis=0)) for one in (noisy, late))
    assert after == pytest.approx(before, rel=0.03)


def test_whatever_stream_a_delay_shifts_may_be_noisy():
    """Else a search takes what interpolation smooths of the noise for a delay of that stream."""
    names = ("joint_delay", "imu_delay", "torque_delay", "rate_delay", "reference_delay")
    assert {CATALOGUE[name].shift_in(20.0) for name in names} == {1.0}


@pytest.mark.parametrize("drift", [-0.004, 3e-5, 0.006])
def test_a_search_for_a_clock_begins_where_the_lag_drifts(robot, drift):
    """A clock that is out by 4 parts in a thousand is 36 ms late after 9 s, and 28 ms are far from
    linear."""
    scenario = Scenario("clock", (Segment(8.5, 0.5, turn=0.4),), Ground(0.8), stand=0.5)
    log = walk(scenario, robot, 3, [effect("clock_scale", "imu", drift)], declared=False)
    assert reference_lag_drift(log, 0.02) == pytest.approx(drift, abs=3e-4)
    kind, far = CATALOGUE["clock_scale"], abs(drift) > 1e-3
    starts = {stream: kind.starts_on(stream, log) for stream in ("imu", "reference", "joints")}
    assert [len(of) for of in starts.values()] == [1 + far, 1 + far, 1]
    if far:
        assert starts["imu"][1] == -starts["reference"][1] == pytest.approx(drift, abs=3e-4)


@pytest.mark.parametrize("seed", range(8))
def test_no_drift_is_seen_in_a_gyro_that_shows_nothing_of_the_turning(walked, seed):
    """Each piece's lag is any; the search for a clock begins at a small size alone."""
    noise = np.random.default_rng(seed).normal(0.0, 0.01, walked.gyro.shape)
    deaf = walked.with_columns(named_columns("gyro", noise))
    assert reference_lag_drift(deaf, 0.02) == 0.0
    assert len(CATALOGUE["clock_scale"].starts_on("imu", deaf)) == 1


def test_contact_delay_is_late_by_its_size_whatever_the_threshold(robot):
    """Loads that fall off within 0.1 s, four steps a second, all feet alike."""
    step = np.clip(np.arange(125) - 20.0, 0.0, 30.0) - np.clip(np.arange(125) - 60.0, 0.0, 30.0)
    weight = robot.mass * GRAVITY
    force = np.repeat(np.tile(step / 30.0, 4)[:, None], 4, axis=1) * weight
    for share in (0.08, 0.4):
        own = still(500, force=force, contact_threshold=share)
        late = effect("contact_delay", "liftoff", 0.02).alter_streams(own, robot)
        ends = [
            np.flatnonzero(np.diff((f > share * weight)[:, 0].astype(int)) < 0)
            for f in (force, late.force)
        ]
        assert np.diff(own.t[ends], axis=0).mean() == pytest.approx(0.02, abs=0.002)


@pytest.mark.parametrize("late", [(3e-4,), (3e-4, 4e-4), (1e-3, 1.5e-3), (2e-3,), (3.1e-3,)])
def test_motors_are_late_by_what_is_said_less_than_a_step_too(robot, late):
    spec = robot_spec(robot)
    for value in late:
        effect("command_delay", "all", value).edit_spec(spec, robot)
    spec.option.timestep = TIMESTEP
    model = spec.compile()
    data = mujoco.MjData(model)
    for k in range(40):
        data.ctrl[:] = 0.01 * k
        mujoco.mj_step(model, data)
    behind = TIMESTEP * (39 - data.actuator_force / 0.01)
    assert_allclose(behind, sum(late), atol=1e-9)


COLUMNS = {"gyro": "xyz", "accel": "xyz", "q": JOINTS, "dq": JOINTS, "tau": JOINTS}


@pytest.fixture(scope="module")
def log() -> Log:
    return synthetic_walk(0, 4.0, robot="spot_class")


def still(rows: int, **readings) -> Streams:
    """Readings of a robot that rests, but for some."""
    widths = {"gyro": 3, "accel": 3, "q": 12, "dq": 12, "tau": 12, "tau_ff": 12, "force": 4}
    zeros: dict[str, Any] = {name: np.zeros((rows, width)) for name, width in widths.items()}
    return Streams(0.002 * np.arange(rows), **zeros | readings)


def log_of(t, **columns) -> Log:
    """A log of joints that rest, but for some columns."""
    rest = {f"{kind}_{joint}": 0.0 * t for kind in ("q", "dq", "tau") for joint in JOINTS}
    return Log(pd.DataFrame({"t": t} | rest | columns), Meta(rate=1.0 / (t[1] - t[0])))


def streams_of(log: Log) -> Streams:
    return Streams(
        log.t, log.gyro, log.accel, log.q, log.dq, log.tau, log.tau, np.ones((len(log.t), 4))
    )


def changed(names: str, place: int, factor: float = 1.0, by: float = 0.0):
    def readings(before: Streams) -> dict[str, np.ndarray]:
        at = np.arange(12)[: getattr(before, names.split()[0]).shape[1]] == place
        return {n: getattr(before, n) * np.where(at, factor, 1.0) + by * at for n in names.split()}

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
    ("name", "target", "value", "readings"),
    [
        ("accel_bias", "z", -0.3, changed("accel", 2, by=-0.3)),
        ("accel_scale", "z", 0.05, changed("accel", 2, factor=1.05)),
        ("gyro_bias", "y", 0.05, changed("gyro", 1, by=0.05)),
        ("gyro_scale", "z", -0.02, changed("gyro", 2, factor=0.98)),
        (
            "gyro_g_sensitivity",
            "z",
            0.002,
            lambda s: {"gyro": s.gyro + 0.002 * s.accel * [0, 0, 1]},
        ),
        ("encoder_offset", "FR_calf", 0.03, changed("q", 5, by=0.03)),
        ("encoder_scale", "FR_calf", 0.02, changed("q dq", 5, factor=1.02)),
        ("torque_scale", "FL_calf", 0.1, changed("tau", 2, factor=1.1)),
        ("torque_bias", "FL_calf", -2.0, changed("tau", 2, by=-2.0)),
        ("torque_delay", "all", 0.006, late(0.006, "tau")),
        ("rate_delay", "all", 0.006, late(0.006, "dq")),
        ("joint_delay", "all", 0.004, late(0.004, "q", "dq", "tau")),
        ("imu_delay", "all", -0.01, late(-0.01, "gyro", "accel")),
        ("imu_rotation", "x", -0.04, turned(-0.04)),
    ],
)
def test_readings_change_by_the_formula_and_a_model_that_knows_takes_it_back(
    log, robot, name, target, value, readings
):
    one, before, inside = effect(name, target, value), streams_of(log), slice(10, -10)
    after = one.alter_streams(before, robot)
    wanted = readings(before)
    for group in (*COLUMNS, "t", "tau_ff", "force"):
        same = getattr(before, group)
        assert_allclose(getattr(after, group)[inside], wanted.get(group, same)[inside], atol=1e-9)
    known = log
    for name, places in COLUMNS.items():
        known = known.with_columns(named_columns(name, getattr(after, name), places))
    known, _ = one.compensate(known, robot)
    for name in COLUMNS:
        assert_allclose(getattr(known, name)[inside], getattr(log, name)[inside], atol=1e-9)


def test_a_current_may_say_half_of_a_torque_and_not_less(robot):
    """With half of it, a joint's torque is twice what was read; beyond, it is of another motor."""
    before = still(3, tau=np.full((3, 12), 4.0))
    after = TorqueScale("FL_calf", -0.5).alter_streams(before, robot)
    assert_array_equal(after.tau[:, 2], 2.0)
    refused(r"torque_scale \S+: value must lie between -0\.5 ", TorqueScale, "FL_calf", -0.52)


def test_torques_at_1_khz_are_varied_by_a_row_as_it_was_read(robot):
    """Between rows they would be interpolated, which smooths their noise."""
    t = 1e-3 * np.arange(60)
    tau = np.random.default_rng(5).normal(0.0, 1.0, (len(t), len(JOINTS)))
    log = log_of(t, **named_columns("tau", tau, JOINTS))
    known, _ = TorqueDelay("all", TorqueDelay.traced.step).compensate(log, robot)
    assert_allclose(known.tau[:-1], tau[1:], atol=1e-9)


def test_dry_friction_turns_round_within_a_hundredth_of_a_joints_rate(robot):
    """Of a rate without noise: at a hundredth of its RMS, tanh(1) of the friction is there."""
    t = 0.01 * np.arange(400)
    rate = np.sin(2.0 * np.pi * t + np.arcsin(0.01 * np.sqrt(0.5)))
    known, _ = CoulombFriction("FL_calf", 2.0).compensate(log_of(t, dq_FL_calf=rate), robot)
    assert known.tau[::100, 2] == pytest.approx(-2.0 * np.tanh(1.0), rel=1e-6)


def test_a_motor_without_torque_stays_on_the_side_where_it_lay(robot):
    tau = np.array([0.0, 2.0, 0.0, 0.0, -1.0, 0.0, 0.5])
    torques = np.outer(tau, np.eye(12)[1])
    after = Backlash("FL_thigh", 0.02).alter_streams(still(len(tau), tau=torques), robot)
    assert_allclose(after.q, np.outer([0, 1, 1, 1, -1, -1, 1], 0.01 * np.eye(12)[1]))


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
def test_contacts_that_begin_early_are_cut_by_what_debouncing_has_left(log, robot, debounce, cut):
    """30 ms early at 500 Hz; what is not cut is known to the model."""
    contact = np.ones((len(log.t), 4))
    contact[300:400, 1] = 0.0
    early = log.with_columns(named_columns("contact", contact, LEGS))
    early = replace(early, meta=replace(early.meta, model={"contact_debounce": debounce}))
    known, late_by = ContactDelay("touchdown", -0.03).compensate(early, robot)
    assert_array_equal(np.flatnonzero(~known.contact[:, 1]), np.arange(300, 400 + cut))
    assert known.contact[:, [0, 2, 3]].all()
    assert late_by.extras.touchdown_late == pytest.approx(cut / 500.0 - 0.03)


def test_delays_of_logs_one_after_the_other_do_not_mix_them_up(log, robot):
    """Splines are kept while the columns are the same arrays."""
    log = MemoisedLog.of(log)
    doubled = log.with_columns(named_columns("q", 2.0 * log.q, JOINTS))
    for value in (1e-3, 4e-3):
        one, other = (
            JointDelay("all", value).compensate(each, robot)[0] for each in (log, doubled)
        )
        assert_allclose(other.q, 2.0 * one.q, rtol=1e-12, atol=1e-12)
        assert_array_equal(other.dq, one.dq)
        assert_allclose(one.q, CubicSpline(log.t, log.q)(np.clip(log.t + value, None, log.t[-1])))


def test_what_was_declared_of_one_joint_may_be_less_there_alone():
    limbs = Limbs((), ("a", "b"), (), declared=((("coulomb_friction", "a"), 0.4),))
    most = CoulombFriction.bounds[1]
    assert CoulombFriction.bounds_on(limbs, "a") == (-0.5, most)
    assert CoulombFriction.bounds_on(limbs, "b") == (0.0, most)
    assert CoulombFriction.bounds_on(limbs) == CoulombFriction.bounds_on(None, "a") == (0.0, most)
    assert ViscousFriction.bounds_on(limbs, "a") == ViscousFriction.bounds


@pytest.mark.parametrize("size", [0.01, -0.01])
def test_a_foot_that_rolls_has_a_larger_radius_in_simulator_and_model(log, robot, size):
    spec = robot_spec(robot)
    before = [foot_parts(spec, leg)[0].size[0] for leg in LEGS]
    FootRolling("FR", size).edit_spec(spec, robot)
    after = [foot_parts(spec, leg)[0].size[0] for leg in LEGS]
    assert_allclose(np.subtract(after, before), size * (np.array(LEGS) == "FR"), atol=1e-12)
    known = FootRolling("FR", size).compensate(log, robot)[1]
    assert_allclose(known.foot_radius, after, atol=1e-12)
    assert foot_parts(spec, "FR")[1].size[0] == pytest.approx(1.3 * after[LEGS.index("FR")])
