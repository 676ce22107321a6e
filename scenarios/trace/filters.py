"""What an effect costs the filters: each without it in the model, and with it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from surefoot.estimator.evaluation.trajectory import Trajectory, reference
from surefoot.estimator.metrics import Metrics, evaluate
from surefoot.scenarios.estimate.estimators import ESTIMATORS, estimator_named, traits
from surefoot.scenarios.estimate.run import Learnt, estimated
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.effects import Effect, compensate_all
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot

REPORTED = (
    "ape_trans",
    "ape_rot",
    "rpe_trans",
    "rpe_rot",
    "velocity",
    "nees_position",
    "nees_velocity",
    "nees_attitude",
)


@dataclass(frozen=True)
class BeforeAfter:
    """One filter on one stretch of a log, declared model and with the effects explained."""

    filter: str
    log: Log
    before: Trajectory
    after: Trajectory
    metrics: tuple[Metrics, Metrics]


def before_and_after(
    log: Log, robot: Robot, effects: Sequence[Effect], learnt: Learnt, begin: float, end: float
) -> list[BeforeAfter]:
    """Every filter that the log and the learnt files allow, on one stretch, without and with the
    effects compensated; started from the reference at its first row.

    Empty where the stretch is too short. The whole log is compensated before it is cut: the size of
    some effects goes with the time since the log began.

    Args:
        log: the measured log.
        robot: as declared.
        effects: that were found.
        learnt: observers and bounds.
        begin: of the stretch [s].
        end: of the stretch [s].
    """
    explained, informed = compensate_all(effects, log, robot)
    part, other = stretch(log, begin, end), stretch(explained, begin, end)
    if part is None or other is None:
        return []
    truth, done = reference(part), []
    for name in ESTIMATORS:
        try:
            before = filtered(name, part, robot, learnt)
            after = filtered(name, other, informed, learnt) if effects else before
        except SurefootError:  # the log, or what was learnt, lacks what this filter takes
            continue
        metrics = evaluate(truth, before), evaluate(truth, after)
        done.append(BeforeAfter(name, part, before, after, metrics))
    # Those of the legs first: a model of the legs serves them.
    own = {one.filter: traits(one.filter) for one in done}
    return sorted(done, key=lambda one: own[one.filter].variant or not own[one.filter].of_legs)


def filtered(name: str, log: Log, robot: Robot, learnt: Learnt) -> Trajectory:
    """One filter over a log. Raises SurefootError saying what it lacks."""
    robot = replace(robot, foot_radius=np.maximum(robot.foot_radius, 0.0))
    return estimated(estimator_named(name), log, robot, learnt)


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
