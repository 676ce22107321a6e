"""A filter that is lost says so, without a reference; one that is right does not."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from motions import feet, motion
from numpy.testing import assert_allclose

from surefoot.estimator.core.state import FilterNoise
from surefoot.estimator.evaluation.health import RunSummary, health, joined_summary, summary_of_run
from surefoot.estimator.evaluation.innovation_sums import add_innovation, windows_of
from surefoot.estimator.evaluation.trajectory import Trajectory
from surefoot.estimator.filter import CoverageSettings, InvariantFilter
from surefoot.estimator.leg import LegFilter, LegNoise
from surefoot.estimator.metrics import evaluate
from surefoot.estimator.run import (
    Estimates,
    bounded_velocities,
    gaussian_velocities,
    imu_samples,
    trajectory,
)
from surefoot.estimator.updates.velocity import add_velocity, velocity_memory
from surefoot.sim.common.gravity import GRAVITY
from surefoot.sim.log import Log, Meta

LEGS = ("FL", "FR", "RL", "RR")


ACCEL_WALK, GYRO_WALK = 1e-3, 1e-4


NOISE = FilterNoise(2e-3, 1e-2, GYRO_WALK, ACCEL_WALK)


LEG_NOISE = LegNoise(NOISE, contact=1e-2, rolling=0.0)


STD = 2e-3


@pytest.fixture(scope="module")
def walk():
    return motion(16.0, 250.0)


@pytest.fixture(scope="module")
def legs(walk):
    return feet(walk)


def leg_run(walk, legs, bias=0.0, contact=None, gate=None, seed=3, cuts=()):
    """Estimate and health of the leg filter, its model true but for what is given."""
    rng = np.random.default_rng(seed)
    n, (state, P) = len(walk.t), walk.drawn_start(rng, b_g=1e-3)
    gyro, accel = walk.sensed(rng, NOISE)
    gyro += bias
    measured = legs.sensed(walk, rng, 1e-2, STD)
    contact = legs.contact if contact is None else contact
    one = LegFilter(state, P, LEG_NOISE, slip_gate=gate)
    cov = np.broadcast_to(np.eye(3) * STD**2, (n, 4, 3, 3))
    log, parts, found = walk.log(gyro, accel), [], []
    for piece in np.split(np.arange(n), cuts):
        imu = imu_samples(walk.t[piece], gyro[piece], accel[piece], after=one.t)
        some = one.legs(measured[piece], contact[piece], cov[piece])
        rows = np.flatnonzero(piece % 2 == 0)
        found.append(one.run(imu, some, rows=rows))
        parts.append(summary_of_run(found[-1], log.rows(piece)))
    return found, health(joined_summary(parts), LEGS, (ACCEL_WALK, GYRO_WALK))


def test_a_right_filter_is_consistent_and_believed(walk, legs):
    for seed in range(3):
        _, found = leg_run(walk, legs, gate=16.27, seed=seed)
        assert not found.lost, found.sentence("leg_slip")
        assert [one.name for one in found.sensors] == [f"foot {leg}" for leg in LEGS]
        for one in found.sensors:
            assert one.nis / 3 == pytest.approx(1.0, abs=0.15)
            # Chi-square of 48 degrees of freedom over 48: deviation 0.2.
            assert one.drift == pytest.approx(1.0, abs=0.7)
            # One update in a thousand fails each of two tests, and keeps its foot out for 25.
            assert one.rejected < 0.15
        assert found.sentence("leg") == ""


def test_a_sensor_is_judged_by_every_window_that_it_updates_in():
    """One of a single update counts as one of many: r^2 is 1 in the first window, 4 in the second,
    of claimed variance 1."""
    sums = np.zeros((3, 1, 10))
    sums[:2, 0, 0] = 1.0, 9.0
    sums[:2, 0, 2] = 3.0, 9 * 3.0
    sums[:2, 0, 3:6] = np.array([[1.0], [6.0]])
    sums[:2, 0, 6:9] = np.array([[1.0], [9.0]])
    found = health(summary(sums), (), (1e-3, 1e-4))
    assert found.sensors[0].drift == pytest.approx((1.0 + 4.0) / 2)
    assert found.sensors[0].nis / 3 == pytest.approx(1.0)


def summary(sums, start=0.0):
    """Of windows that begin at `start`, a gyro's bias moving by its deviation in the last."""
    n = len(sums)
    none, bias = np.zeros(n), np.zeros((n, 6))
    bias[-1, 3] = 1e-3
    return RunSummary(
        start + np.arange(n), sums, bias, none, none, none, np.ones(n, dtype=bool),
        np.full(n, np.nan), np.zeros(6), np.full(6, 1e-3), False,
    )  # fmt: skip


def test_biases_are_judged_by_the_time_that_they_had_whatever_the_clock_says():
    for start in (0.0, 1e6):
        found = health(summary(np.zeros((3, 1, 10)), start), (), (0.0, 1e-3))
        # Of a prior and three seconds of walk, each of 1e-3.
        assert found.biases[3] == pytest.approx(1.0 / np.sqrt(1.0 + 3.0))


def test_a_walk_unlike_the_training_is_doubted_from_when_it_is():
    far = {
        "for long": [np.nan, 0.9, 1.1, 1.3],
        "no more": [np.nan, 1.2, 1.1, 0.9],
        "never": [0.5] * 4,
    }
    found = {}
    for name, unlike in far.items():
        run = replace(summary(np.zeros((4, 1, 10))), unlike=np.array(unlike))
        found[name] = health(joined_summary([run]), (), (1e-3, 1e-4))
    assert "distance 1.3" in found["for long"].sentence("coverage")
    assert found["for long"].since == 2.0
    assert not found["no more"].lost
    assert not found["never"].lost


def test_windows_are_of_a_second():
    """As doubts say: "by so many m/s in a second"."""
    assert windows_of(np.array([-0.1, 0.0, 0.99, 1.0, 1.05, 2.0])).tolist() == [-1, 0, 0, 1, 1, 2]


def test_updates_used_and_left_out_are_counted_apart():
    sums, residual, one = np.zeros((2, 10)), np.array([1.0, -2.0, 0.5]), np.eye(3)
    memory = velocity_memory()
    memory.counts[1] = 1
    for _ in range(3):
        add_velocity(sums[0], memory, one)
    for _ in range(2):
        add_innovation(sums[1], 5.25, residual, 0.75 * one, 0.25 * one)
    assert_allclose(sums[0], [0, 3, 0, 0, 0, 0, 0, 0, 0, 0])
    assert_allclose(sums[1], [2, 0, 10.5, 2, -4, 1, 2, 2, 2, 0])


def test_a_push_is_claimed_by_what_turns_gravity_or_is_no_velocity():
    """In a second: g for each radian of tilt about either level axis but none of yaw, a velocity's
    own error at both ends, an accelerometer's bias, and its noise of 0.03 m/s^2/sqrt(Hz)."""
    t = np.array([0.0, 0.1])
    rest = np.zeros((2, 3))
    frame = pd.DataFrame({"t": t})
    for name in ("gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y"):
        frame[name] = 0.0
    frame["accel_z"] = GRAVITY
    log, noise = Log(frame, Meta(rate=10.0)), 0.03**2
    claims = [GRAVITY**2, GRAVITY**2, 0.0, *[2.0] * 3, *[0.0] * 3, *[1.0] * 3, *[0.0] * 3]
    for i, claim in enumerate(claims):
        P = np.zeros((2, 15, 15))
        P[:, i, i] = 0.01
        level = np.tile(np.eye(3), (2, 1, 1))
        found = summary_of_run(Trajectory(t, level, rest, rest, rest, rest, P), log)
        assert_allclose(found.push_claimed, np.sqrt(0.01 * claim + noise), rtol=1e-12)
        assert_allclose(found.pushed, 0.0, atol=1e-12)


def test_a_gyro_beyond_its_prior_is_named(walk, legs):
    _, found = leg_run(walk, legs, bias=0.03)
    assert found.lost
    assert "bias of the gyro" in found.sentence("leg")
    assert found.biases[3:].max() > 5


def test_inverted_contacts_are_found_where_they_begin(walk, legs):
    wrong = (walk.t > 6.0) & (walk.t < 9.0)
    contact = np.where(wrong[:, None], ~legs.contact, legs.contact)
    for gate in (None, 16.27):
        _, found = leg_run(walk, legs, contact=contact, gate=gate)
        assert found.lost
        assert 6.0 <= found.since <= 9.0
        assert found.sentence("leg").startswith("leg is not to be trusted: ")


def test_all_feet_rejected_have_a_way_back(walk, legs):
    """A gyro far beyond its prior locks all feet out: the filter once went kilometres away."""
    (estimate,), found = leg_run(walk, legs, bias=0.1, gate=16.27)
    assert evaluate(walk.reference(), estimate).ape_trans < 5.0
    assert "no foot passed the test of slipping" in found.sentence("leg_slip")


def test_pieces_give_the_health_of_the_whole(walk, legs):
    _, one = leg_run(walk, legs, bias=0.03)
    _, other = leg_run(walk, legs, bias=0.03, cuts=(1130, 1131, 2777))
    assert [d.reason for d in one.doubts] == [d.reason for d in other.doubts]
    for a, b in zip(one.sensors, other.sensors, strict=True):
        assert (a.used, a.rejected) == (b.used, b.rejected)
        assert_allclose((a.nis, a.whiteness, a.drift), (b.nis, b.whiteness, b.drift), rtol=1e-9)


@pytest.mark.parametrize("kind", ["gaussian", "bounds"])
def test_velocities(walk, kind):
    """Right ones are believed; Gaussian ones that are off by ten deviations for a while are not."""
    rng = np.random.default_rng(5)
    gyro, accel = walk.sensed(rng, NOISE)
    rows = np.arange(5, len(walk.t), 5)
    v_I = walk.v_I[rows] + rng.normal(size=(len(rows), 3)) * 0.05
    off = np.where((walk.t[rows] > 8.0)[:, None], 0.5, 0.0)
    for error, lost in ((0.0, False), (off, True))[: 2 if kind == "gaussian" else 1]:
        one = InvariantFilter(*walk.start(), noise=NOISE)
        imu = imu_samples(walk.t, gyro, accel)
        if kind == "gaussian":
            measured = gaussian_velocities(rows, v_I + error, np.eye(3) * 0.05**2, len(walk.t))
            estimate = one.run(imu, measured)
        else:
            bounds = np.full(3, 0.05 * 1.8)  # holds 93 % of each axis, 80 % of all three
            measured = bounded_velocities(rows, v_I + error, bounds, len(walk.t))
            estimate = one.run(imu, measured, settings=CoverageSettings(0.8))
        found = health(summary_of_run(estimate, walk.log(gyro, accel)), (), (1e-3, 1e-4))
        assert found.lost == lost, found.sentence(kind)
        if not lost:
            assert found.sensors[0].nis / 3 == pytest.approx(1.0, abs=0.2)
        else:
            assert 7.9 <= found.since <= 10.0


def test_an_estimate_without_innovations_is_judged_by_the_imu(walk, legs):
    """A user's own filter keeps no sums: a velocity that jumps is seen all the same."""
    (estimate,), _ = leg_run(walk, legs)
    bare = replace(estimate, innovations=None)
    gyro, accel = walk.sensed(np.random.default_rng(3), NOISE)
    log = walk.log(gyro, accel)
    assert not health(summary_of_run(bare, log), LEGS, (1e-3, 1e-4)).lost
    jumping = replace(bare, v_GI=bare.v_GI + np.where(bare.t[:, None] > 10.0, 4.0, 0.0))
    found = health(summary_of_run(jumping, log), LEGS, (1e-3, 1e-4))
    assert "contradict the IMU" in found.sentence("own")
    assert found.since == 10.0
    racing = replace(bare, v_GI=bare.v_GI + 50.0)
    assert "m/s" in health(summary_of_run(racing, log), LEGS, (1e-3, 1e-4)).sentence("own")


@pytest.mark.parametrize(("finite", "says"), [(0, "not one of"), (60, "no longer finite")])
def test_what_is_not_finite_ends_the_estimate(walk, finite, says):
    mean = np.tile(walk.start()[0].pack(), (100, 1, 1))
    mean[finite:, 3] = np.nan
    found = Estimates(np.arange(100), mean, np.tile(np.eye(15), (100, 1, 1)))
    estimate = trajectory(walk.t, found)
    assert estimate.diverged
    assert len(estimate.t) == finite
    judged = health(summary_of_run(estimate, walk.log()), (), (0.0, 0.0))
    assert says in judged.sentence("leg")


def test_the_same_at_100_250_and_500_hz():
    """A foot that slides is left out for the same time, whatever the rate, and so is the error."""
    out, errors = [], []
    for rate in (100.0, 250.0, 500.0):
        walk = motion(8.0, rate)
        legs = feet(walk, slip=0.6)
        one = LegFilter(*walk.start(), slip_gate=16.27)
        cov = np.broadcast_to(np.eye(3) * 1e-6, (*legs.contact.shape, 3, 3))
        imu = imu_samples(walk.t, walk.gyro, walk.accel)
        found = one.run(imu, one.legs(legs.feet_I, legs.contact, cov))
        assert found.innovations is not None
        rejected = found.innovations.sums[:, :, 1].sum(axis=0) / rate
        assert rejected[1:].max() == 0.0
        out.append(rejected[0])
        errors.append(evaluate(walk.reference(), found).ape_trans)
    assert_allclose(out, out[-1], rtol=0.15)
    assert max(errors) < 1.5 * min(errors)
