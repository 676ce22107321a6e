"""The loop closed: trace a measured log, put what it lacks into the simulation, retrain,
estimate the same log again, and compare.

Worlds are simulated: `before` as the model was declared, `effects` with what was found, and `after`
in the gait too that is more like the measured one; where that is the plain one there is no
`effects`. In each a robot walks in the style of the measured log (`sim.walking.imitation`), an
observer is trained and calibrated on those walks alone, and every filter estimates the measured log
with that world's model and that world's observer.
"""

import json
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path

import pandas as pd

from surefoot.models.attribution.evidence import candidates_code
from surefoot.models.observer.observer import ObserverError
from surefoot.scenarios.cache import contents_digest
from surefoot.scenarios.estimate.compare import compare_log
from surefoot.scenarios.estimate.learning import learn, learnt_in
from surefoot.scenarios.estimate.run import Learnt, declared_model
from surefoot.scenarios.experiments.as_walked import load_as_walked
from surefoot.scenarios.reporting.progress import percent_bar
from surefoot.scenarios.studies.pages import check_page
from surefoot.scenarios.trace.gait_choice import GaitChoice, choose_gait
from surefoot.scenarios.trace.loop_report import Side, write_loop
from surefoot.scenarios.trace.observer_errors import (
    ErrorParts,
    error_parts,
    learnt_from_measured,
)
from surefoot.scenarios.trace.run import trace
from surefoot.scenarios.trace.training_walks import (
    DEFAULT_PLAN,
    TrainingPlan,
    rates_as_of,
    simulate_training,
)
from surefoot.scenarios.trace.words import caution, summary
from surefoot.sim.common.errors import check_seed
from surefoot.sim.common.files import refuse_full, whole_file
from surefoot.sim.common.sources import sources_digest
from surefoot.sim.effects import Effect, declared_effects, effect
from surefoot.sim.effects.file import load_effects
from surefoot.sim.gait.options import PLAIN_GAIT, GaitOptions
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot
from surefoot.sim.walking.imitation import WalkingStyle, walking_style

RECIPE = "recipe.json"
WORLDS = ("before", "effects", "after")
_MODULE = "surefoot.scenarios.trace.loop"


def loop(
    log: Log,
    robot: Robot,
    out: Path,
    seed: int = 0,
    force: bool = False,
    plan: TrainingPlan = DEFAULT_PLAN,
    declared: Sequence[Effect] | None = None,
    holdout: Sequence[Log] = (),
    page: Path | None = None,
) -> tuple[pd.DataFrame, tuple[Side, ...]]:
    """Close the loop on one log into `out`; a run that was killed goes on where it stopped.

    Returns the table, one row a filter with each metric in each world, and the worlds (one where
    nothing was found to add). Raises LogError where the log lacks IMU, joints or reference,
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
        page: page of results (Markdown) to write as well.
    """
    check_seed(seed)
    log.require("imu", "q", "reference")
    if page:
        check_page(page)
    shown = walking_style(*declared_model(log, robot))
    recipe = {
        "log": contents_digest(log),
        "robot": [robot.name, robot.digest],
        "code": [sources_digest(_MODULE), candidates_code()],
        "seed": seed,
        "gait": asdict(load_as_walked().gait),
        "declared": None if declared is None else [e.as_dict() for e in declared],
        "holdout": [contents_digest(one) for one in holdout],
        "lesson": asdict(plan),
    }
    if force or not _same(out, recipe):
        refuse_full(out, force)
        with whole_file(out / RECIPE, True) as path:
            path.write_text(json.dumps(recipe, indent=2) + "\n", encoding="utf-8")
        for stale in (
            "trace/trace.json",
            "gait.json",
            "measured.json",
            *(f"{w}/done" for w in WORLDS),
        ):
            (out / stale).unlink(missing_ok=True)
    model = (*declared_effects(log), *(declared or ()))
    known = model or declared
    found = _traced(log, robot, out / "trace", seed, known, holdout)
    choice = _gait(log, robot, (*model, *found), out / "gait.json", seed)
    worlds: dict[str, tuple[tuple[Effect, ...], GaitOptions]] = {"before": (model, PLAIN_GAIT)}
    if found and choice.walked:
        worlds["effects"] = (*model, *found), PLAIN_GAIT
    if found or choice.walked:
        worlds["after"] = (*model, *found), choice.gait
    sides = []
    for name, (effects, gait) in worlds.items():
        learnt, simulated = _learnt(shown, log, robot, effects, gait, out / name, seed, plan)
        compared = compare_log(*_modelled(log, robot, effects), learnt)
        sides.append(Side(name, effects, learnt, compared, simulated))
    last = sides[-1].comparison
    assert last.robot is not None
    taught = _from_measured(last.log, last.robot, out / "measured.json", seed, plan)
    return write_loop(log, robot, sides, out, choice, taught, page), tuple(sides)


def inputs_of(log: Log) -> str:
    """What an observer of this log reads: feet by the declared legs, and torques where it has them.

    Legs of the declared model carry over to the robot what a network learns in simulation alone.
    """
    return "tau,feet" if log.has("tau") else "feet"


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


def _gait(log: Log, robot: Robot, effects: Sequence[Effect], kept: Path, seed: int) -> GaitChoice:
    """The gait of the simulated walks, chosen unless that was done.

    Args:
        log: the measured log.
        robot: as declared.
        effects: that the simulated robot has.
        kept: file of the choice.
        seed: of the walks that are compared.
    """
    if not kept.exists():
        with percent_bar("gait") as progress:
            choice = choose_gait(log, robot, effects, seed, progress)
        _write(kept, asdict(choice))
    return GaitChoice(**json.loads(kept.read_text(encoding="utf-8")))


def _modelled(log: Log, robot: Robot, effects: Sequence[Effect]) -> tuple[Log, Robot]:
    """The measured log and the robot, the effects compensated, with joint rates to read."""
    told = replace(log, meta=replace(log.meta, effects=tuple(e.as_dict() for e in effects)))
    known, model = declared_model(told, robot)
    return rates_as_of(replace(known, meta=replace(known.meta, effects=())), log), model


def _learnt(
    shown: WalkingStyle,
    log: Log,
    robot: Robot,
    effects: Sequence[Effect],
    gait: GaitOptions,
    out: Path,
    seed: int,
    plan: TrainingPlan,
) -> tuple[Learnt, ErrorParts]:
    """Observers and bounds by the model with the effects, trained unless they are there, and what
    the errors on the walk to calibrate on are made of.

    Args:
        shown: style of the measured walk.
        log: whose inputs the observer has.
        robot: as declared.
        effects: added to the model.
        gait: of the walks.
        out: folder.
        seed: of walks and training.
        plan: how much to walk and train.
    """
    done = out / "done"
    if not done.exists():
        with percent_bar(f"walking: {out.name}") as progress:
            walks = simulate_training(shown, robot, effects, seed, plan, gait, progress)
        training = [rates_as_of(one, log) for one in walks[0]]
        calibration = rates_as_of(walks[1], log)
        learnt = learn(
            training, calibration, out, seed, inputs_of(log), force=True, schedule=plan.schedule
        )
        _write(out / "errors.json", error_parts(learnt.observers[0], calibration).rms)
        done.touch()
    simulated = ErrorParts(json.loads((out / "errors.json").read_text(encoding="utf-8")))
    return learnt_in(out), simulated


def _from_measured(
    log: Log, robot: Robot, kept: Path, seed: int, plan: TrainingPlan
) -> list[float] | str:
    """Errors (3,) [m/s] of observers of halves of the measured walk, or why there are none.

    Args:
        log: the measured log, what was found compensated.
        robot: the same.
        kept: file of the result.
        seed: of the training.
        plan: how much to train.
    """
    if not kept.exists():
        try:
            left = learnt_from_measured(log, robot, inputs_of(log), seed, plan.schedule)
        except ObserverError as error:
            left = str(error)
        _write(kept, left)
    return json.loads(kept.read_text(encoding="utf-8"))


def _write(path: Path, value: object) -> None:
    with whole_file(path, True) as temporary:
        temporary.write_text(json.dumps(value, indent=2) + "\n", encoding="utf-8")


def _same(out: Path, recipe: dict[str, object]) -> bool:
    try:
        return json.loads((out / RECIPE).read_text(encoding="utf-8")) == recipe
    except (OSError, ValueError):
        return False
