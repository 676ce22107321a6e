"""What an effect costs the filters: each without it in the model, and with it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.integrate import cumulative_trapezoid

from surefoot.estimator.evaluation.run_summary import summary_of_run
from surefoot.estimator.evaluation.trajectory import Trajectory, reference
from surefoot.estimator.metrics import Metrics, align_first, evaluate, matched, path_length
from surefoot.models.residuals.leg_velocity import leg_velocity
from surefoot.scenarios.estimate.estimators import ESTIMATORS, estimator_named, traits
from surefoot.scenarios.estimate.run import Learnt, estimated_in_chunks, health_of
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.effects import Effect, compensate_all
from surefoot.sim.log import Log, joint_velocity
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
DEAD_RECKONING = "dead_reckoning"
"""Name, among filters, of the standing legs' velocity integrated along the reference's attitude."""


@dataclass(frozen=True)
class BeforeAfter:
    """One filter on one stretch of a log, declared model and with the effects explained.

    drift: how far off the last position is, over the length of the path [m/m], before and after.
    lost: why the estimate is not to be trusted, before and after; empty where it is.
    """

    filter: str
    log: Log
    before: Trajectory
    after: Trajectory
    metrics: tuple[Metrics, Metrics]
    drift: tuple[float, float]
    lost: tuple[str, str] = ("", "")


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
        lost = doubts(name, part, robot, before), doubts(name, other, informed, after)
        done.append(replace(_compared(name, part, truth, before, after), lost=lost))
    # Those of the legs first: a model of the legs serves them.
    own = {one.filter: traits(one.filter) for one in done}
    done.sort(key=lambda one: own[one.filter].variant or not own[one.filter].of_legs)
    if all(part.has(group) for group in ("q", "contact")) and part.contact.any():
        before, after = dead_reckoned(part, robot), dead_reckoned(other, informed)
        done.append(_compared(DEAD_RECKONING, part, truth, before, after))
    return done


def _compared(
    name: str, log: Log, truth: Trajectory, before: Trajectory, after: Trajectory
) -> BeforeAfter:
    """Both estimates against the reference.

    Args:
        name: of the filter.
        log: the stretch.
        truth: its reference.
        before: estimate by the declared model.
        after: estimate with the effects.
    """
    metrics = evaluate(truth, before), evaluate(truth, after)
    drifts = drift(truth, before), drift(truth, after)
    return BeforeAfter(name, log, before, after, metrics, drifts)


def drift(truth: Trajectory, estimate: Trajectory) -> float:
    """How far off the last position is once the first poses are aligned, over the length of the
    path [m/m]."""
    truth, estimate = matched(truth, estimate)
    off = align_first(truth, estimate).p_GI[-1] - truth.p_GI[-1]
    return float(np.linalg.norm(off) / max(path_length(truth.t, truth.p_GI), 1e-9))


def dead_reckoned(log: Log, robot: Robot) -> Trajectory:
    """Where the legs alone take the body: the mean velocity by the standing feet, integrated along
    the reference's attitude; while no foot stands the last velocity holds."""
    R_GI, stands = log.ref_R_GI, log.contact
    omega = log.gyro if log.has("imu") else np.zeros((len(log.t), 3))
    v_I = leg_velocity(robot, log.q, joint_velocity(log), omega, R_GI[:, 2], stands)
    some = np.flatnonzero(stands.any(axis=1))
    mean = np.nansum(v_I[some], axis=1) / stands[some].sum(axis=1, keepdims=True)
    last = np.clip(np.searchsorted(some, np.arange(len(log.t)), side="right") - 1, 0, None)
    v_GI = np.einsum("nij,nj->ni", R_GI, mean[last])
    p_GI = log.ref_p[0] + cumulative_trapezoid(v_GI, log.t, axis=0, initial=0.0)
    zeros = np.zeros_like(p_GI)
    return Trajectory(log.t, R_GI, v_GI, p_GI, zeros, zeros)


def filtered(name: str, log: Log, robot: Robot, learnt: Learnt) -> Trajectory:
    """One filter over a log, up to where it diverged. Raises SurefootError saying what it lacks."""
    robot = replace(robot, foot_radius=np.maximum(robot.foot_radius, 0.0))
    (found,) = estimated_in_chunks(estimator_named(name), [log], robot, learnt)
    return found


def doubts(name: str, log: Log, robot: Robot, estimate: Trajectory) -> str:
    """Why a filter's estimate of a log is not to be trusted; empty where it is."""
    run = [summary_of_run(estimate, log)]
    return health_of(run, estimator_named(name), robot, log).sentence(name)


def stretch(log: Log, begin: float, end: float) -> Log | None:
    """The log from `begin` to `end` [s], from its first row with a reference on; None if short."""
    rows = np.flatnonzero((log.t >= begin) & (log.t <= end))
    good = rows[log.ref_ok[rows]]
    if len(good) < 2 or log.t[rows[-1]] - log.t[good[0]] < 1.0:
        return None
    part = log.rows(slice(int(good[0]), int(rows[-1]) + 1))
    return replace(part, meta=replace(part.meta, rate=log.rate))


def mean_metrics(stretches: Sequence[BeforeAfter]) -> dict[str, dict[str, dict[str, float]]]:
    """Filter -> "before", "after" -> the reported metrics and the drift, averaged over logs."""
    means: dict[str, dict[str, dict[str, float]]] = {}
    for name in dict.fromkeys(one.filter for one in stretches):
        own = [one for one in stretches if one.filter == name]
        for i, side in enumerate(("before", "after")):
            found = {m: float(np.mean([getattr(s.metrics[i], m) for s in own])) for m in REPORTED}
            found["drift"] = float(np.mean([s.drift[i] for s in own]))
            means.setdefault(name, {})[side] = found
    return means
