"""Close the loop: trace a measured log, simulate the effects found, train observers, estimate
again.

In the step `before` the simulated robot is as declared. In `after` it also has the effects that the
trace found, in place of effects of the same kind that are drawn for any robot of its kind. In each
step observers are trained and calibrated on drawn walks of that robot (`surefoot train --walks`),
with sizes drawn from the intervals found. In `tuned` the observers of `after` are trained further
on one end of the measured log, and their bounds are calibrated on its middle.

Every filter estimates both ends of the measured log with the model and observers of each step. An
observer tuned on one end is evaluated on the other. Without PyTorch, or if the robot cannot walk in
simulation, there are no observers: filters that need none are run.
"""

import json
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from surefoot.models.attribution.evidence import candidates_digest
from surefoot.models.calibration.calibrate import bounds_on, unseen_errors
from surefoot.models.calibration.regions import BoundsError, calibrator, errors_needed
from surefoot.models.calibration.settings import CALIBRATE_DEFAULT
from surefoot.models.observer.observer import ObserverError
from surefoot.models.observer.samples import DQ_CAUSAL
from surefoot.models.observer.settings import (
    INSTALL_TORCH,
    TRAIN_DEFAULT,
    TrainSettings,
    torch_is_installed,
)
from surefoot.scenarios.cache import contents_digest
from surefoot.scenarios.compare import compare_log
from surefoot.scenarios.estimate.run import Learnt
from surefoot.scenarios.reporting.pages import check_page
from surefoot.scenarios.settings import LoopSettings
from surefoot.scenarios.stages import percent_bar
from surefoot.scenarios.trace.loop_report import LoopStep, write_loop
from surefoot.scenarios.trace.realism import beyond_simulated, simulated_robot
from surefoot.scenarios.trace.report import summary
from surefoot.scenarios.trace.run import TraceOptions, trace
from surefoot.scenarios.training.many_walks import DrawnWalks, OwnEffects, held_out_walks
from surefoot.sim.common.errors import SurefootError, check_seed
from surefoot.sim.common.files import as_made, kept_json, refuse_full, write_whole
from surefoot.sim.common.quaternion import quaternion_from_matrix
from surefoot.sim.common.sources import sources_digest
from surefoot.sim.effects import Effect, compensate_all, declared_effects, effect
from surefoot.sim.effects.file import load_effects
from surefoot.sim.log import Log, joint_velocity
from surefoot.sim.robot import Robot

RECIPE = "recipe.json"
STEPS = ("before", "after", "tuned")
ENDS = ("first", "last")
END = 0.4
"""Length of each end of the measured log, as a share of it; the rest is its middle."""
TRAINING = replace(TRAIN_DEFAULT, batch=12, width=96)
"""Course of a training on many walks."""
HALF_WIDTH = 1.96
"""Half width of a normal distribution's 95 % interval, in standard deviations."""


def loop(
    log: Log,
    robot: Robot,
    settings: LoopSettings,
    declared: Sequence[Effect] | None = None,
    holdout: Sequence[Log] = (),
) -> str:
    """Close the loop on one log and write the results into `out`; an interrupted run is resumed.
    Without PyTorch it trains no observers, and does so once that is installed.

    Returns the findings as text. Raises LogError if the log lacks IMU, joints or reference, and
    SurefootError if `out` has files of another loop and `force` is not given.

    Args:
        log: the measured log.
        robot: as declared.
        settings: where to, number of walks, and the seed of trace, walks and training.
        declared: effects that belong to the model, beyond those that the log declares; the trace
            then looks for what has changed since (see `trace`).
        holdout: logs of the same machine, on which the effects found are evaluated and nothing is
            fitted.
    """
    out, seed = settings.out, settings.seed
    check_seed(seed)
    if settings.walks < 2:
        raise SurefootError("walks must be at least 2")
    log.require("imu", "q", "reference")
    if settings.page:
        check_page(settings.page)
    recipe = {
        "log": contents_digest(log),
        "robot": [robot.name, robot.digest],
        "code": [sources_digest(__name__), candidates_digest()],
        "seed": seed,
        "declared": None if declared is None else [e.as_dict() for e in declared],
        "holdout": [contents_digest(one) for one in holdout],
        "walks": settings.walks,
    }
    if settings.force or kept_json(out / RECIPE) != recipe:
        refuse_full(out, settings.force)
        write_whole(out / RECIPE, json.dumps(recipe, indent=2) + "\n", force=True)
        for stale in ("trace/trace.json", *(f"{step}/done" for step in STEPS)):
            (out / stale).unlink(missing_ok=True)
    model = (*declared_effects(log), *(declared or ()))
    options = TraceOptions(seed, model or declared, holdout=holdout)
    found, spread = _traced(log, robot, out / "trace", options)
    planned = {"before": model} | ({"after": (*model, *found)} if found else {})
    steps, reason = [], "" if torch_is_installed() else INSTALL_TORCH
    for name, effects in planned.items():
        learnt = Learnt()
        if not reason:
            try:
                own = OwnEffects(effects, spread)
                learnt = _learnt(robot, own, log, out / name, settings)
            except SurefootError as error:  # the robot does not walk in simulation
                reason = str(error)
        measured, corrected = _compensated(log, robot, effects)
        steps.append(_step(name, effects, [learnt, learnt], measured, corrected))
    measured, corrected = _compensated(log, robot, steps[-1].effects)
    if not reason:
        how = replace(TRAINING, seed=seed)
        try:
            tuned = _tuned(steps[-1].learnt[0], measured, corrected, out / "tuned", how)
            steps.append(_step("tuned", steps[-1].effects, tuned, measured, corrected))
        except (ObserverError, BoundsError) as error:  # the log is too short
            reason = f"none is tuned on the measured walk: {error}"
    return write_loop(log, robot, steps, settings, reason)


def ends(log: Log) -> list[Log]:
    """Both ends of a log, the first one first, each END of its duration."""
    return _parts(log)[::2]


def _parts(log: Log) -> list[Log]:
    """First end, middle and last end of a log."""
    share = (log.t - log.t[0]) / (log.t[-1] - log.t[0])
    cuts = np.searchsorted(share, END, "right"), np.searchsorted(share, 1.0 - END)
    rows = np.split(np.arange(len(share)), cuts)
    return [log.rows(one) for one in rows]


def _step(
    name: str, effects: Sequence[Effect], learnt: Sequence[Learnt], log: Log, robot: Robot
) -> LoopStep:
    """Every filter on both ends of the log.

    Args:
        name: one of STEPS.
        effects: of the model.
        learnt: observers and bounds for each of the two ends.
        log: the measured log, and
        robot: its model, both compensated.
    """
    pairs = zip(ends(log), learnt, strict=True)
    compared = tuple(compare_log(end, robot, one) for end, one in pairs)
    return LoopStep(name, tuple(effects), tuple(learnt), compared)


def inputs_of(log: Log) -> str:
    """Inputs of an observer for this log: the IMU, what its feet say and, if available, which
    stand.

    Leg odometry with the declared model transfers better from simulation to the robot than joint
    angles do. Friction and currents of motors make measured torques differ from simulated ones.
    """
    return "gyro,accel,contact,feet" if log.has("contact") else "gyro,accel,feet"


def _traced(
    log: Log, robot: Robot, out: Path, options: TraceOptions
) -> tuple[tuple[Effect, ...], dict[tuple[str, str], float]]:
    """The effects found on the log, and its own zeros and clocks; traced unless already done. Also
    returns the standard deviation of each size that has an interval, by name and target.
    """
    if not all(as_made(out / name) for name in ("trace.json", "effects.toml")):
        with percent_bar("trace") as progress:
            found = trace([log], robot, out, options, progress, force=True)
        print(summary(found))
    result = json.loads((out / "trace.json").read_text(encoding="utf-8"))
    zeros = [one for run in result["runs"] for one in run if one["compensated"]]
    of_run = tuple(effect(one["name"], one["target"], one["value"]) for one in zeros)
    spread = {
        (one["name"], one["target"]): float(np.ptp(one["interval"])) / (2.0 * HALF_WIDTH)
        for one in result["effects"]
    }
    return (*load_effects(out / "effects.toml"), *of_run), spread


def _compensated(log: Log, robot: Robot, effects: Sequence[Effect]) -> tuple[Log, Robot]:
    """The measured log and the robot with the effects compensated, and with joint rates.

    The log no longer declares any effects, so that none is compensated twice.
    """
    compensated, model = compensate_all(effects, log, robot)
    compensated = replace(compensated, meta=replace(compensated.meta, effects=()))
    return with_rates(compensated, log.has("dq")), model


def with_rates(log: Log, has_rates: bool) -> Log:
    """Give a log joint rates of the same origin as the measured log's.

    If that logs none, filters derive them from past angles, and so does this function.
    """
    if has_rates:
        return log
    kept = log.frame[[c for c in log.frame if not str(c).startswith("dq_")]]
    rates = joint_velocity(replace(log, frame=kept), causal=True)
    columns = {f"dq_{joint}": rates[:, i] for i, joint in enumerate(log.joints)}
    meta = replace(log.meta, derived=(*log.meta.derived, DQ_CAUSAL))
    return replace(log, frame=kept.assign(**columns), meta=meta)


def seen_as_measured(
    effects: Sequence[Effect], simulated: Robot, has_rates: bool, walked: Log
) -> Log:
    """A simulated log as filters see the measured one: with these effects compensated.

    Its metadata names the resulting mounting of the IMU and radius of the feet, since an observer
    stores the mounting that it was trained with.

    Args:
        effects: to compensate.
        simulated: the robot, without them.
        has_rates: whether the measured log has joint rates; otherwise they are derived.
        walked: the simulated log.
    """
    log, model = compensate_all(effects, walked, simulated)
    corrected = {
        "p_BI": model.p_BI.tolist(),
        "q_BI": quaternion_from_matrix(model.R_BI).tolist(),
        "foot_radius": model.foot_radius.tolist(),
    }
    declared = tuple(one.as_dict() for one in effects)
    log = replace(log, meta=replace(log.meta, effects=declared, model=log.meta.model | corrected))
    return with_rates(log, has_rates)


def _learnt(robot: Robot, own: OwnEffects, log: Log, out: Path, settings: LoopSettings) -> Learnt:
    """Observers and bounds from drawn walks; trained unless already done.

    Args:
        robot: as declared.
        own: its effects.
        log: the measured log, whose columns determine the observers' inputs.
        out: folder of this step.
        settings: number of walks, and the seed of walks and training.
    """
    from surefoot.scenarios.estimate.learning import learn, learnt_in

    done = out / "done"
    if not (done.exists() and all(map(as_made, out.glob("*.*")))):
        simulated, seed = simulated_robot(robot), settings.seed
        own = replace(own, effects=beyond_simulated(own.effects, robot, simulated))
        seen = partial(seen_as_measured, own.effects, simulated, log.has("dq"))
        counts = {
            "train": settings.walks,
            "held_out": held_out_walks(settings.walks),
            "calibrate": settings.walks // 2,
        }
        walks = {
            role: replace(DrawnWalks(simulated, role, seed, own=own).kept(count), seen_as=seen)
            for role, count in counts.items()
        }
        how = replace(TRAINING, inputs=inputs_of(log), seed=seed)
        held_out = tuple(walks["held_out"])
        learn(walks["train"], walks["calibrate"], out, how, force=True, held_out=held_out)
        done.touch()
    return learnt_in(out)


def _tuned(
    learnt: Learnt, log: Log, robot: Robot, out: Path, settings: TrainSettings
) -> list[Learnt]:
    """Observers for each end, tuned on the other one, with bounds from the middle.

    How the errors of a whole walk differ from another's does not show in a few seconds: the
    persistent part of the bounds is that of the simulated walks. Raises ObserverError or
    BoundsError where the log is too short.

    Args:
        learnt: observers and bounds from simulated walks.
        log: the measured log, and
        robot: its model, both compensated.
        out: folder of this step.
        settings: of the training; network, inputs and loss are the observer's.
    """
    from surefoot.models.observer.training import train
    from surefoot.scenarios.estimate.learning import learnt_in

    done = out / "done"
    needed = errors_needed(calibrator(CALIBRATE_DEFAULT.method, CALIBRATE_DEFAULT.gamma))
    if not (done.exists() and all(map(as_made, out.glob("*/*.*")))):
        for end, other in zip(ENDS, reversed(ends(log)), strict=True):
            for observer, bounds in zip(learnt.observers, learnt.bounds, strict=True):
                tuned = train(other, robot, settings, start=observer)
                unseen = unseen_errors(tuned, [_parts(log)[1]], robot)
                # As far apart as independent errors are, or as the middle allows.
                K = max(1, min(bounds.K, len(unseen.errors[0]) // needed))
                new = bounds_on(tuned, unseen, replace(CALIBRATE_DEFAULT, K=K))
                new = replace(new, persistent=bounds.persistent)
                tuned.save(out / end / f"observer_{tuned.loss}.safetensors", force=True)
                new.save(out / end / f"bounds_{tuned.loss}.json", force=True)
        done.touch()
    return [learnt_in(out / end) for end in ENDS]
