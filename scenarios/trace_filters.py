"""What an effect costs a filter: the leg filter without it in the model, and with it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimator.metrics import Metrics, evaluate
from estimator.trajectory import Trajectory, reference
from scenarios.filters import FILTERS, Learnt
from sim.effects import Effect, explain_all
from sim.log import Log
from sim.robot import Robot

REPORTED = (
    "ape_trans", "ape_rot", "rpe_trans", "rpe_rot", "velocity", "nees_position", "nees_velocity",
    "nees_attitude",
)  # fmt: skip


@dataclass(frozen=True)
class BeforeAfter:
    """One filter on one stretch of a log, declared model and with the effects explained."""

    log: Log
    before: Trajectory
    after: Trajectory
    metrics: tuple[Metrics, Metrics]


def before_and_after(log: Log, robot: Robot, effects: Sequence[Effect]) -> BeforeAfter:
    """The leg filter, started from the reference at the log's first row, twice."""
    truth = reference(log)
    before = leg_trajectory(log, robot)
    after = leg_trajectory(*explain_all(effects, log, robot)) if effects else before
    return BeforeAfter(log, before, after, (evaluate(truth, before), evaluate(truth, after)))


def leg_trajectory(log: Log, robot: Robot) -> Trajectory:
    """The leg filter over a log that has IMU, joints, contacts and a reference to start from."""
    robot = replace(robot, foot_radius=np.maximum(robot.foot_radius, 0.0))
    return FILTERS["leg"](log, robot, Learnt())()


def stretch(log: Log, begin: float, end: float) -> Log | None:
    """The log from `begin` to `end` [s], from its first row with a reference on; None if short."""
    rows = np.flatnonzero((log.t >= begin) & (log.t <= end))
    good = rows[log.ref_ok[rows]]
    if len(good) < 2 or log.t[rows[-1]] - log.t[good[0]] < 1.0:
        return None
    part = log.rows(slice(int(good[0]), int(rows[-1]) + 1))
    return replace(part, meta=replace(part.meta, rate=log.rate))


def mean_metrics(metrics: Sequence[Metrics]) -> dict[str, float]:
    """The reported metrics, averaged over logs."""
    return {name: float(np.mean([getattr(m, name) for m in metrics])) for name in REPORTED}
