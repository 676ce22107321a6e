"""What an effect costs a filter: the leg filter without it in the model, and with it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimator.initial import initial_state
from estimator.leg import encoder_covariance, run_leg
from estimator.metrics import Metrics, evaluate
from estimator.trajectory import Trajectory, reference
from sim.effects import Effect, explain_all
from sim.log import Log, joint_velocity
from sim.robot import Robot

ENCODER = 2e-3
"""rad, the error of a joint angle that the filter reckons with."""
KINEMATICS = 2e-3
"""m, that of links, mounts and soles."""
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
    q, dq = log.q, joint_velocity(log, causal=True)
    return run_leg(
        log.t, log.gyro, log.accel, robot.feet_I(q), log.contact,
        encoder_covariance(robot.feet_jacobian_I(q), ENCODER, KINEMATICS), *initial_state(log),
        foot_radius=np.maximum(robot.foot_radius, 0.0),  # pyright: ignore[reportArgumentType]
        foot_rates_I=robot.foot_rates_I(q, dq),
    )  # fmt: skip


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
