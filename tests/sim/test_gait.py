"""The gait: wrenches, footholds, swings and patterns."""

import numpy as np
import pytest
from refusals import refused

from surefoot.sim.gait.controller import Controller, gait_for, ground_below, tick
from surefoot.sim.gait.options import PATTERNS, GaitOptions, Pattern, _check
from surefoot.sim.gait.stance_control import stance_forces
from surefoot.sim.gait.state import LegMemory, RobotState, standing
from surefoot.sim.gait.swing import climb_progress, place_foot, set_swing_height
from surefoot.sim.ground.height_map import height
from surefoot.sim.ground.terrain import Ground, Strip
from surefoot.sim.robot import Robot
from surefoot.sim.robot.kinematics import BaseMotion
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.walk import plan, record, simulate_motion

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


ROBOT = Robot.load("spot_class")


def walked(gait: GaitOptions, seconds: float = 6.0):
    scenario = Scenario("flat", (Segment(seconds, 0.3),), Ground(0.8), gait=gait)
    made = plan(scenario, ROBOT, 0)
    return made, record(made, simulate_motion(made.world, ROBOT, made.gait, made.course))


@pytest.mark.parametrize("name", ["trot", "walk", "pace"])
def test_feet_swing_when_the_pattern_says(name):
    made, log = walked(GaitOptions(pattern=name))
    assert log.ref_p[-1, 0] > 1.0
    feet_G = log.ref_p[:, None] + np.einsum("nij,nlj->nli", log.ref_R_GI, ROBOT.feet_I(log.q))
    height = feet_G[..., 2] - ROBOT.foot_radius
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
