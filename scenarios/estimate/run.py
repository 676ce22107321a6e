"""Run an estimator over a log, as a whole or in pieces, and evaluate the result."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any, TypeVar, cast

import numpy as np

from surefoot.estimator.core.checks import DivergedError, numbers
from surefoot.estimator.core.state import FilterNoise, NavState
from surefoot.estimator.evaluation.health import (
    Health,
    RunSummary,
    health,
    joined_summary,
    summary_of_run,
)
from surefoot.estimator.evaluation.trajectory import (
    Trajectory,
    UpdateRecord,
    reference,
    with_mounting,
)
from surefoot.estimator.metrics import Metrics, evaluate
from surefoot.estimator.run import output_stride, state_parts
from surefoot.scenarios.estimate.contract import (
    Beginning,
    Estimator,
    Learnt,
    Stream,
    Update,
    samples,
)
from surefoot.scenarios.estimate.estimators import ESTIMATORS, estimator_named
from surefoot.scenarios.estimate.settings import FilterSettings, tuned
from surefoot.sim.common.errors import SurefootError, errors_in
from surefoot.sim.common.progress import bar as drawn_bar
from surefoot.sim.effects import compensate_all, declared_effects
from surefoot.sim.log import Log
from surefoot.sim.robot.feet import Feet, PointFeet
from surefoot.sim.robot.machine import machine_for_log
from surefoot.sim.robot.robot import Robot

_R = TypeVar("_R", Robot, Robot | None)
_P = TypeVar("_P", Trajectory, UpdateRecord)


@dataclass(frozen=True)
class Result:
    """One filter on one log."""

    filter: str
    log: str
    trajectory: Trajectory
    metrics: Metrics | None  # None where the log has no reference, or the filter diverged
    step_time: float  # s a sample, the observer's and the legs' share included
    health: Health  # whether to believe it


def run_filter(
    name: str,
    log: Log,
    robot: Robot | None,
    learnt: Learnt | None = None,
    settings: FilterSettings | None = None,
) -> Result:
    """Estimate a log with one filter; `Result.health` tells whether to trust it.

    The filter uses the declared model: effects that the log declares are compensated first. Raises
    SurefootError saying what is missing.

    Args:
        name: of the filter.
        log: to estimate.
        robot: of the log, as from `robot_of`.
        learnt: observers and bounds.
        settings: noise, priors and start; by default those tuned for the robot.
    """
    estimator = estimator_named(name)
    log.require("imu")
    log, robot = declared_model(log, robot)
    learnt = learnt or Learnt()
    with errors_in(f"filter {name}"):
        if name not in _compiled:  # on a fresh machine: not the filter's own time
            with suppress(SurefootError):
                estimated(estimator, log.rows(slice(0, 64)), robot, learnt)
            _compiled.add(name)
        started = perf_counter()
        (trajectory,) = estimated_in_chunks(estimator, [log], robot, learnt, settings)
        elapsed = perf_counter() - started
    found = health_of([summary_of_run(trajectory, log)], estimator, robot, log, settings)
    compared = log.has("reference") and not trajectory.diverged
    judged = evaluate(reference(log), trajectory) if compared else None
    return Result(name, log.name, trajectory, judged, elapsed / len(log.t), found)


def health_of(
    parts: Sequence[RunSummary],
    estimator: Estimator,
    robot: Robot | None,
    log: Log,
    settings: FilterSettings | None = None,
) -> Health:
    """Test whether to trust an estimate of a log, or of one in pieces of which `log` is one.

    Args:
        parts: summaries of the estimates.
        estimator: of the estimate.
        robot: of the log.
        log: names its feet.
        settings: with which it ran.
    """
    legs = log.legs if log.has("contact") else ()
    values, usual = parameters_of(estimator, robot, settings), FilterNoise()
    walk = (
        values.get("accel_walk", float(usual.accel_walk)),
        values.get("gyro_walk", float(usual.gyro_walk)),
    )
    return health(joined_summary(parts), legs, walk)


def parameters_of(
    estimator: Estimator, robot: Robot | None, settings: FilterSettings | None = None
) -> dict[str, float]:
    """Parameters of an estimator for a robot: those in `settings`, else the tuned ones."""
    values = tuned(robot).of(estimator)
    return values if settings is None else settings.parameters(estimator, values)


_compiled: set[str] = set()


def robot_of(log: Log, name: str | None = None) -> Robot | None:
    """The robot `name`, or else the log's own (`Robot.for_log`); None without either."""
    return Robot.for_log(log, name) if name or log.meta.robot else None


def declared_model(log: Log, robot: _R) -> tuple[Log, _R]:
    """The log and robot with the effects that the log declares compensated.

    Raises SurefootError where it declares effects and neither a robot nor the feet are known.
    """
    effects = declared_effects(log)
    if effects and robot is None:
        return compensate_all(effects, log, machine_for_log(log))[0], robot
    return compensate_all(effects, log, robot)


def run_all(
    log: Log,
    robot: Robot | None,
    learnt: Learnt,
    names: Sequence[str] | None = None,
    settings: FilterSettings | None = None,
    progress: bool = False,
) -> tuple[list[Result], dict[str, str]]:
    """Run every filter that the inputs allow; also returns why each other was left out.

    Args:
        log: to estimate.
        robot: of the log.
        learnt: observers and bounds.
        names: of the filters; by default all.
        settings: as for `run_filter`.
        progress: whether to show a bar.
    """
    results: list[Result] = []
    left_out: dict[str, str] = {}
    chosen = list(names or ESTIMATORS)
    with drawn_bar(chosen, desc=f"filters on {log.name}"[:24], disable=not progress) as bar:
        for name in bar:
            bar.set_postfix_str(name, refresh=False)  # or a pipe has a line an item
            try:
                results.append(run_filter(name, log, robot, learnt, settings))
            except SurefootError as error:
                reason = str(error).removeprefix(f"filter {name}: ")
                left_out[name] = reason.removeprefix(f"{log.name}: ")
    return results, left_out


def estimated(
    estimator: Estimator,
    log: Log,
    robot: Robot | None,
    learnt: Learnt,
    settings: FilterSettings | None = None,
) -> Trajectory:
    """Trajectory of one estimator over a log whose declared effects are compensated.

    Raises SurefootError saying what is missing, or that it diverged.

    Args:
        estimator: to run.
        log: to estimate.
        robot: of the log.
        learnt: observers and bounds.
        settings: as for `run_filter`.
    """
    (found,) = estimated_in_chunks(estimator, [log], robot, learnt, settings)
    if found.diverged:
        raise SurefootError(f"filter: the estimate is not finite after t = {found.t[-1]:.3f} s")
    return found


def estimated_in_chunks(
    estimator: Estimator,
    chunks: Iterable[Log],
    robot: Robot | None,
    learnt: Learnt,
    settings: FilterSettings | None = None,
) -> Iterator[Trajectory]:
    """`estimated` for a log that comes in pieces, each of which may be discarded after use.

    Ends where a filter diverged. Raises SurefootError saying what is missing, or that it requires
    whole logs.

    Args:
        estimator: to run.
        chunks: successive rows of a log.
        robot: of the log.
        learnt: observers and bounds.
        settings: as for `run_filter`.
    """
    with ESTIMATORS.running(estimator.name):
        mounting = tuned(robot).mounting
        remaining = iter(chunks)
        log, following = next(remaining, None), next(remaining, None)
        stream: Stream | None = None
        seen = stride = 0
        while log is not None:
            estimator.needs.check(log, robot)
            more = following is not None
            t = log.t
            log = _prepared(estimator, log, robot, more or stream is not None)
            if stream is None:
                stream = begin(estimator, log, robot, learnt, settings)
                stride = output_stride(log.t)
            rows = np.arange(-seen % stride, len(t), stride)
            run: Any = getattr(stream, "run", None)
            part = stepped(stream, log, rows) if run is None else run(log, rows, more)
            _check_part(part, t[rows])
            yield with_mounting(part, mounting)
            if part.diverged:
                return
            seen += len(t)
            log, following = following, next(remaining, None)


def begin(
    estimator: Estimator,
    log: Log,
    robot: Robot | None,
    learnt: Learnt,
    settings: FilterSettings | None = None,
) -> Stream:
    """Start a stream of an estimator at the first row of a log.

    Raises SurefootError saying what is missing.

    Args:
        estimator: to run.
        log: whose start determines the initial state.
        robot: of the log.
        learnt: observers and bounds.
        settings: as for `run_filter`.
    """
    estimator.needs.check(log, robot)
    values = parameters_of(estimator, robot, settings)
    feet = feet_of(log, robot)
    state, covariance = (settings or FilterSettings()).beginning(log, feet)
    joints = log.joints if log.has("q") else ()
    given = log.legs if isinstance(feet, PointFeet) else ()
    at = Beginning(state, covariance, log.rate, joints, log.meta.derived, given)
    # The robot is None for those alone whose needs say that it may be.
    return estimator.start(cast(Robot, robot), learnt, values, at)


def feet_of(log: Log, robot: Robot | None) -> Feet | None:
    """How a log shows the feet of its robot: by joint angles if it can, which also say how feet
    roll; None if it does not.
    """
    if robot is not None and log.has("q"):
        return robot.feet
    return PointFeet() if log.has("foot") else None


def _prepared(estimator: Estimator, log: Log, robot: Robot | None, in_chunks: bool) -> Log:
    """The log with what an estimator computes from it as a whole."""
    prepare: Any = getattr(estimator, "prepare", None)
    prepared = log if prepare is None else prepare(log, robot)
    if in_chunks and prepared is not log:
        raise SurefootError(f"{estimator.name} takes a whole log at once, not one in pieces")
    return prepared


def _check_part(part: Trajectory, t: np.ndarray) -> None:
    """Raise SurefootError where estimates are not at t (L,) [s], at least until the filter
    diverged, or not real and finite.
    """
    n = len(part.t)
    if not np.array_equal(part.t, t[:n]) or (n < len(t) and not part.diverged):
        raise SurefootError("the estimates are not at the rows that were asked for")
    for name in ("R_GI", "v_GI", "p_GI", "b_a", "b_g", "covariance"):
        value = getattr(part, name)
        if value is not None:
            numbers(f"{name} of the estimate", value, value.shape)


def stepped(stream: Stream, log: Log, rows: np.ndarray) -> Trajectory:
    """Estimates of a stream at rows (L,) of a log, sample by sample, until it reports
    divergence.
    """
    states: list[NavState] = []
    covariances: list[np.ndarray] = []
    updates: list[tuple[float, Update]] = []
    wanted, diverged = set(rows.tolist()), False
    for k, sample in enumerate(samples(log)):
        try:
            update = stream.step(sample)
        except DivergedError:
            diverged = True
            break
        if update is not None:
            updates.append((sample.t, update))
        if k in wanted:
            states.append(stream.state)
            covariances.append(stream.covariance)
    mean = np.array([state.pack() for state in states]).reshape(-1, 7, 3)
    covariance = np.array(covariances).reshape(-1, 15, 15)
    t, parts = log.t[rows[: len(states)]], state_parts(mean)
    return Trajectory(t, *parts, covariance, _record(updates), diverged=diverged)


def _record(updates: list[tuple[float, Update]]) -> UpdateRecord | None:
    if not updates:
        return None
    t, each = zip(*updates, strict=True)
    v_I, epsilon, pi, active = zip(*each, strict=True)
    bounded = epsilon[0] is not None
    return UpdateRecord(
        np.array(t),
        numbers("v_I of the updates", v_I, (len(t), 3)),
        np.array(epsilon) if bounded else None,
        np.array(pi, dtype=float) if bounded else None,
        np.array(active),
    )


def joined_trajectory(parts: Iterable[Trajectory]) -> Trajectory:
    """Concatenate successive trajectories."""
    parts = list(parts)
    records = [part.updates for part in parts if part.updates is not None]
    updates = _joined(records) if records else None
    return replace(_joined(parts), updates=updates, innovations=None, diverged=False)


def _joined(parts: Sequence[_P]) -> _P:
    """The first part with the arrays of all of them."""
    names = [name for name, value in vars(parts[0]).items() if isinstance(value, np.ndarray)]
    arrays = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    return replace(parts[0], **arrays)
