"""The dm_env environment: a foreign controller drives, and the Log is as if we had walked."""

import unittest

import dm_env
import numpy as np
import pytest
from dm_env import test_utils
from processes import printed
from refusals import refused

from surefoot.sim.effects import effect
from surefoot.sim.gait.controller import Controller, tick
from surefoot.sim.gait.state import RobotState, standing
from surefoot.sim.ground.terrain import Ground
from surefoot.sim.log import Log
from surefoot.sim.physics.stepper import rotation
from surefoot.sim.robot import Robot
from surefoot.sim.robot.kinematics import BaseMotion
from surefoot.sim.scenario import Ranges, Scenario, Segment
from surefoot.sim.walk import plan, walk
from surefoot.sim.walking.dm_environment import SETTLING_PERIODS, WalkingEnvironment

# dm_control looks for a screen on import and warns where there is none.
pytestmark = pytest.mark.filterwarnings("ignore:.*X11.*")
SPOT = Robot.load("spot_class")
COURSE = Scenario(
    "course", (Segment(1.0, 0.5, turn=0.3),), Ground(0.8), ranges=Ranges(payload=(0.0, 3.0))
)


class TestConformsToDmEnv(test_utils.EnvironmentTestMixin, unittest.TestCase):
    """dm_env's own tests of an environment."""

    def make_object_under_test(self, **_):
        return WalkingEnvironment(COURSE, SPOT)


def the_trot(made):
    """The bundled controller as a policy: what a user's own would be."""
    memory, torque = standing(), np.zeros(12)
    memory.touched[:] = True  # standing already
    controller = Controller(made.gait, made.world.height_map, memory)
    ticks = iter(range(SETTLING_PERIODS, len(made.course.t)))
    targets = np.column_stack([made.course.pose, made.course.velocity])

    def policy(seen):
        i = next(ticks)
        R = rotation(*seen["orientation"])
        base = BaseMotion(seen["position"], R, seen["velocity"], seen["angular_velocity"])
        q, dq, load = seen["joint_position"], seen["joint_velocity"], seen["foot_force"]
        state = RobotState(made.course.t[i], base, q, dq, load)
        tick(SPOT.legs, controller, state, targets[i], torque)
        return torque

    return policy


@pytest.mark.parametrize("effects", [(), (effect("encoder_offset", "FL_thigh", 0.02),)])
def test_the_trot_as_a_policy_leaves_the_log_of_walk_bit_for_bit(effects):
    env = WalkingEnvironment(COURSE, SPOT, seed=7, effects=effects)
    policy = the_trot(plan(COURSE, SPOT, 7, effects))
    step = env.reset()
    while not step.last():
        step = env.step(policy(step.observation))
    ours = walk(COURSE, SPOT, 7, effects)
    assert env.log().frame.equals(ours.frame)
    assert env.log().meta == ours.meta
    assert step.discount == 1.0
    assert step.reward > 0.9


def test_position_targets_stand_and_are_in_the_log(tmp_path):
    env = WalkingEnvironment(COURSE, SPOT, actions="position")
    step = env.reset()
    for _ in range(250):
        step = env.step(SPOT.q_home)
    assert not step.last()
    log = env.log()
    log.write(tmp_path / "log.parquet")
    log = Log.read(tmp_path / "log.parquet")
    assert log.t[-1] == pytest.approx(1.0)
    assert np.array_equal(log.q_des, np.tile(SPOT.q_home, (500, 1)))
    law = log.meta.motor_law
    assert law is not None
    # What the motors did is what their law says of the state before each step.
    said = law["kp"] * (log.q_des[1:] - log.q[:-1]) - law["kd"] * log.dq[:-1]
    assert np.abs(said - log.tau[1:]).mean() < 1.0


def test_a_fall_ends_the_episode_without_a_future():
    env = WalkingEnvironment(COURSE, SPOT)
    step = env.reset()
    while not step.last():
        step = env.step(np.zeros(12))
    assert step.discount == 0.0
    assert 0.1 < env.log().t[-1] < 2.0
    assert env.step(np.zeros(12)).first()


def test_another_seed_draws_another_walk_and_the_same_one_repeats_it():
    env = WalkingEnvironment(COURSE, SPOT, seed=1)
    logs = []
    for seed in (None, 2, 1):
        env.reset(seed)
        for _ in range(20):
            env.step(np.zeros(12))
        logs.append(env.log())
    assert logs[0].frame.equals(logs[2].frame)
    assert not logs[0].frame.equals(logs[1].frame)
    assert [log.meta.seed for log in logs] == [1, 2, 1]


def test_bad_actions_and_early_logs_are_refused():
    env = WalkingEnvironment(COURSE, SPOT)
    env.reset()
    refused("no step yet", env.log)
    for bad in (np.zeros(11), np.full(12, np.nan)):
        refused("12 finite numbers", env.step, bad)
    refused("torque or position", WalkingEnvironment, COURSE, SPOT, actions="speed")
    assert isinstance(env, dm_env.Environment)


def test_without_dm_control_it_is_one_line_that_says_what_to_install():
    script = (
        "import sys; sys.modules['dm_control'] = None\n"
        "from surefoot.sim.common.errors import SurefootError\n"
        "try: import surefoot.sim.walking.dm_environment\n"
        "except SurefootError as error: print(error)"
    )
    (line,) = printed("-c", script).splitlines()
    assert "pip install dm-control" in line
