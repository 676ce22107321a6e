"""Close the loop: trace a measured log, simulate the effects found, train observers, estimate
again.

Up to three worlds are simulated. In `before` the robot is as declared. In `effects` it also has the
effects that the trace found. In `after` it has them and walks in the measured gait. If the plain
gait is more like the log, `after` has the effects only, and there is no `effects`.

In each world the robot walks in the style of the measured log (`sim.walking.imitation`), or in the
nearest one with which it does not fall. Observers are trained and calibrated on these walks only,
and every filter estimates the measured log with that world's model and observers. Where the robot
falls with any style, and without PyTorch, there are no observers: filters that need none are run.
Sizes that the trace found are drawn from their intervals for each walk
(`scenarios.trace.training_walks`). At last, the observer of the last world is tuned on half of the
measured log, and judged on the other half.
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from surefoot.models.attribution.evidence import candidates_digest
from surefoot.models.observer.observer import ObserverError
from surefoot.models.observer.settings import torch_is_installed
from surefoot.scenarios.cache import contents_digest
from surefoot.scenarios.compare import compare_log
from surefoot.scenarios.datasets.as_walked import load_as_walked
from surefoot.scenarios.estimate.run import Learnt, declared_model
from surefoot.scenarios.reporting.pages import check_page
from surefoot.scenarios.settings import LoopSettings
from surefoot.scenarios.stages import percent_bar
from surefoot.scenarios.trace.loop_report import LoopWorld, write_loop
from surefoot.scenarios.trace.observer_errors import (
    ErrorParts,
    TunedErrors,
    error_parts,
    tuned_on_measured,
)
from surefoot.scenarios.trace.realism import GaitChoice, choose_gait
from surefoot.scenarios.trace.report import summary
from surefoot.scenarios.trace.run import TraceOptions, trace
from surefoot.scenarios.trace.training_walks import (
    DEFAULT_PLAN,
    TrainingWalks,
    WalkedStyle,
    rates_as_of,
    simulate_training,
    style_that_walks,
    with_style_share,
)
from surefoot.sim.common.errors import check_seed
from surefoot.sim.common.files import as_made, kept_json, refuse_full, write_whole
from surefoot.sim.common.sources import sources_digest
from surefoot.sim.effects import Effect, compensate_all, declared_effects, effect
from surefoot.sim.effects.file import load_effects
from surefoot.sim.gait.options import PLAIN_GAIT, GaitOptions
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot
from surefoot.sim.walking.imitation import walking_style

RECIPE = "recipe.json"
WORLDS = ("before", "effects", "after")
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
        settings: where to, and the seed of trace, walks and training.
        declared: effects that belong to the model, beyond those that the log declares; the trace
            then looks for what has changed since (see `trace`).
        holdout: logs of the same machine, on which the effects found are evaluated and nothing is
            fitted.
    """
    out, seed = settings.out, settings.seed
    check_seed(seed)
    log.require("imu", "q", "reference")
    if settings.page:
        check_page(settings.page)
    style = walking_style(*declared_model(log, robot))
    recipe = {
        "log": contents_digest(log),
        "robot": [robot.name, robot.digest],
        "code": [sources_digest(__name__), candidates_digest()],
        "seed": seed,
        "gait": asdict(load_as_walked().gait),
        "declared": None if declared is None else [e.as_dict() for e in declared],
        "holdout": [contents_digest(one) for one in holdout],
        "training": asdict(DEFAULT_PLAN),
    }
    if settings.force or kept_json(out / RECIPE) != recipe:
        refuse_full(out, settings.force)
        _write(out / RECIPE, recipe)
        steps = "trace/trace.json", "gait.json", "style.json", "tuned.json"
        stale = *steps, *(f"{world}/done" for world in WORLDS)
        for name in stale:
            (out / name).unlink(missing_ok=True)
    model = (*declared_effects(log), *(declared or ()))
    options = TraceOptions(seed, model or declared, holdout=holdout)
    found, spread = _traced(log, robot, out / "trace", options)
    trains = torch_is_installed()

    def gait_of_walks() -> dict[str, Any]:
        with percent_bar("gait") as progress:
            return asdict(choose_gait(log, robot, (*model, *found), seed, progress))

    choice = GaitChoice(False, "Without observers to train, none is chosen.", [])
    if trains:
        choice = GaitChoice(**_kept(out / "gait.json", gait_of_walks))
    planned: dict[str, tuple[tuple[Effect, ...], GaitOptions]] = {"before": (model, PLAIN_GAIT)}
    if found and choice.walked:
        planned["effects"] = (*model, *found), PLAIN_GAIT
    if found or choice.walked:
        planned["after"] = (*model, *found), choice.gait
    drawn = {name: TrainingWalks(style, robot, *one, spread) for name, one in planned.items()}

    def style_of_walks() -> dict[str, Any]:
        with percent_bar("walking") as progress:
            return asdict(style_that_walks(drawn, seed, progress=progress))

    walked = WalkedStyle()
    if trains:
        walked = WalkedStyle(**_kept(out / "style.json", style_of_walks))
    if walked.words:
        print(walked.words)
        choice = replace(choice, words=f"{choice.words} {walked.words}")
    worlds = []
    for name, (effects, _) in planned.items():
        learnt, simulated, measured = Learnt(), None, None
        if trains and name not in walked.fallen:
            walks = with_style_share(drawn[name], walked.share)
            learnt, simulated = _learnt(walks, log, out / name, seed)
        comparison = compare_log(*_compensated(log, robot, effects), learnt)
        if learnt.observers:
            measured = error_parts(learnt.observers[0], comparison.log, comparison.robot)
        worlds.append(LoopWorld(name, effects, learnt, comparison, simulated, measured))
    last = worlds[-1].comparison
    assert last.robot is not None
    compensated, corrected = last.log, last.robot

    def tune() -> dict[str, Any] | str:
        learnt = worlds[-1].learnt
        how = replace(DEFAULT_PLAN.training, inputs=inputs_of(compensated), seed=seed)
        try:
            found = learnt.observers[0], learnt.bounds[0]
            return asdict(tuned_on_measured(*found, compensated, corrected, how))
        except ObserverError as error:
            return str(error)

    tuned: TunedErrors | str = "there is none"
    if worlds[-1].learnt.observers:
        kept = _kept(out / "tuned.json", tune)
        tuned = kept if isinstance(kept, str) else TunedErrors(**kept)
    return write_loop(log, robot, worlds, settings, choice, tuned)


def inputs_of(log: Log) -> str:
    """Inputs of an observer for this log: what its feet say and, if available, which stand.

    Leg odometry with the declared model transfers better from simulation to the robot than joint
    angles do.
    """
    return "gyro,contact,feet" if log.has("contact") else "gyro,feet"


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
    return rates_as_of(compensated, log), model


def _learnt(walks: TrainingWalks, log: Log, out: Path, seed: int) -> tuple[Learnt, ErrorParts]:
    """Observers and bounds from simulated walks; trained unless already done.

    Also returns the parts of the observer's errors on the simulated walk of the calibration.

    Args:
        walks: to simulate.
        log: the measured log, whose columns determine the observers' inputs.
        out: folder of this world.
        seed: of walks and training.
    """
    from surefoot.scenarios.estimate.learning import learn, learnt_in

    done = out / "done"
    if not (done.exists() and all(map(as_made, out.glob("*.*")))):
        with percent_bar(f"walking: {out.name}") as progress:
            training, calibration = simulate_training(walks, seed, progress=progress)
        training = [rates_as_of(one, log) for one in training]
        calibration = rates_as_of(calibration, log)
        how = replace(DEFAULT_PLAN.training, inputs=inputs_of(log), seed=seed)
        learnt = learn(training, calibration, out, how, force=True)
        _write(out / "errors.json", error_parts(learnt.observers[0], calibration))
        done.touch()
    return learnt_in(out), json.loads((out / "errors.json").read_text(encoding="utf-8"))


def _kept(path: Path, make: Callable[[], object]) -> Any:
    """The content of a JSON file; made and written unless already done."""
    if not as_made(path):
        _write(path, make())
    return json.loads(path.read_text(encoding="utf-8"))


def _write(path: Path, value: object) -> None:
    write_whole(path, json.dumps(value, indent=2) + "\n", force=True)
