"""Effects: what they put into the simulation is what they say, and files of them are checked."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from refusals import refused

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.gravity import GRAVITY
from surefoot.sim.effects import CATALOGUE, effect
from surefoot.sim.effects.base import with_columns
from surefoot.sim.effects.file import load_effects, save_effects
from surefoot.sim.effects.resampling import reference_lag, reference_lag_drift
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.physics.scene import TIMESTEP, robot_spec
from surefoot.sim.robot.kinematics import feet
from surefoot.sim.robot.legs import LEGS, find_legs
from surefoot.sim.robot.limbs import QUADRUPED
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.sensors.streams import Streams
from surefoot.sim.walk import walk


@pytest.fixture(scope="module")
def log(robot):
    """A short walk: lags are sought in it often."""
    segments = (Segment(2.0, 0.5, turn=0.4),)
    return walk(Scenario("short", segments, Ground(0.8), stand=0.3), robot, seed=3)


@pytest.fixture
def streams():
    rng = np.random.default_rng(0)
    t = 0.002 * np.arange(500)
    smooth = np.sin(2 * np.pi * rng.uniform(0.5, 2, 12) * t[:, None])
    return Streams(
        t=t,
        gyro=rng.normal(size=(500, 3)),
        accel=rng.normal(size=(500, 3)),
        q=smooth,
        dq=2 * smooth,
        tau=3 * smooth,
        tau_ff=3 * smooth,
        force=np.ones((500, 4)),
    )


def edited(robot, one):
    spec = robot_spec(robot)
    one.edit_spec(spec, robot)
    model = spec.compile()
    return model, find_legs(model, robot.name)


@pytest.mark.parametrize("target", [f"{leg}_{link}" for leg in LEGS for link in ("thigh", "calf")])
def test_link_length_moves_the_foot_of_the_compiled_model_as_explained(robot, log, target):
    """Two roads to the same leg: MuJoCo's edited bodies, and the constants that a filter uses."""
    one = effect("link_length", target, 0.007)
    _, tree = edited(robot, one)
    q = np.random.default_rng(1).uniform(-0.5, 0.5, (20, 12)) + robot.q_home
    simulated = feet(tree.constants, q, robot.R_BI, robot.p_BI)[0]
    _, known = one.compensate(log, robot)
    assert_allclose(known.feet_I(q), simulated, atol=1e-12)
    moved = np.linalg.norm(simulated - robot.feet_I(q), axis=2)
    leg = LEGS.index(target[:2])
    assert_allclose(moved[:, leg], 0.007, atol=1e-12)
    assert_allclose(np.delete(moved, leg, axis=1), 0.0, atol=1e-12)


def test_foot_rolling_changes_the_radius_and_leaves_the_centres(robot, log):
    one = effect("foot_rolling", "all", 0.005)
    _, tree = edited(robot, one)
    assert_allclose(tree.foot_radius, robot.foot_radius + 0.005)
    assert_allclose(tree.constants.foot, robot.legs.foot)
    assert_allclose(one.compensate(log, robot)[1].foot_radius, tree.foot_radius)


def test_foot_rolling_leaves_every_foot_a_radius(robot):
    with pytest.raises(SurefootError, match=r"foot FL has only .* m, from which 0.04"):
        edited(robot, effect("foot_rolling", "all", -0.04))


def test_a_walk_keeps_its_effects_to_itself_when_undeclared(robot):
    scenario = Scenario("tiny", (Segment(0.5, 0.2),), Ground(0.8), stand=0.2)
    one = effect("encoder_offset", "FL_hip", 0.02)
    plain = walk(scenario, robot, 1)
    hidden = walk(scenario, robot, 1, effects=[one], declared=False)
    told = walk(scenario, robot, 1, effects=[one])
    assert hidden.meta == plain.meta
    assert told.meta.effects == (one.as_dict(),)
    assert_allclose(hidden.q[:, 0] - plain.q[:, 0], 0.02, atol=4e-4)
    assert_array_equal(hidden.ref_p, plain.ref_p)


@given(st.data())
def test_files_give_back_what_was_saved(tmp_path_factory, data):
    name = data.draw(st.sampled_from(sorted(CATALOGUE)))
    kind = CATALOGUE[name]
    target = data.draw(st.sampled_from(kind.targets_on(QUADRUPED) or kind.targets))
    bounds = kind.interior_bounds(target) if kind.is_compensated() else kind.bounds
    one = effect(name, target, data.draw(st.floats(*bounds)))
    path = tmp_path_factory.mktemp("effects") / "e.toml"
    save_effects(path, [one])
    assert load_effects(path) == (one,)


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


def test_a_file_of_no_effects(tmp_path):
    save_effects(tmp_path / "none.toml", [])
    assert load_effects(tmp_path / "none.toml") == ()
    refused("exists already", save_effects, tmp_path / "none.toml", [])


GOOD = 'name = "encoder_offset"\ntarget = "FL_hip"\nvalue = 0.02\nunit = "rad"\n'


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[[effect]\n", "not valid TOML"),
        ("colour = 1\n", "unknown key 'colour'"),
        ("[[effect]]\n" + GOOD + "size = 1\n", r"\[\[effect\]\] 1 unknown key 'size'"),
        ("[[effect]]\n" + GOOD.replace("unit", "#"), "1 unit is missing"),
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


def test_no_such_file(tmp_path):
    refused("No such file", load_effects, tmp_path / "missing.toml")


@pytest.mark.parametrize("target", ["touchdown", "liftoff"])
def test_contact_delay_leaves_a_foot_that_never_swings(robot, streams, target):
    late = effect("contact_delay", target, 0.03).alter_streams(streams, robot)
    assert_array_equal(late.force, streams.force)


@pytest.mark.parametrize("late", [-0.03, 0.0, 0.028])
def test_a_search_for_a_delay_begins_where_gyro_and_reference_turn_alike(log, robot, late):
    """Shaking is far from linear in 28 ms; that the two agree elsewhere is seen at once."""
    moved, _ = effect("reference_delay", "all", -late).compensate(log, robot)
    assert reference_lag(moved, 0.2) == pytest.approx(late, abs=1.5 / log.rate)
    found = {n: CATALOGUE[n].starts_on("all", moved) for n in ("reference_delay", "imu_delay")}
    assert len(found["imu_delay"]) == len(found["reference_delay"]) == (2 if late else 1)
    if late:
        assert found["imu_delay"][1] == -found["reference_delay"][1]


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
def test_no_drift_is_seen_in_a_gyro_that_shows_nothing_of_the_turning(log, seed):
    """Each piece's lag is any; the search for a clock begins at a small size alone."""
    noise = np.random.default_rng(seed).normal(0.0, 0.01, log.gyro.shape)
    columns = {f"gyro_{axis}": noise[:, i] for i, axis in enumerate("xyz")}
    deaf = with_columns(log, columns)
    assert reference_lag_drift(deaf, 0.02) == 0.0
    assert len(CATALOGUE["clock_scale"].starts_on("imu", deaf)) == 1


def test_contact_delay_is_late_by_its_size_whatever_the_threshold(robot, streams):
    """Loads that fall off within 0.1 s, four steps a second, all feet alike."""
    step = np.clip(np.arange(125) - 20.0, 0.0, 30.0) - np.clip(np.arange(125) - 60.0, 0.0, 30.0)
    weight = robot.mass * GRAVITY
    force = np.repeat(np.tile(step / 30.0, 4)[:, None], 4, axis=1) * weight
    for share in (0.08, 0.4):
        own = replace(streams, force=force, contact_threshold=share)
        late = effect("contact_delay", "liftoff", 0.02).alter_streams(own, robot)
        ends = [
            np.flatnonzero(np.diff((f > share * weight)[:, 0].astype(int)) < 0)
            for f in (force, late.force)
        ]
        assert np.diff(streams.t[ends], axis=0).mean() == pytest.approx(0.02, abs=0.002)


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
