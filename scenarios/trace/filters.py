"""Influence of the effects found on each filter: its errors without and with them in the model."""

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.stats import ttest_1samp

from surefoot.estimator.evaluation.health import summary_of_run
from surefoot.estimator.evaluation.trajectory import Trajectory, reference
from surefoot.estimator.metrics import SEGMENT, align_first, evaluate, matched, path_length
from surefoot.models.attribution.evidence import LogUnderModel
from surefoot.models.attribution.noise_floor import FloorWalk
from surefoot.models.residuals.binning import at_rows
from surefoot.scenarios.estimate.estimators import ESTIMATORS, estimator_named, traits
from surefoot.scenarios.estimate.run import Learnt, estimated_in_chunks, health_of
from surefoot.scenarios.reporting.tables import METRICS
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.effects import Effect, compensate_all
from surefoot.sim.log import Log
from surefoot.sim.robot.feet import Feet, shown_feet
from surefoot.sim.robot.machine import Machine

REPORTED = {field: column for column, field in METRICS.items() if field != "pi_below_gamma"} | {
    "drift": "drift [m/m]",
    "velocity": "velocity [m/s]",
}
"""Errors of a filter, `drift` and fields of `estimator.metrics.Metrics`, and their headings."""
OF_POSITION = ("ape_trans", "rpe_trans", "drift", "velocity")
"""Errors of the position: the metrics of dead reckoning, which takes its attitude from the
reference and has no covariance.
"""
HARM = 1.05
"""Ratio of a filter's error, after to before, from which compensation makes it worse."""
LOG_PARTS = 4
"""Parts of a log over which the errors of filters are compared."""
DEAD_RECKONING = "dead_reckoning"
"""Listed among the filters: leg odometry, integrated with the reference's attitude."""


@dataclass(frozen=True)
class FilterRun:
    """An estimate of a part of a log, its errors (REPORTED), and why it should not be trusted; ""
    if it can be.
    """

    estimate: Trajectory
    errors: dict[str, float]
    lost: str


@dataclass(frozen=True)
class BeforeAfter:
    """One filter on a part of a log, with the declared model and with the effects compensated."""

    filter: str
    log: Log
    before: FilterRun
    after: FilterRun


@dataclass(frozen=True)
class DriftCauses:
    """The leg filter's drift (`drift_parts`) and its causes.

    Attributes:
        declared: drift (4,) with the declared model.
        added: each effect, and the drift (4,) that it adds where it alone is not compensated; the
            one that adds most to the relative error comes first.
        left: drift (4,) with all effects compensated.
    """

    declared: np.ndarray
    added: tuple[tuple[Effect, np.ndarray], ...]
    left: np.ndarray


def before_and_after(
    cases: Sequence[LogUnderModel], effects: Sequence[Effect], learnt: Learnt, share: float
) -> tuple[BeforeAfter, ...]:
    """Run every filter for which log and `learnt` suffice on the last `share` (0 to 1) of each log,
    without and with effects, from the reference at the first row.

    Omits logs of machines on a fixed base or without an IMU, on which no filter runs, those without
    a reference, which cannot be evaluated, and parts that are too short.
    """
    done = []
    for case in cases:
        t = case.log.t
        ends = t[0] + (1 - share) * (t[-1] - t[0]), t[-1]
        if case.fixed or not (case.log.has("imu") and case.log.has("reference")):
            continue
        before = _estimates(case, (), *ends, ESTIMATORS, learnt)
        after = _estimates(case, effects, *ends, ESTIMATORS, learnt) if effects else before
        if before is None or after is None:
            continue
        truth, sides = reference(before.log), (before, after)
        # Leg filters first, since a better model of the legs affects them most.
        names = [name for name in before.found if name in after.found]
        names.sort(key=lambda name: traits(name).variant or not traits(name).of_legs)
        for name in names:
            runs = [_run(name, truth, one) for one in sides]
            done.append(BeforeAfter(name, before.log, *runs))
    return tuple(done)


class _Estimates(NamedTuple):
    """A part of a log with effects compensated, its model, and the estimates by filter."""

    log: Log
    robot: Machine
    found: dict[str, Trajectory]


def _estimates(
    case: LogUnderModel,
    effects: Sequence[Effect],
    begin: float,
    end: float,
    names: Iterable[str],
    learnt: Learnt,
) -> _Estimates | None:
    """Estimates by filters and, where feet stand, by dead reckoning, as far as they run, on the
    part of a log from `begin` to `end` [s] with these effects; None if it is too short.

    The whole log is compensated before the part is taken, since some effects depend on the time
    since the log began.
    """
    log, robot = compensate_all(effects, case.log, case.robot)
    part, found = stretch(log, begin, end), {}
    if part is None:
        return None
    for name in names:
        with suppress(SurefootError):  # the log or `learnt` lacks an input of this filter
            found[name] = filtered(name, part, robot, learnt)
    feet = shown_feet(part, robot.feet)
    if feet is not None and part.has("contact") and part.contact.any():
        found[DEAD_RECKONING] = dead_reckoned(part, feet)
    return _Estimates(part, robot, found)


def _run(name: str, truth: Trajectory, side: _Estimates) -> FilterRun:
    """One of the estimates, judged by the truth."""
    estimate = side.found[name]
    errors = vars(evaluate(truth, estimate)) | {"drift": drift(truth, estimate)}
    lost = "" if name == DEAD_RECKONING else doubts(name, side.log, side.robot, estimate)
    return FilterRun(estimate, {key: errors[key] for key in REPORTED}, lost)


def drift(truth: Trajectory, estimate: Trajectory) -> float:
    """Error of the last position, after aligning the first poses, over the path's length [m/m]. NaN
    for a path shorter than the segments of the relative error, such as that of a swaying robot.
    """
    truth, aligned, length = _over_path(truth, estimate)
    return float(np.linalg.norm(aligned.p_GI[-1] - truth.p_GI[-1]) / length)


def drift_parts(truth: Trajectory, estimate: Trajectory) -> np.ndarray:
    """How an estimate drifts (4,): relative position error (RPE) [m]; and after aligning the first
    poses, over the path's length, the last errors of height [m/m] and yaw [rad/m] and that of the
    path's length [m/m]. NaN as of `drift`.

    Unlike the last position, none of these returns to zero where the path is a loop.
    """
    rpe = evaluate(truth, estimate).rpe_trans
    truth, aligned, length = _over_path(truth, estimate)
    turned = aligned.R_GI[-1] @ truth.R_GI[-1].T
    height, yaw = aligned.p_GI[-1, 2] - truth.p_GI[-1, 2], np.arctan2(turned[1, 0], turned[0, 0])
    parts = np.array([height, yaw, path_length(aligned.t, aligned.p_GI) - length])
    return np.array([rpe, *(parts / length)])


def _over_path(truth: Trajectory, estimate: Trajectory) -> tuple[Trajectory, Trajectory, float]:
    """Both at the stamps that they share, aligned at the first, and the length of the true path
    [m]; NaN where it is shorter than SEGMENT.
    """
    truth, estimate = matched(truth, estimate)
    length = path_length(truth.t, truth.p_GI)
    return truth, align_first(truth, estimate), length if length >= SEGMENT else np.nan


def causes_of_drift(
    cases: Sequence[LogUnderModel], effects: Sequence[Effect]
) -> DriftCauses | None:
    """What the effects contribute to the leg filter's mean drift over whole logs; None where it
    does not run, and where the logs hardly move.
    """
    judging = [case for case in cases if _judges(case)]

    def mean(compensated: Sequence[Effect]) -> np.ndarray:
        tried = [_by_legs(case, compensated, case.log.t[0], case.log.t[-1]) for case in judging]
        drifts = [drift_parts(truth, one["leg"]) for truth, one in tried if "leg" in one]
        return np.mean(drifts, axis=0) if drifts else np.full(4, np.nan)

    if not effects:
        return None
    declared, left = mean(()), mean(effects)
    if not np.isfinite([declared, left]).all():
        return None
    added = [(one, mean([e for e in effects if e != one]) - left) for one in effects]
    added.sort(key=lambda item: -item[1][0])
    return DriftCauses(declared, tuple(added), left)


def _judges(case: LogUnderModel) -> bool:
    """Whether leg odometry can be judged on this walk. How far given feet roll is not known."""
    walks = not (case.fixed or case.by_feet)
    return walks and case.log.has("imu") and case.log.has("reference")


def _by_legs(
    case: LogUnderModel, compensated: Sequence[Effect], begin: float, end: float
) -> tuple[Trajectory, dict[str, Trajectory]]:
    """Reference, and estimates by leg odometry and by the leg filter, if it runs, on the part of a
    log from `begin` to `end` [s] with these effects compensated; none where no foot stands.
    """
    tried = _estimates(case, compensated, begin, end, ("leg",), Learnt())
    if tried is None or DEAD_RECKONING not in tried.found:
        return reference(case.log), {}
    return reference(tried.log), tried.found


def dead_reckoned(log: Log, feet: Feet) -> Trajectory:
    """Leg odometry: the mean velocity by the standing feet, rotated by the reference's attitude and
    integrated. While no foot stands, the last velocity in the IMU's frame is held.
    """
    R_GI, stands = log.ref_R_GI, log.contact
    omega = at_rows(log.gyro) if log.has("imu") else np.zeros((len(log.t), 3))
    v_I = feet.imu_velocity(*feet.readings(log), omega, R_GI[:, 2], stands)
    supported = np.flatnonzero(stands.any(axis=1))
    mean = np.nansum(v_I[supported], axis=1) / stands[supported].sum(axis=1, keepdims=True)
    latest = np.searchsorted(supported, np.arange(len(log.t)), side="right") - 1
    v_GI = np.einsum("nij,nj->ni", R_GI, mean[np.maximum(latest, 0)])
    p_GI = log.ref_p[0] + cumulative_trapezoid(v_GI, log.t, axis=0, initial=0.0)
    zeros = np.zeros_like(p_GI)
    return Trajectory(log.t, R_GI, v_GI, p_GI, zeros, zeros)


def filtered(name: str, log: Log, robot: Machine, learnt: Learnt) -> Trajectory:
    """One filter's estimate over a log, until it diverged.

    Raises SurefootError naming what the log or `learnt` lacks for it.
    """
    known = robot.legged  # None where only the feet are known
    if known is not None:
        known = replace(known, foot_radius=np.maximum(known.foot_radius, 0.0))
    (found,) = estimated_in_chunks(estimator_named(name), [log], known, learnt)
    return found


def doubts(name: str, log: Log, robot: Machine, estimate: Trajectory) -> str:
    """Why a filter's estimate over a log should not be trusted; "" if it can be."""
    run = [summary_of_run(estimate, log)]
    return health_of(run, estimator_named(name), robot.legged, log).sentence(name)


def stretch(log: Log, begin: float, end: float) -> Log | None:
    """The part of a log from the first row with a reference after `begin` [s] until `end` [s].

    None if it is shorter than a second.
    """
    rows = np.flatnonzero((log.t >= begin) & (log.t <= end))
    good = rows[log.ref_ok[rows]]
    if len(good) < 2 or log.t[rows[-1]] - log.t[good[0]] < 1.0:
        return None
    part = log.rows(slice(int(good[0]), int(rows[-1]) + 1))
    return replace(part, meta=replace(part.meta, rate=log.rate))


def harmful_to_filters(
    cases: Sequence[LogUnderModel], effects: Sequence[Effect], walks: Sequence[FloorWalk]
) -> tuple[Effect, str] | None:
    """The effect without which leg odometry or the leg filter errs least, and why it harms;
    None where neither errs more with the effects than without one of them.

    Judged by the relative error (RPE) on `LOG_PARTS` of each log: the mean increase exceeds `HARM`,
    and zero with a confidence of 97.5 % by Student's t. Errors up to the largest on simulated walks
    of such a robot (`walks`) count alike: they are the method's own, which another error may
    cancel.
    """
    known, worst = _errors_by_legs([(case, effects, LOG_PARTS) for case in cases]), None
    of_walks = _errors_by_legs([(one.case, one.effects, 1) for one in walks])
    for one in effects:
        rest = [e for e in effects if e != one]
        less = _errors_by_legs([(case, rest, LOG_PARTS) for case in cases])
        for name, with_all in known.items():
            if name not in less or len(less[name]) != len(with_all):
                continue
            usual = np.nanmax([-np.inf, *of_walks.get(name, ())])
            more = np.maximum(with_all, usual) - np.maximum(less[name], usual)
            more = more[np.isfinite(more)]
            if len(more) < LOG_PARTS - 1 or np.mean(more) < np.log(HARM):
                continue
            excess = float(ttest_1samp(more, 0.0).confidence_interval().low)
            if excess > 0.0:
                worst = max(worst or (0.0, one, name), (excess, one, name), key=lambda x: x[0])
    return worst and (worst[1], f"it makes {worst[2]} worse")


def _errors_by_legs(
    logs: Sequence[tuple[LogUnderModel, Sequence[Effect], int]],
) -> dict[str, np.ndarray]:
    """Logarithm of the RPE (n,) of leg odometry and the leg filter, by name, on so many equal parts
    of each log that judges them, with these effects compensated.
    """
    found: dict[str, list[float]] = {}
    for case, compensated, parts in (one for one in logs if _judges(one[0])):
        for ends in pairwise(np.linspace(case.log.t[0], case.log.t[-1], parts + 1)):
            truth, tried = _by_legs(case, compensated, *ends)
            for name, estimate in tried.items():
                error = evaluate(truth, estimate).rpe_trans
                found.setdefault(name, []).append(np.log(max(error, 1e-12)))
    return {name: np.array(x) for name, x in found.items()}


def change_of_errors(sides: Mapping[str, Mapping[str, float]]) -> str:
    """ "better", "worse", "mixed" or "same": how a filter's errors of position change from `before`
    to `after`, each by more than `HARM`.
    """
    before, after = sides["before"], sides["after"]
    ratios = [after[key] / before[key] for key in OF_POSITION if before[key] > 0.0]
    grew, fell = any(x > HARM for x in ratios), any(x < 1.0 / HARM for x in ratios)
    return {(1, 0): "worse", (0, 1): "better", (1, 1): "mixed"}.get((grew, fell), "same")


def mean_metrics(stretches: Sequence[BeforeAfter]) -> dict[str, dict[str, dict[str, float]]]:
    """Filter -> "before" or "after" -> each of REPORTED -> its mean over parts of
    logs.
    """
    means: dict[str, dict[str, dict[str, float]]] = {}
    for name in dict.fromkeys(one.filter for one in stretches):
        of_filter = [one for one in stretches if one.filter == name]
        for side in ("before", "after"):
            errors = [getattr(one, side).errors for one in of_filter]
            means.setdefault(name, {})[side] = {
                key: float(np.mean([one[key] for one in errors])) for key in REPORTED
            }
    return means
