"""The gait: wrenches, footholds, swings and patterns; each option does what it says."""

from dataclasses import replace

import numpy as np
import pytest
from refusals import refused

from surefoot.sim.gait.controller import (
    SLIDING_DISTANCE,
    Controller,
    gait_for,
    ground_below,
    slow_down_when_sliding,
    tick,
)
from surefoot.sim.gait.irregular import estimated_base, irregular, stride_at
from surefoot.sim.gait.options import PATTERNS, PLAIN_GAIT, GaitOptions, Pattern, _check
from surefoot.sim.gait.stance_control import stance_forces
from surefoot.sim.gait.state import STANCE, Command, FootStates, LegMemory, RobotState, standing
from surefoot.sim.gait.swing import climb_progress, place_foot, set_swing_height
from surefoot.sim.ground.height_map import height
from surefoot.sim.ground.terrain import Ground, Strip
from surefoot.sim.robot import Robot
from surefoot.sim.robot.kinematics import BaseMotion
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.sensors.stances import stances_between_swings
from surefoot.sim.sensors.streams import Sensors, sampled
from surefoot.sim.walk import plan, record, simulate_motion, walk

SPOT = Robot.load("spot_class")


GAIT = gait_for(SPOT, 0.0)


RISER, TREAD = 0.12, 0.32


STAIRS = Ground(
    0.8, (), 20.0, (Strip((1.0, 0.0), (4.2, 0.0), 4.0, (0.0, 1.2), steps=10),)
).height_map


def on(height_map) -> Controller:
    """A controller on this ground, the robot standing."""
    return Controller(GAIT, height_map, standing())


def test_four_feet_make_any_wrench():
    r = np.array([[0.3, 0.2, -0.5], [0.3, -0.2, -0.5], [-0.3, 0.2, -0.5], [-0.3, -0.2, -0.5]])
    wrench = np.array([20.0, -10.0, 300.0, 5.0, -8.0, 3.0])
    forces = stance_forces(r, wrench, np.ones(6), np.full(4, 1e-9))
    np.testing.assert_allclose(forces.sum(axis=0), wrench[:3], atol=1e-4)
    np.testing.assert_allclose(np.cross(r, forces).sum(axis=0), wrench[3:], atol=1e-4)


def test_the_ground_below_a_slope_is_the_slope():
    slope = Ground(0.8, (), 30.0, (Strip((-9.0, 0.0), (9.0, 0.0), 30.0, (0.0, 3.6)),)).height_map
    for yaw in (0.0, 0.7, 2.5):
        level, slope_x, slope_y = ground_below(GAIT, slope, np.array([1.0, 0.4, 0.0]), yaw)
        assert level == pytest.approx(height(slope, 1.0, 0.4), abs=1e-12)
        assert (slope_x, slope_y) == pytest.approx((0.2, 0.0), abs=1e-12)


def test_stairs_look_like_the_slope_that_they_are():
    x = np.linspace(1.8, 3.4, 200)
    ground = np.array([ground_below(GAIT, STAIRS, np.array([a, 0.0, 0.0]), 0.0) for a in x])
    assert ground[:, 1].mean() == pytest.approx(RISER / TREAD, rel=0.05)
    # Each tread stands above the line of its lower edges by half a riser on average.
    line = (x - 1.0) * RISER / TREAD + RISER / 2
    assert np.abs(ground[:, 0] - line).max() < 0.35 * RISER


@pytest.mark.parametrize("heading", [1.0, -1.0])
def test_footholds_keep_off_every_edge(heading):
    for want in np.linspace(1.4, 3.8, 97):
        trot = on(STAIRS)
        place_foot(trot, 0, np.array([want, 0.0]), (heading, 0.0), 0.0)
        x, _, z = trot.memory.foothold[0]
        on_tread = (x - 1.0) % TREAD
        assert 0.04 < on_tread < TREAD - 0.04
        assert abs(x - want) < 0.16
        # The shin's side, behind the foot, has the more room where the ground behind is higher.
        if heading < 0:
            assert TREAD - on_tread > 0.1
        expected = height(STAIRS, x, 0.0) + GAIT.foot_radius[0]
        assert z == pytest.approx(expected, abs=1e-12)


def test_late_in_the_swing_a_foothold_stays_on_its_step():
    trot = on(STAIRS)
    place_foot(trot, 0, np.array([2.2, 0.0]), (1.0, 0.0), 0.0)
    early = trot.memory.foothold.copy()
    place_foot(trot, 0, np.array([2.6, 0.0]), (1.0, 0.0), 0.9)
    np.testing.assert_array_equal(trot.memory.foothold, early)


def swing_path(memory: LegMemory) -> tuple[np.ndarray, np.ndarray]:
    u = np.linspace(0.0, 1.0, 400)

    def blend(s):
        return s**3 * (10.0 - 15.0 * s + 6.0 * s * s)

    start, end = memory.lift_off[0], memory.foothold[0]
    climb = end[2] - start[2]
    lifted = np.array([blend(climb_progress(climb, v)[0]) for v in u])
    x = start[0] + blend(u) * (end[0] - start[0])
    return x, start[2] + lifted * climb + 64.0 * (u * (1.0 - u)) ** 3 * memory.bump[0]


@pytest.mark.parametrize("there", [1.52, 1.84, 2.16])
@pytest.mark.parametrize("down", [False, True])
def test_a_swing_clears_the_stairs_between_its_ends(there, down):
    radius = GAIT.foot_radius[0]
    ends = [(x, height(STAIRS, x, 0.0) + radius) for x in (0.8, there)]
    trot = on(STAIRS)
    trot.memory.lift_off[0, [0, 2]], trot.memory.foothold[0, [0, 2]] = ends[::-1] if down else ends
    set_swing_height(trot, 0)
    x, z = swing_path(trot.memory)
    ground = np.array([height(STAIRS, a, 0.0) for a in x])
    assert (z - radius - ground)[1:-1].min() > -1e-3


def test_on_flat_ground_the_swing_is_the_plain_one():
    trot = on(Ground(0.8).height_map)
    trot.memory.lift_off[0], trot.memory.foothold[0] = (0.0, 0.0, 0.036), (0.4, 0.0, 0.036)
    set_swing_height(trot, 0)
    assert trot.memory.bump[0] == GAIT.clearance


def test_a_standing_robot_is_held_by_its_weight():
    torque = np.zeros(12)
    home_B = SPOT.feet_I(SPOT.q_home[None])[0] @ SPOT.R_BI.T + SPOT.p_BI
    p = np.array([0.0, 0.0, SPOT.foot_radius.mean() - home_B[:, 2].mean()])
    gait = GAIT._replace(start=1.0)
    load = np.full(4, SPOT.mass * 9.81 / 4)
    base = BaseMotion(p, np.eye(3), np.zeros(3), np.zeros(3))
    state = RobotState(0.0, base, SPOT.q_home, np.zeros(12), load)
    tick(SPOT.legs, on(Ground(0.8).height_map)._replace(gait=gait), state, np.zeros(6), torque)
    J_B = SPOT.feet_jacobian_I(SPOT.q_home[None])[0]
    J_B = np.einsum("ij,ljk->lik", SPOT.R_BI, J_B)
    push = [-np.linalg.solve(J.T, t) for J, t in zip(J_B, torque.reshape(4, 3), strict=True)]
    assert np.sum(push, axis=0)[2] == pytest.approx(SPOT.mass * 9.81, rel=0.01)


@pytest.mark.parametrize("name", ["trot", "walk", "pace"])
def test_feet_swing_when_the_pattern_says(name):
    motion, made = walked(pattern=name)
    log = record(made, motion)
    assert log.ref_p[-1, 0] > 1.0
    feet_G = log.ref_p[:, None] + np.einsum("nij,nlj->nli", log.ref_R_GI, SPOT.feet_I(log.q))
    height = feet_G[..., 2] - SPOT.foot_radius
    lifted = (height > 0.5 * made.gait.clearance) & ((log.t > 2.0) & (log.t < 6.0))[:, None]
    assert lifted.any(axis=0).all()
    # Circular means of when each foot is up, relative to the first foot.
    turns = [np.angle(np.exp(2j * np.pi * log.t[up] / made.gait.period).mean()) for up in lifted.T]
    miss = (np.array(turns) - turns[0]) / (2.0 * np.pi) - PATTERNS[name].phase
    assert np.abs((miss + 0.5) % 1.0 - 0.5).max() < 0.05
    # As many at once as the duty leaves: one foot in a walk, a pair in the others.
    assert lifted.sum(axis=1).max() == (1 if name == "walk" else 2)
    if name == "walk":
        # The body sways to the side of the feet that stand, so that three bear it.
        assert np.mean(log.contact[(log.t > 2.0) & (log.t < 6.0)].sum(axis=1) >= 3) > 0.75


def test_what_is_no_gait_is_one_line():
    refused("did you mean 'trot'", GaitOptions, pattern="trott")
    refused("duty must lie between 0.4 and 0.9, is 0.2", GaitOptions, duty=0.2)
    for wrong in (Pattern((0.0, 0.5, 0.5, 1.5), 0.6), Pattern((0.0, 0.5, 0.5, 0.0), 0.99)):
        refused("must", _check, wrong)


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
    fast = replace(scenario, sensors=Sensors(rate=1000.0))
    refused("rate must not exceed 500 Hz", walk, fast, SPOT, 0)


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
    rest, up, phase = np.zeros((4, 3)), np.tile([0.0, 0.0, 1.0], (4, 1)), np.full(4, 0.5)
    number, J = np.zeros(4, np.int64), np.zeros((4, 3, 3))
    feet = FootStates(rest, rest, rest, J, up, np.full(4, STANCE), phase, number)
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
