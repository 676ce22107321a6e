"""The loop closed: trace a measured log, put what it lacks into the simulation, retrain,
estimate the same log again, and compare.

Two worlds are simulated, `before` as the model was declared and `after` with the effects found. In
each a robot walks in the style of the measured log (`sim.walking.imitation`), an observer is
trained and calibrated on those walks alone, and every filter estimates the measured log with that
world's model and that world's observer.
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from surefoot.models.attribution.evidence import candidates_code
from surefoot.models.observer.training import DEFAULT_SCHEDULE, Schedule
from surefoot.scenarios.cache import contents_digest
from surefoot.scenarios.estimate.compare import compare_log
from surefoot.scenarios.estimate.learning import learn, learnt_in
from surefoot.scenarios.estimate.run import Learnt, declared_model
from surefoot.scenarios.reporting.progress import percent_bar
from surefoot.scenarios.trace.loop_report import Side, write_loop
from surefoot.scenarios.trace.run import trace
from surefoot.scenarios.trace.words import caution, summary
from surefoot.sim.common.errors import SurefootError, check_seed
from surefoot.sim.common.files import refuse_full, whole_file
from surefoot.sim.common.sources import sources_digest
from surefoot.sim.effects import Effect, declared_effects, effect
from surefoot.sim.effects.file import load_effects
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario
from surefoot.sim.walk import Fallen, walk
from surefoot.sim.walking.imitation import WalkingStyle, imitation, slower, walking_style

PACES = (1.0, 0.8, 0.6, 0.4)
"""Shares of the measured velocities that are tried until the robot does not fall."""
RECIPE = "recipe.json"
_MODULE = "surefoot.scenarios.trace.loop"


@dataclass(frozen=True)
class TrainingPlan:
    """How much an observer is trained in simulation."""

    walks: int = 8
    seconds: float = 30.0  # of each walk to train on
    calibration: float = 150.0  # s of the one to calibrate on
    schedule: Schedule = DEFAULT_SCHEDULE


def loop(
    log: Log,
    robot: Robot,
    out: Path,
    seed: int = 0,
    force: bool = False,
    plan: TrainingPlan = TrainingPlan(),
    declared: Sequence[Effect] | None = None,
    holdout: Sequence[Log] = (),
) -> tuple[pd.DataFrame, tuple[Side, ...]]:
    """Close the loop on one log into `out`; a run that was killed goes on where it stopped.

    Returns the table, one row a filter with each metric before and after, and the two sides (one
    where nothing was found to add). Raises LogError where the log lacks IMU, joints or reference,
    and SurefootError where `out` holds another loop's files and `force` is not given.

    Args:
        log: the measured log.
        robot: as declared.
        out: folder.
        seed: of trace, walks and training.
        force: whether the files of another loop may be replaced.
        plan: how much to walk and train.
        declared: effects that belong to the model, beyond those that the log declares; what is
            traced is then what has changed since.
        holdout: logs of the same machine that judge what was found.
    """
    check_seed(seed)
    log.require("imu", "q", "reference")
    shown = walking_style(*declared_model(log, robot))
    recipe = {
        "log": contents_digest(log),
        "robot": [robot.name, robot.digest],
        "code": [sources_digest(_MODULE), candidates_code()],
        "seed": seed,
        "declared": None if declared is None else [e.as_dict() for e in declared],
        "holdout": [contents_digest(one) for one in holdout],
        "lesson": asdict(plan),
    }
    if force or not _same(out, recipe):
        refuse_full(out, force)
        with whole_file(out / RECIPE, True) as path:
            path.write_text(json.dumps(recipe, indent=2) + "\n", encoding="utf-8")
        for stale in ("trace/trace.json", "before/done", "after/done"):
            (out / stale).unlink(missing_ok=True)
    model = (*declared_effects(log), *(declared or ()))
    known = model or declared
    found = _traced(log, robot, out / "trace", seed, known, holdout)
    worlds = {"before": model, "after": (*model, *found)} if found else {"before": model}
    sides = []
    for name, effects in worlds.items():
        learnt = _learnt(shown, log, robot, effects, out / name, seed, plan)
        declared_then = tuple(e.as_dict() for e in effects)
        as_modelled = replace(log, meta=replace(log.meta, effects=declared_then))
        sides.append(Side(name, effects, learnt, compare_log(as_modelled, robot, learnt)))
    return write_loop(log, robot, sides, out), tuple(sides)


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
    plan: TrainingPlan = TrainingPlan(),
    progress: Callable[[float], None] = lambda share: None,
) -> tuple[list[Log], Log]:
    """Logs to train on and one to calibrate on, by the model with the effects.

    Args:
        shown: style of the measured walk.
        robot: as declared.
        effects: added to the model.
        seed: of the walks.
        plan: how many walks and how long.
        progress: called with the share done.
    """
    world = world_of(robot)
    added = bodily(effects, robot, world)
    logs = []
    for k, seconds in enumerate([*[plan.seconds] * plan.walks, plan.calibration]):
        rng = np.random.default_rng([seed, k])
        scenario, poised = imitation(shown, world, f"imitation_{k}", seconds, rng)
        walked = _walk(scenario, poised, seed + k, added)
        logs.append(declared_model(replace(walked, name=scenario.name), world)[0])
        progress((k + 1) / (plan.walks + 1))
    return logs[:-1], logs[-1]


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


def inputs_of(log: Log) -> str:
    """What an observer of this log can read: q, and dq and tau where both or the first are."""
    if not log.has("dq"):
        return "q"
    return "q,dq,tau" if log.has("tau") else "q,dq"


def _traced(
    log: Log,
    robot: Robot,
    out: Path,
    seed: int,
    declared: Sequence[Effect] | None,
    holdout: Sequence[Log],
) -> tuple[Effect, ...]:
    """The effects found on the log, and its own zeros, traced unless a trace is there.

    Args:
        log: the measured log.
        robot: as declared.
        out: folder.
        seed: of the trace.
        declared: effects already in the model, None where what is asked is not a change.
        holdout: logs that judge what was found.
    """
    if not (out / "trace.json").exists():
        more = {"declared": declared, "holdout": holdout}
        with percent_bar("trace") as progress:
            found = trace([log], robot, out, seed, progress, force=True, **more)
        print(summary(found))
        if warned := caution(found.as_dict()):
            print(warned)
    runs = json.loads((out / "trace.json").read_text(encoding="utf-8"))["runs"]
    zeros = [one for run in runs for one in run if one["compensated"]]
    own = tuple(effect(one["name"], one["target"], one["value"]) for one in zeros)
    return (*load_effects(out / "effects.toml"), *own)


def _learnt(
    shown: WalkingStyle,
    log: Log,
    robot: Robot,
    effects: Sequence[Effect],
    out: Path,
    seed: int,
    plan: TrainingPlan,
) -> Learnt:
    """Observers and bounds by the model with the effects, trained unless they are there.

    Args:
        shown: style of the measured walk.
        log: whose inputs the observer has.
        robot: as declared.
        effects: added to the model.
        out: folder.
        seed: of walks and training.
        plan: how much to walk and train.
    """
    done = out / "done"
    if not done.exists():
        with percent_bar(f"walking: {out.name}") as progress:
            training, calibration = simulate_training(shown, robot, effects, seed, plan, progress)
        inputs = inputs_of(log)
        learn(training, calibration, out, seed, inputs, force=True, schedule=plan.schedule)
        done.touch()
    return learnt_in(out)


def _same(out: Path, recipe: dict[str, object]) -> bool:
    try:
        return json.loads((out / RECIPE).read_text(encoding="utf-8")) == recipe
    except (OSError, ValueError):
        return False
