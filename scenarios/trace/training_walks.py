"""Walks to train and calibrate observers on: in simulation, in the style of a measured walk."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from surefoot.models.observer.samples import DQ_CAUSAL
from surefoot.models.observer.training import DEFAULT_SCHEDULE, Schedule
from surefoot.scenarios.estimate.run import declared_model
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.quaternion import quaternion_from_matrix
from surefoot.sim.effects import Effect, effect
from surefoot.sim.gait.options import PLAIN_GAIT, GaitOptions
from surefoot.sim.log import Log, joint_velocity
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario
from surefoot.sim.walk import Fallen, walk
from surefoot.sim.walking.imitation import WalkingStyle, imitation, slower

PACES = (1.0, 0.8, 0.6, 0.4)
"""Shares of the measured velocities that are tried until the robot does not fall."""


@dataclass(frozen=True)
class TrainingPlan:
    """How much an observer is trained in simulation."""

    walks: int = 8
    seconds: float = 30.0  # of each walk to train on
    calibration: float = 150.0  # s of the one to calibrate on
    schedule: Schedule = DEFAULT_SCHEDULE


DEFAULT_PLAN = TrainingPlan()


def world_of(robot: Robot) -> Robot:
    """The robot that walks in simulation: the file's own body, with the declared IMU mounting."""
    return replace(Robot.load(robot.file), name=robot.name, p_BI=robot.p_BI, R_BI=robot.R_BI)


def bodily(effects: Sequence[Effect], robot: Robot, world: Robot) -> tuple[Effect, ...]:
    """The effects as amounts beyond the simulated robot, whose feet have their file's radius.

    A declared model may have feet as points; what was found then is their whole radius.
    """
    missing = float(np.mean(robot.foot_radius - world.foot_radius))
    if abs(missing) < 1e-9:
        return tuple(effects)
    return tuple(
        effect(e.name, e.target, e.value + missing) if e.name == "foot_rolling" else e
        for e in effects
    )


def simulate_training(
    shown: WalkingStyle,
    robot: Robot,
    effects: Sequence[Effect],
    seed: int,
    plan: TrainingPlan = DEFAULT_PLAN,
    gait: GaitOptions = PLAIN_GAIT,
    progress: Callable[[float], None] = lambda share: None,
) -> tuple[list[Log], Log]:
    """Logs to train on and one to calibrate on, by the model with the effects.

    Args:
        shown: style of the measured walk.
        robot: as declared.
        effects: added to the model.
        seed: of the walks.
        plan: how many walks and how long.
        gait: how the robot walks.
        progress: called with the share done.
    """
    world = world_of(robot)
    added = bodily(effects, robot, world)
    logs = []
    for k, seconds in enumerate([*[plan.seconds] * plan.walks, plan.calibration]):
        rng = np.random.default_rng([seed, k])
        scenario, poised = imitation(shown, world, f"imitation_{k}", seconds, rng)
        walked = _walk(replace(scenario, gait=gait), poised, seed + k, added)
        logs.append(_modelled(replace(walked, name=scenario.name), world))
        progress((k + 1) / (plan.walks + 1))
    return logs[:-1], logs[-1]


def rates_as_of(log: Log, measured: Log) -> Log:
    """A log with the joint rates that a filter has of the measured one: where that lacks them, they
    are derived, causally, from the angles."""
    if measured.has("dq"):
        return log
    kept = log.frame[[c for c in log.frame if not str(c).startswith("dq_")]]
    rates = joint_velocity(replace(log, frame=kept), causal=True)
    columns = {f"dq_{joint}": rates[:, i] for i, joint in enumerate(log.joints)}
    meta = replace(log.meta, derived=(*log.meta.derived, DQ_CAUSAL))
    return replace(log, frame=kept.assign(**columns), meta=meta)


def _modelled(walked: Log, world: Robot) -> Log:
    """A simulated log with its effects compensated, that says how the IMU is then mounted and what
    the feet roll at: an observer keeps the mounting that it learnt with."""
    log, model = declared_model(walked, world)
    told = {
        "p_BI": model.p_BI.tolist(),
        "q_BI": quaternion_from_matrix(model.R_BI).tolist(),
        "foot_radius": model.foot_radius.tolist(),
    }
    return replace(log, meta=replace(log.meta, model=log.meta.model | told))


def _walk(scenario: Scenario, robot: Robot, seed: int, effects: Sequence[Effect]) -> Log:
    """At the measured pace, or at the fastest share of it at which the robot does not fall."""
    fallen = None
    for pace in PACES:
        try:
            return walk(slower(scenario, pace), robot, seed, effects)
        except Fallen as fall:
            fallen = fall
    raise SurefootError(
        f"loop: in simulation {robot.name} falls in the style of the log, even at "
        f"{100 * PACES[-1]:.0f} % of its speed ({fallen})"
    )
