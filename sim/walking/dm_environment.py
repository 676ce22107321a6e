"""The walking robot as a `dm_env` environment: your controller drives it, and the result is a Log.

env = WalkingEnvironment(Scenario.load("course.toml"), Robot.load("spot_class"), seed=0)
step = env.reset()
while not step.last():
    step = env.step(policy(step.observation))  # 12 joint torques [N m], 250 times a second
env.log().write("mine.parquet")
"""

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal

import dm_env
import numpy as np
from dm_env import specs

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.gravity import GRAVITY
from surefoot.sim.common.kernels import kernel
from surefoot.sim.effects import Effect
from surefoot.sim.gait.course import Course
from surefoot.sim.log import Log
from surefoot.sim.log.schema import named_columns
from surefoot.sim.physics.scene import TIMESTEP
from surefoot.sim.physics.stepper import (
    STEPS_PER_TICK,
    at_rest,
    first_steps,
    has_fallen,
    mj_views,
    motion_of,
    recording_of,
    rotation,
    step,
    trot,
)
from surefoot.sim.robot import Robot
from surefoot.sim.robot.legs import JOINTS
from surefoot.sim.scenario import Scenario
from surefoot.sim.walk import SETTLING_TIME, plan, record

try:
    from dm_control.mujoco import Physics
    from dm_control.mujoco.wrapper import MjModel
except ModuleNotFoundError as error:
    raise SurefootError(
        "the dm_env environment needs dm-control (pip install dm-control), which surefoot does not "
        "bring on Python 3.13 and later: there one of its dependencies is built by a compiler"
    ) from error

SETTLING_PERIODS = round(SETTLING_TIME / TIMESTEP) // STEPS_PER_TICK
"""Control periods before the log begins."""
TOLERANCE = 0.5  # m/s and rad/s, of the reward


class WalkingEnvironment(dm_env.Environment):
    """A robot on a scenario's course, one step a control period of 4 ms.

    actions: "torque", joint torques (12,) [N m]; or "position", joint targets (12,) [rad] that a
    motor law kp (target - q) - kd dq follows at every timestep of 2 ms. gains: kp [N m/rad] and kd
    [N m s/rad] of this law, a number or (12,) each; by default, scaled to the robot's size. Both
    actions are clipped to their limits. Observations are true values in SI units, the inputs of
    `sim.gait.controller.tick` (see `observation_spec`). The reward, from 0 to 1, measures how near
    the base's velocity is to the command's; the episode ends with the course, or with discount 0 in
    a fall.

    An episode begins with the robot standing still, as the log of `sim.walk.walk` does. The same
    scenario, robot, seed, effects and actions give the same Log, bit for bit.
    """

    def __init__(
        self,
        scenario: Scenario,
        robot: Robot,
        seed: int = 0,
        actions: Literal["torque", "position"] = "torque",
        gains: tuple[float | np.ndarray, float | np.ndarray] | None = None,
        effects: Sequence[Effect] = (),
    ):
        if actions not in ("torque", "position"):
            raise SurefootError(f"actions must be torque or position, is {actions!r}")
        if scenario.sensors.rate and actions == "position":
            raise SurefootError("position targets are logged a row a timestep: [sensors] rate")
        self._scenario, self._robot, self._effects = scenario, robot, tuple(effects)
        self._by_position = actions == "position"
        stiff = 0.75 * robot.mass * GRAVITY * robot.leg_length
        self._kp, self._kd = (
            np.array(np.broadcast_to(gain, 12), dtype=float) * self._by_position
            for gain in gains or (stiff, 0.03 * stiff)
        )
        self._plan_for(seed)

    def _plan_for(self, seed: int) -> None:
        self._plan = plan(self._scenario, self._robot, seed, self._effects)
        world = self._plan.world
        self._physics = Physics.from_model(MjModel(world.model))
        self._body = mj_views(world, self._physics.data.ptr)
        steps = len(self._plan.course.t) * STEPS_PER_TICK
        self._trace = recording_of(world, steps)
        self._wanted = np.full((steps, 12), np.nan)
        self._k = 0
        self._over = True

    @property
    def physics(self) -> Physics:
        """MuJoCo's model and data, as dm_control's viewer and renderers expect them."""
        return self._physics

    def reset(self, seed: int | None = None) -> dm_env.TimeStep:
        """Start an episode with the robot standing, on the course drawn with `seed` if given."""
        if seed is not None and seed != self._plan.seed:
            self._plan_for(seed)
        made, data = self._plan, self._physics.data.ptr
        course = made.course
        settling = Course(*(x[:SETTLING_PERIODS] for x in (course.t, course.pose, course.velocity)))
        trot(at_rest(made.world, self._robot, made.gait, data), settling, self._trace, course.t[-1])
        self._k = SETTLING_PERIODS * STEPS_PER_TICK
        self._over = False
        return dm_env.restart(self._observation())

    def step(self, action: np.ndarray) -> dm_env.TimeStep:
        """Drive the joints for one control period; after an episode's end, begin the next one."""
        if self._over:
            return self.reset()
        wanted = np.asarray(action, dtype=float)
        if wanted.shape != (12,) or not np.isfinite(wanted).all():
            raise SurefootError(f"an action is 12 finite numbers, is {action!r}")
        spec = self.action_spec()
        wanted = np.clip(wanted, spec.minimum, spec.maximum)
        first, self._k = self._k, self._k + STEPS_PER_TICK
        self._wanted[first : self._k] = wanted
        torque = np.zeros(12) if self._by_position else wanted
        motors = self._kp, self._kd, self._robot.torque_limit
        _drive(self._body, self._trace, first, torque, wanted, motors)
        qpos = self._body.qpos
        fell = has_fallen(self._plan.gait, self._plan.world.height_map, qpos, rotation(*qpos[3:7]))
        fell |= bool(self._body.unstable.any())
        self._over = fell or self._k == len(self._wanted)
        observation = self._observation()
        reward = _reward(observation)
        if fell:
            return dm_env.termination(reward, observation)
        if self._over:
            return dm_env.truncation(reward, observation)
        return dm_env.transition(reward, observation)

    def log(self) -> Log:
        """The Log of the episode so far, with commanded positions and their motor law if any.

        Raises SurefootError before the first step.
        """
        k, settled = self._k, SETTLING_PERIODS * STEPS_PER_TICK
        if k <= settled:
            raise SurefootError("the episode has no step yet: there is nothing to log")
        log = record(self._plan, motion_of(self._plan.world, first_steps(self._trace, k)))
        if not self._by_position:
            return log
        asked = self._wanted[settled:k]
        columns = named_columns("q_des", asked, JOINTS)
        for group in ("dq_des", "tau_ff"):  # commanded indeed: a target that stands, no more
            columns |= named_columns(group, np.zeros_like(asked), JOINTS)
        law = {"kp": self._kp.tolist(), "kd": self._kd.tolist()}
        return replace(log, meta=replace(log.meta, motor_law=law)).with_columns(columns)

    def action_spec(self) -> Any:
        """A BoundedArray (12,): torques [N m], or joint targets [rad]."""
        if self._by_position:
            low, high = self._robot.joint_range.T
            return specs.BoundedArray((12,), float, low, high, "joint_position_target")
        limit = self._robot.torque_limit
        return specs.BoundedArray((12,), float, -limit, limit, "joint_torque")

    def observation_spec(self) -> Any:
        """An OrderedDict of array specs, in SI units; `_observation` gives the meaning of each."""
        now = self._observation()
        return OrderedDict((name, specs.Array(x.shape, float, name)) for name, x in now.items())

    def reward_spec(self) -> specs.BoundedArray:
        return specs.BoundedArray((), float, 0.0, 1.0, "reward")

    def _observation(self) -> OrderedDict:
        body, course = self._body, self._plan.course
        i = min(self._k // STEPS_PER_TICK, len(course.t) - 1)
        return OrderedDict(
            time=np.array(self._k * TIMESTEP - SETTLING_TIME),  # s since the log began
            position=body.qpos[:3].copy(),  # m, of the base in G
            orientation=body.qpos[3:7].copy(),  # w, x, y, z of B in G
            velocity=body.qvel[:3].copy(),  # m/s, in G
            angular_velocity=body.qvel[3:6].copy(),  # rad/s, in B
            joint_position=body.qpos[body.qpos_adr],  # rad
            joint_velocity=body.qvel[body.dof_adr],  # rad/s
            foot_force=self._trace.force[self._k - 1].copy(),  # N, normal
            target=course.pose[i].copy(),  # x, y [m] and yaw [rad] of the course now
            command=course.velocity[i].copy(),  # forward, lateral [m/s], yaw rate [rad/s]
        )


def _reward(observation: OrderedDict) -> float:
    R = rotation(*observation["orientation"])
    x, y = R[:2, 0] / max(np.hypot(R[0, 0], R[1, 0]), 1e-9)
    v = observation["velocity"]
    moved = np.array([x * v[0] + y * v[1], x * v[1] - y * v[0], observation["angular_velocity"][2]])
    miss = (moved - observation["command"]) / TOLERANCE
    return float(np.exp(-miss @ miss))


@kernel(nogil=True)
def _drive(body, trace, k, torque, target, motors):
    """One control period of torques plus those of the motor law, clipped to the motors' limits.

    Args:
        body: MjViews.
        trace: a Recording, written.
        k: the period's first timestep.
        torque, target: (12,) N m and rad.
        motors: kp [N m/rad], kd [N m s/rad] and the limit [N m], (12,) each.
    """
    kp, kd, limit = motors
    for i in range(STEPS_PER_TICK):
        for j in range(12):
            q, dq = body.qpos[body.qpos_adr[j]], body.qvel[body.dof_adr[j]]
            wanted = torque[j] + kp[j] * (target[j] - q) - kd[j] * dq
            body.ctrl[j] = min(max(wanted, -limit[j]), limit[j])
        step(body, trace, k + i)
