"""Logs without a reference, and references whose samples are fewer than rows."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from slopes import apart, regressor_of, slope_of, step_of

from surefoot.models.attribution.data import _not_identifiable
from surefoot.models.attribution.diagnose import diagnose
from surefoot.models.attribution.evidence import (
    all_keys,
    channels_of,
    log_under_model,
    table_of,
)
from surefoot.models.attribution.sensor_noise import (
    ReferenceSampling,
    reference_notes,
    reference_sampling,
    resample_reference,
)
from surefoot.models.residuals.feet import between_feet
from surefoot.models.residuals.layout import layout_for
from surefoot.models.residuals.motion import with_dead_reckoning
from surefoot.sim.effects import effect
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.walk import walk
from surefoot.sim.walking.imitation import body_twists

SPOT = Robot.load("spot_class")


SHORT = Scenario("short", (Segment(4.0, 0.5, 0.1, 0.3),), Ground(0.8))


TURNS = ((0.5, 0.0, 0.2), (0.6, 0.0, 0.5), (0.3, 0.1, -0.5), (0.6, 0.0, 0.0))


LONG = Scenario("long", tuple(Segment(4.0, *twist) for twist in TURNS), Ground(0.8))


def without_reference(log, *groups):
    """The log less its reference, what only a simulation has, and columns of these prefixes."""
    gone = ("ref_", "slip_", "mu_", *groups)
    kept = [name for name in log.frame if not str(name).startswith(gone)]
    return Log(log.frame[kept].copy(), log.meta, log.name)


@pytest.fixture(scope="module")
def short():
    return walk(SHORT, SPOT, 7)


@pytest.fixture(scope="module")
def case(short):
    return log_under_model(without_reference(short), SPOT)


def test_feet_against_each_other_know_nothing_of_the_body_and_count_once():
    rng = np.random.default_rng(0)
    v = rng.normal(size=(20_000, 4, 3))
    v[:, 1] = np.nan
    v[:100, 2:] = np.nan
    against = between_feet(v.reshape(len(v), -1))
    moved = between_feet((v + rng.normal(size=(len(v), 1, 3))).reshape(len(v), -1))
    np.testing.assert_allclose(against, moved, atol=1e-12)
    # One foot alone is held against none; of three, two differences, white as the feet were.
    by_leg = against.reshape(v.shape)
    assert np.isnan(by_leg[:100]).all()
    assert np.isnan(by_leg[:, :2]).all()
    white = np.cov(by_leg[100:, 2:, 0].T)
    np.testing.assert_allclose(white, np.eye(2), atol=0.03)


def test_legs_and_imu_reckon_the_course_of_a_walk(short):
    # Feet creep and roll: a floor's course needs no more.
    reckoned = with_dead_reckoning(without_reference(short), SPOT.feet)
    assert reckoned is not None
    np.testing.assert_allclose(body_twists(reckoned), body_twists(short), atol=0.05)


def test_channels_that_need_a_reference_are_left_out(case, short):
    there = {"leg_velocity", "stance_velocity", "joint_torque", "joint_rate"}
    assert not case.fixed
    assert set(channels_of(case)) - {"command"} == there
    layout, table = layout_for(SPOT.limbs), table_of(case, ())
    for name, columns in layout.channels.items():
        assert np.isfinite(table[:, columns]).any() == (name in channels_of(case)), name
    names = {name for name, _ in all_keys(case)}
    assert {"encoder_offset", "link_length", "gyro_bias", "backlash"} & names
    assert not names & {"imu_position", "accel_bias", "payload", "reference_delay", "contact_delay"}
    # Without an IMU legs say nothing of each other either.
    bare = log_under_model(without_reference(short, "gyro_", "accel_"), SPOT)
    assert set(channels_of(bare)) - {"command"} == {"joint_rate"}
    columns = layout.of("joint_torque", "leg_velocity")
    assert not np.isfinite(table_of(bare, ())[:, columns]).any()


@pytest.mark.parametrize(
    ("name", "target"),
    [
        ("encoder_offset", "RL_calf"),
        ("link_length", "FR_calf"),
        ("gyro_bias", "z"),
        ("foot_rolling", "all"),
    ],
)
def test_regressors_are_the_slopes_of_what_feet_say_of_each_other(case, name, target):
    key = (name, target)
    slope = slope_of(case, key, step_of(key))
    for channel in ("leg_velocity", "stance_velocity"):
        columns = layout_for(SPOT.limbs).of(channel)
        assert apart(regressor_of(case, key, slope), slope, columns) < 0.03, channel


def test_only_what_a_reference_would_show_is_said_to_need_one(case):
    """Without torques a reference would not show friction either."""
    frame = case.log.frame
    frame = frame.drop(columns=[name for name in frame if str(name).startswith("tau_")])
    without_torques = log_under_model(replace(case.log, frame=frame), SPOT)
    names = {note.split(":")[0] for note in _not_identifiable([without_torques])}
    assert {"imu_position", "accel_bias", "joint_delay"} <= names
    assert not names & {"armature", "coulomb_friction", "payload", "torque_delay"}


@pytest.mark.slow
def test_what_two_standing_feet_contradict_is_named_and_nothing_else_is():
    clean = diagnose([without_reference(walk(LONG, SPOT, 7))], SPOT)
    assert clean.verdict == "no_residual"
    assert not clean.found
    assert any("imu_position: not identifiable without a reference" in n for n in clean.notes)
    off = effect("encoder_offset", "FL_calf", 0.05)
    seen = without_reference(walk(LONG, SPOT, 7, (off,), declared=False))
    found = diagnose([seen], SPOT)
    named = {(f.effect.name, f.effect.target) for f in found.found}
    named |= {(r["name"], r["target"]) for r in found.rivals}
    assert ("encoder_offset", "FL_calf") in named
    # The accelerometer alone has nothing to contradict it.
    blind = effect("accel_bias", "x", 0.5)
    seen = without_reference(walk(LONG, SPOT, 7, (blind,), declared=False))
    assert diagnose([seen], SPOT).verdict != "attributed"


def test_a_reference_with_a_sample_a_row_is_not_coarse(log):
    assert reference_sampling(log) is None


def test_samples_and_their_noise_are_found_again(log):
    rng = np.random.default_rng(0)
    intervals = tuple(rng.choice([0.0083, 0.0167, 0.025], 1000))
    true = ReferenceSampling(intervals, 0.8e-3, 1.5e-3, 2e-3)
    found = reference_sampling(resample_reference(log, true, rng))
    assert found is not None
    seen = np.sum(np.cumsum(intervals) < log.t[-1] - log.t[0])
    assert len(found.intervals) == pytest.approx(seen, rel=0.01)
    assert_allclose(np.median(found.intervals), np.median(intervals), atol=1e-6)
    assert_allclose(found.intervals[0], intervals[0], atol=1e-4)  # where in a bin they lie
    assert found.stamp == pytest.approx(true.stamp, rel=0.25)
    assert found.angle == pytest.approx(true.angle, rel=0.25)
    assert found.position == pytest.approx(true.position, rel=0.25)


def test_without_an_imu_only_the_samples_are_known(log):
    rng = np.random.default_rng(1)
    resampled = resample_reference(log, ReferenceSampling((0.02,) * 50, 1e-3, 1e-3), rng)
    names = [n for n in resampled.frame if str(n).startswith(("gyro_", "accel_"))]
    bare = type(resampled)(resampled.frame.drop(columns=names), resampled.meta, resampled.name)
    found = reference_sampling(bare)
    assert found is not None
    assert (found.position, found.angle) == (0.0, 0.0)


def test_a_reference_without_error_keeps_the_motion(log):
    seen = resample_reference(log, ReferenceSampling((0.01,), 0.0, 0.0), np.random.default_rng(2))
    assert_allclose(seen.ref_p, log.ref_p, atol=5e-4)
    assert_allclose(seen.ref_R_GI, log.ref_R_GI, atol=4e-3)


def test_a_reference_with_a_noisy_sample_a_row_is_seen_by_the_floor(log):
    """As motion capture logged with an IMU is; a simulated one, with velocities, is not."""
    slow = log.rows(slice(None, None, 5))
    noisy = resample_reference(
        slow, ReferenceSampling((), 0.6e-3, 1e-3, 1e-3), np.random.default_rng(3)
    )
    names = [n for n in noisy.frame if str(n).startswith("ref_v")]
    measured = type(noisy)(noisy.frame.drop(columns=names), noisy.meta, noisy.name)
    found = reference_sampling(measured)
    assert found is not None
    assert found.intervals == ()
    assert found.position == pytest.approx(0.6e-3, rel=0.35)
    assert reference_sampling(noisy) is None
    assert any("included in the noise floor" in note for note in reference_notes(measured))
    assert reference_notes(noisy) == ()


def test_noise_of_samples_hardly_slower_than_the_rows_is_not_underrated(log):
    """Neighbouring rows are then interpolated with the same sample, and differ by less than their
    noise.
    """
    true = ReferenceSampling((0.0025,), 0.3e-3, 1e-3)
    seen = resample_reference(log, true, np.random.default_rng(4))
    names = [n for n in seen.frame if str(n).startswith("ref_v")]
    frame = seen.frame.drop(columns=names)
    found = reference_sampling(type(seen)(frame, seen.meta, seen.name))
    assert found is not None
    assert found.intervals == ()
    assert found.angle == pytest.approx(np.sqrt(2 / 3) * true.angle, rel=0.15)  # of a mean row
    samples = {"reference_samples": (seen.t[0] + 0.0025, 0.0025)}
    imported = replace(seen.meta, model=seen.meta.model | samples)
    found = reference_sampling(type(seen)(frame, imported, seen.name))
    assert found is not None
    assert_allclose(found.intervals[1:], true.intervals[0])
    assert found.angle == pytest.approx(true.angle, rel=0.15)
    # Intervals that the rows contradict are not believed.
    for wrong in ((seen.t[0], 1e9), (0.0, float("nan"))):
        meta = replace(seen.meta, model=seen.meta.model | {"reference_samples": wrong})
        found = reference_sampling(type(seen)(frame, meta, seen.name))
        assert found is not None
        assert found.intervals == ()
