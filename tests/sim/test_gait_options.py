"""What real gaits have: each option does what it says, and none changes the plain gait."""

from dataclasses import replace

import numpy as np
import pytest

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.gait.controller import (
    SLIDING_DISTANCE,
    Controller,
    gait_for,
    slow_down_when_sliding,
)
from surefoot.sim.gait.irregular import estimated_base, irregular, stride_at
from surefoot.sim.gait.options import PLAIN_GAIT, GaitOptions
from surefoot.sim.gait.state import STANCE, Command, FootStates, RobotState, standing
from surefoot.sim.ground.terrain import Ground, Patch
from surefoot.sim.robot import Robot
from surefoot.sim.robot.kinematics import BaseMotion
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.sensors.stances import stances_between_swings
from surefoot.sim.sensors.streams import Sensors, sampled
from surefoot.sim.walk import Fallen, plan, simulate_motion, walk

SPOT = Robot.load("spot_class")
TICKS = np.arange(0.0, 40.0, 0.004)
COURSE = Scenario("options", (Segment(5.0, 0.5),), Ground(0.8), "spot_class")


def rng():
    return np.random.default_rng(2)


def walked(**options):
    """The motion of a walk with these options, and its plan."""
    made = plan(replace(COURSE, gait=GaitOptions(**options)), SPOT, 0)
    return simulate_motion(made.world, SPOT, made.gait, made.course), made


@pytest.fixture(scope="module")
def plain():
    return walked()


def loads(motion):
    """Loaded feet (N, 4) while the robot walks."""
    walks = (motion.t[1:] > 5.0) & (motion.t[1:] < 9.0)
    return motion.force[walks] > 0.03 * SPOT.mass * 9.81


def landing_speed(motion):
    """Median speed [m/s] towards the ground of feet over the 10 ms before they are loaded."""
    feet_B = SPOT.feet_I(motion.q) @ SPOT.R_BI.T + SPOT.p_BI
    height = motion.p_GB[:, None, 2] + np.einsum("nj,nlj->nl", motion.R_GB[:, 2], feet_B)
    found = []
    for leg, loaded in enumerate((motion.force > 0.03 * SPOT.mass * 9.81).T):
        first, _ = stances_between_swings(motion.t[1:], loaded)
        rows = first[motion.t[first] > 5.0]
        found.append((height[rows - 5, leg] - height[rows, leg]) / 0.01)
    return np.median(np.concatenate(found))


def test_a_plain_gait_is_not_irregular_and_draws_nothing():
    gait = gait_for(SPOT, 4.0)
    generator = rng()
    assert irregular(gait, PLAIN_GAIT, len(TICKS), TICKS[1], generator) == gait
    assert generator.random() == rng().random()


def test_strides_are_counted_alike_with_and_without_jitter():
    gait = gait_for(SPOT, 4.0)
    regular = gait._replace(beats=gait.start + gait.period * np.arange(90.0))
    for t in (4.0, 4.7, 11.13, 29.9):
        for leg in range(4):
            number, phase = stride_at(gait, t, leg)
            again = stride_at(regular, t, leg)
            assert again[0] + again[1] == pytest.approx(number + phase, abs=1e-9)
    jittered = irregular(gait, GaitOptions(period_jitter=0.03), len(TICKS), TICKS[1], rng())
    periods = np.diff(jittered.beats)
    assert periods.std() / periods.mean() == pytest.approx(0.03, rel=0.25)
    assert jittered.beats[-1] > TICKS[-1]
    # A beat is the beginning of a stride of the first leg.
    assert stride_at(jittered, jittered.beats[5] + 1e-9, 0) == (5, pytest.approx(0.0, abs=1e-6))


def test_the_estimate_errs_by_what_was_asked_for_and_stays_a_rotation():
    options = GaitOptions(velocity_noise=0.05, attitude_noise=0.02)
    gait = irregular(gait_for(SPOT, 4.0), options, len(TICKS), TICKS[1], rng())
    base = BaseMotion(np.zeros(3), np.eye(3), np.array([0.5, 0.0, 0.0]), np.zeros(3))
    found = [estimated_base(gait, base, k) for k in range(0, len(TICKS), 10)]
    v = np.array([one.v for one in found]) - base.v
    assert v.std() == pytest.approx(0.05, rel=0.2)
    R = np.array([one.R for one in found])
    np.testing.assert_allclose(
        R @ R.transpose(0, 2, 1), np.broadcast_to(np.eye(3), R.shape), atol=1e-12
    )
    assert R[:, 2, 1].std() == pytest.approx(0.02, rel=0.2)
    assert np.abs(R[:, 1, 0]).max() < 0.005


def test_a_longer_duty_puts_all_feet_on_the_ground_for_a_while(plain):
    motion, _ = walked(duty=0.75, unloading=0.05)
    together = [np.mean(loads(m).sum(axis=1) == 4) for m in (plain[0], motion)]
    # Of a stride, 2 duty - 1 is planned for all four: a fifth for 0.6, half for 0.75.
    assert together[1] > together[0] + 0.15


def test_a_hard_touch_down_is_harder(plain):
    hard, _ = walked(touchdown_speed=0.25)
    asked = 0.25 * np.sqrt(9.81 * SPOT.leg_length)
    speeds = [landing_speed(m) for m in (plain[0], hard)]
    assert speeds[1] - speeds[0] == pytest.approx(asked, rel=0.5)


def lift_off_motion(motion, made):
    """Median rise and advance [m] of feet over the first 80 ms of their swings."""
    feet_B = SPOT.feet_I(motion.q) @ SPOT.R_BI.T + SPOT.p_BI
    feet_G = motion.p_GB[:, None] + np.einsum("nij,nlj->nli", motion.R_GB, feet_B)
    found = []
    for leg in range(4):
        phase = np.array([stride_at(made.gait, t, leg)[1] for t in motion.t])
        first = np.flatnonzero((phase[:-1] < made.gait.duty) & (phase[1:] >= made.gait.duty))
        first = first[(motion.t[first] > 5.0) & (first + 40 < len(motion.t))]
        found.append(feet_G[first + 40, leg] - feet_G[first, leg])
    return np.median(np.concatenate(found), axis=0)[[2, 0]]


def test_a_foot_that_moves_at_once_after_lift_off_gets_further(plain):
    """By what its initial velocity adds, u (1 - u)^3 of the swing, but for the lag of its PD."""
    quick, made = walked(liftoff_speed=0.2, liftoff_advance=1.0)
    swing_time = (1.0 - made.gait.duty) * made.gait.period
    u = 0.08 / swing_time
    asked = np.array([0.2 * np.sqrt(9.81 * SPOT.leg_length), 0.5])
    added = lift_off_motion(quick, made) - lift_off_motion(*plain)
    np.testing.assert_allclose(added, asked * swing_time * u * (1.0 - u) ** 3, rtol=0.5)


def test_footholds_and_periods_vary_and_the_robot_walks_on():
    options = {
        **{"period_jitter": 0.03, "foothold_jitter": 0.02, "braking": 0.3, "stiffness": 0.4},
        **{"velocity_noise": 0.05, "attitude_noise": 0.01},
    }
    motion, made = walked(**options)
    assert motion.p_GB[-1, 0] == pytest.approx(made.course.pose[-1, 0], abs=0.2)
    assert made.gait.footholds.std() == pytest.approx(0.02 * SPOT.leg_length, rel=0.3)
    again, _ = walked(**options)
    np.testing.assert_array_equal(motion.p_GB, again.p_GB)


def test_a_log_at_a_lower_rate_keeps_what_the_imu_integrates():
    scenario = replace(COURSE, segments=(Segment(1.0, 0.4),))
    whole = walk(scenario, SPOT, 0)
    for rate in (100.0, 200.0, 400.0):
        slow = walk(replace(scenario, sensors=Sensors(rate=rate)), SPOT, 0)
        assert slow.rate == rate
        np.testing.assert_allclose(np.diff(slow.t), 1.0 / rate, atol=1e-9)
        n = len(slow.t)
        end = np.searchsorted(whole.t, slow.t[-1] + 1e-9)
        turned = (slow.gyro.sum(axis=0) / rate, whole.gyro[:end].sum(axis=0) * 0.002)
        np.testing.assert_allclose(*turned, atol=1e-3)
        at = np.searchsorted(whole.t, slow.t[n // 2])
        np.testing.assert_allclose(slow.ref_p[n // 2], whole.ref_p[at], atol=2e-3)
        np.testing.assert_allclose(np.linalg.norm(slow.ref_q, axis=1), 1.0, atol=1e-12)
    with pytest.raises(SurefootError, match="rate must not exceed 500 Hz"):
        walk(replace(scenario, sensors=Sensors(rate=1000.0)), SPOT, 0)


def test_what_an_imu_samples_folds_back_and_what_it_averages_does_not():
    frame = walk(replace(COURSE, segments=(Segment(0.5, 0.0),)), SPOT, 0).frame
    t = frame["t"].to_numpy()
    tone = frame.assign(accel_x=np.sin(2 * np.pi * 190.0 * t))
    power = {a: np.var(sampled(tone, 100.0, averages=a)["accel_x"]) for a in (True, False)}
    assert power[False] > 0.4  # a tone of 10 Hz, as large
    assert power[True] < 0.02


def test_care_stops_a_robot_and_never_turns_it_back():
    """Pushed backwards over ice, and none of it where a single foot slides."""
    gait = gait_for(SPOT, 0.0, options=GaitOptions(slip_care=1.0))
    place, velocity, sole_velocity = np.zeros((3, 4, 3))
    feet = FootStates(
        place,
        velocity,
        sole_velocity,
        np.zeros((4, 3, 3)),
        np.tile([0.0, 0.0, 1.0], (4, 1)),
        np.full(4, STANCE),
        np.full(4, 0.5),
        np.zeros(4, np.int64),
    )
    base = BaseMotion(np.zeros(3), np.eye(3), np.array([-1.0, 0.0, 0.0]), np.zeros(3))
    for sliding, wanted in (([1.0] * 4, 0.0), ([3.0, 0.0, 0.0, 0.0], 0.5)):
        controller = Controller(gait, plan(COURSE, SPOT, 0).world.height_map, standing())
        controller.memory.way[:] = np.array(sliding) * 1.1 * SLIDING_DISTANCE * gait.leg_length
        went = []
        for t in np.arange(1.0, 6.0, 0.004):
            state = RobotState(t, base, np.zeros(12), np.zeros(12), np.full(4, 100.0))
            command = Command(np.array([0.5, 0.0, 0.0]), 0.0, np.zeros(2), np.zeros(2))
            slow_down_when_sliding(controller, state, 10.0, command, feet)
            went.append(command.v[0])
        assert min(went) >= -1e-12
        assert went[-1] == pytest.approx(wanted, abs=0.01)


def test_with_care_a_robot_walks_on_where_its_feet_slide_by_centimetres():
    """Over a sheet that it turns and speeds up on; without care it falls there."""
    segments = (Segment(2.0, 0.8), Segment(3.0, 0.1, 0.0, 0.8), Segment(4.0, 0.9))
    sheet = Ground(0.8, (Patch(1.0, 0.3, 1.6, 3.0, 0.05),), 20.0)
    robot = Robot.load("v60_class")
    gait = GaitOptions(
        duty=0.68,
        unloading=0.05,
        period_jitter=0.03,
        foothold_jitter=0.015,
        touchdown_speed=0.3,
        braking=0.3,
        level=0.3,
        stiffness=0.4,
        velocity_noise=0.04,
        attitude_noise=0.01,
        noise_time=0.02,
    )
    scenario = Scenario("sheet", segments, sheet, "v60_class", gait=gait)
    with pytest.raises(Fallen):
        walk(scenario, robot, 0)
    log = walk(replace(scenario, gait=replace(gait, slip_care=1.0)), robot, 0)
    slid = []
    for leg in range(4):
        for first, end in zip(*stances_between_swings(log.t, log.contact[:, leg]), strict=True):
            if log.mu[first:end, leg].mean() < 0.3:
                slid.append(log.slip[first:end, leg].sum() / log.rate)
    assert np.median(slid) > 0.01
    assert np.percentile(slid, 90) > 0.02
