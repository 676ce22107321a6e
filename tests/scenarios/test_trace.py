"""The loop closes: an effect nobody declared is named with its size, and a plain walk has none."""

import json
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from refusals import refused
from synthetic import without

from surefoot import Robot, Scenario, walk
from surefoot.extend import Ground, Patch, Segment, effect
from surefoot.models.attribution.data import dead_contacts, readings, split_of, untraceable_reason
from surefoot.models.attribution.diagnose import logs_under_model
from surefoot.models.attribution.evidence import log_under_model
from surefoot.models.attribution.noise_floor import ground_of, noise_floor, noise_floor_with
from surefoot.scenarios.trace.report import summary
from surefoot.scenarios.trace.run import OUTPUTS, TraceOptions, trace, trace_logs
from surefoot.sim.effects.file import load_effects
from surefoot.sim.importing.sections import EVENNESS
from surefoot.sim.log import Log, Meta

ROBOT = Robot.load("spot_class")
COURSE = (
    Segment(5.0, 0.7),
    Segment(5.0, 0.5, turn=0.5),
    Segment(4.0, 0.8),
    Segment(5.0, 0.4, turn=-0.6),
    Segment(5.0, 0.6, lateral=0.1),
    Segment(6.0, 0.5, turn=0.4),
)
SLIPPERY = tuple(Patch(x, 0.5, 1.2, 3.0, 0.2) for x in (1.5, 4.5))


@lru_cache
def log_with(*one, slippery=True, seed=0):
    ground = Ground(0.8, SLIPPERY if slippery else ())
    effects = [effect(*one)] if one else []
    return walk(Scenario("loop", COURSE, ground), ROBOT, seed, effects=effects, declared=False)


@pytest.mark.parametrize(
    ("one", "gain"),
    [
        (("encoder_offset", "RL_thigh", -0.02), 1.0),
        pytest.param(("foot_rolling", "all", 0.006), 0.8, marks=pytest.mark.long),
    ],
    ids=["encoder_offset", "foot_rolling"],
)
def test_an_undeclared_effect_is_named_with_its_size(one, gain):
    """And the leg filter errs less once it is known."""
    found = trace_logs([log_with(*one)], ROBOT)
    assert found.verdict == "attributed"
    assert [(e.name, e.target) for e in found.effects] == [one[:2]]
    low, high = found.found[0].interval
    assert found.effects[0].value == pytest.approx(one[2], rel=0.1) or low < one[2] < high
    channel = found.channels["leg_velocity"]
    assert channel.after < 0.95 * channel.before
    assert channel.noise_floor is not None
    assert channel.after < 1.25 * channel.noise_floor
    before, after = (found.filters["leg"][k] for k in ("before", "after"))
    assert after["rpe_trans"] < gain * before["rpe_trans"]
    assert all(np.isfinite(list(after.values())))


@pytest.mark.parametrize("slippery", [pytest.param(True, marks=pytest.mark.long), False])
def test_a_walk_as_declared_lacks_nothing(slippery):
    found = trace_logs([log_with(slippery=slippery)], ROBOT, TraceOptions(contacts=("others",)))
    assert found.verdict == "no_residual"
    assert found.effects == ()
    assert "others" not in found.notes, "its contacts are as punctual as the model's"
    delay = next(c for c in found.rounds[0] if c.key == ("joint_delay", "all"))
    assert abs(delay.size) < 2e-4


@pytest.mark.long
def test_ice_on_which_feet_slide_only_as_they_land_is_no_effect():
    """Their touchdowns seem late, by the time for which they slide."""
    ice = Patch(2.5, 0.0, 1.5, 2.0, 0.1), Patch(4.5, 2.0, 2.0, 2.0, 0.15)
    laps = (Segment(8.0, 0.5), Segment(4.0, 0.3, turn=0.5)) * 2
    log = walk(Scenario("ice", laps, Ground(0.7, ice)), ROBOT, 2, declared=False)
    found = trace_logs([log], ROBOT)
    assert found.friction is not None
    assert found.friction.slides == 0, "else the floor's walks cross slippery places, too"
    assert found.verdict == "no_residual"


def stripped(log):
    """What a stranger would send: no scenario, seed, effects, versions or truth, another name."""
    meta = Meta(rate=log.meta.rate, robot=log.meta.robot)
    return Log(without(log, "slip_", "mu_").frame, meta, "a_stranger")


@pytest.mark.long
def test_the_same_trace_of_a_log_that_tells_nothing_of_itself(tmp_path):
    log = log_with("encoder_offset", "RL_thigh", -0.02)
    # A bundled course is one that a radar can be simulated on: not for a log that tells its name.
    meta = replace(log.meta, effects=({"name": "gyro_scale"},), scenario="demo_walk")
    named = replace(log, meta=meta)
    stripped(log).write(tmp_path / "x.parquet")
    trace([named], ROBOT, tmp_path / "a")
    trace([Log.read(tmp_path / "x.parquet")], ROBOT, tmp_path / "b")
    texts = [(tmp_path / d / "trace.json").read_text() for d in ("a", "b")]
    assert texts[0] == texts[1]
    said = json.loads(texts[0])
    assert said["effects"][0]["unit"] == "rad"
    assert len(said["channels"]) == 11
    for name in OUTPUTS:
        assert (tmp_path / "a" / name).stat().st_size > 0
    assert load_effects(tmp_path / "a" / "effects.toml")[0].target == "RL_thigh"
    # Nothing is overwritten unless asked, and nothing is computed before that is known.
    refused("exists already", trace, [named], ROBOT, tmp_path / "a")


@pytest.mark.long
def test_a_leg_is_measured_on_a_floor_that_is_no_more_even_than_floors_are():
    """Its map says so; the model then walks on such a floor too, and 2 mm of a calf are seen."""
    ground = ground_of(COURSE, EVENNESS, 0.8)
    one = effect("link_length", "RR_calf", 0.002)
    log = walk(Scenario("uneven", COURSE, ground), ROBOT, 4, effects=[one], declared=False)
    log = replace(log, meta=replace(log.meta, model={"ground_evenness": EVENNESS}))
    found = trace_logs([log], ROBOT)
    assert found.verdict == "attributed"
    assert [(e.name, e.target) for e in found.effects] == [("link_length", "RR_calf")]
    low, high = found.found[0].interval
    assert low < one.value < high
    assert any("even to 1.3 mm" in note for note in found.notes)


def test_without_legs_the_imu_is_still_traced(tmp_path):
    log = without(log_with("gyro_scale", "x", 0.02), "q_", "dq_", "tau_", "contact_")
    found = trace([log], ROBOT, tmp_path)
    assert not (tmp_path / "trace.rrd").exists()  # it shows the robot's legs
    assert [(e.name, e.target) for e in found.effects] == [("gyro_scale", "x")]
    assert found.effects[0].value == pytest.approx(0.02, rel=0.1)
    assert set(found.channels) == {"imu_gyro", "imu_accel"}
    assert any("leg_velocity: not used" in note for note in found.notes)
    assert "gyro_scale x" in summary(found)


def test_a_walk_without_an_imu_ends_in_a_verdict(tmp_path):
    found = trace([without(log_with(), "gyro_", "accel_")], ROBOT, tmp_path / "out")
    assert found.verdict in ("no_residual", "not_identifiable", "none_of_these")
    assert not {"imu_gyro", "imu_accel"} & set(found.channels)


def test_a_reference_that_covers_half_a_second_is_not_identifiable():
    log = log_with()
    known = log.with_columns({"ref_ok": (log.t > log.t[-1] - 0.5).astype(float)})
    found = trace_logs([known], ROBOT)
    assert found.verdict == "not_identifiable"
    assert "too little reference" in summary(found)


@pytest.mark.parametrize("columns", [("ref_p", "ref_q", "ref_v"), ("ref_p",), ("ref_q",)])
@pytest.mark.parametrize("noise", [0.0, 1e-8])
def test_a_reference_that_never_changes_ends_the_trace_at_once(columns, noise):
    log = log_with()
    rng = np.random.default_rng(0)
    held = [str(n) for n in log.frame if str(n).startswith(columns)]
    frozen = log.frame[held].to_numpy()[:1] + noise * rng.normal(size=(len(log.t), len(held)))
    still = log.with_columns(dict(zip(held, frozen.T, strict=True)))
    # Before a floor is simulated, which takes minutes where every effect seems to be there.
    for one, why in ((still, f"{columns[0]} never changes"), (log, "")):
        (case,) = logs_under_model([one], ROBOT, ())
        said = untraceable_reason([case], split_of([case]))
        assert said.startswith(why)
        assert bool(said) == bool(why)


@pytest.mark.parametrize("dead", [("RR",), ("FL", "FR", "RL", "RR")])
def test_contacts_that_never_change_while_the_robot_walks_are_not_believed(dead):
    log = log_with()
    assert dead_contacts(log) == ""
    broken = replace(log, frame=log.frame.assign(**{f"contact_{leg}": 0.0 for leg in dead}))
    assert f"no change in contact_{dead[0]}" in dead_contacts(broken)
    assert not readings(broken).has("contact")
    assert readings(log).has("contact")
    still = replace(broken, frame=broken.frame.assign(ref_p_x=0.0, ref_p_y=0.0))
    assert (dead_contacts(still) == "") == (len(dead) == 4)  # one that stands or hangs still


def test_a_walk_without_a_reference_and_legs_ends_in_a_verdict(tmp_path):
    log = without(log_with(), "q_", "dq_", "tau_", "contact_", "force_", "ref_")
    found = trace([log], ROBOT, tmp_path / "out")
    assert found.verdict == "not_identifiable"
    assert "no channel: the log lacks" in summary(found)
    assert (tmp_path / "out" / "report.html").exists()


@pytest.mark.long
def test_a_size_that_rounding_takes_to_its_bound_is_walked_within_it():
    floor = noise_floor([log_under_model(log_with(), ROBOT)])
    assert noise_floor_with(floor, [effect("link_length", "RL_thigh", 0.02996)]).walks
