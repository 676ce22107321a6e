"""Products of an experiment: walks, observers, bounds and estimates, each cached or computed.

A product is stored under a digest of its inputs and of the code that makes it (`scenarios.cache`).
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from surefoot.estimator.core.state import NavState, retract
from surefoot.models.calibration.calibrate import calibrate
from surefoot.models.calibration.settings import CalibrateSettings
from surefoot.models.observer.observer import Observer
from surefoot.models.observer.settings import TrainSettings
from surefoot.models.registry import ARCHITECTURES, CALIBRATORS
from surefoot.scenarios.cache import Product, product, product_key
from surefoot.scenarios.compare import compare_log
from surefoot.scenarios.datasets.kept_walks import kept_walk, standing_walk
from surefoot.scenarios.estimate.contract import Learnt
from surefoot.scenarios.estimate.estimators import estimator_code, estimator_named, traits
from surefoot.scenarios.estimate.inputs import learnt_from
from surefoot.scenarios.estimate.run import declared_model, feet_of, run_filter
from surefoot.scenarios.estimate.settings import FilterSettings, StateSettings, tuned
from surefoot.scenarios.experiments.facts import errors_over_time, estimate_facts
from surefoot.scenarios.experiments.file import Cell, Experiment, Learning, cells_of
from surefoot.scenarios.training.many_walks import ATTEMPTS, DrawnWalks
from surefoot.scenarios.viewer.recording import recording
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.files import json_digest
from surefoot.sim.common.quaternion import quaternion_from_matrix
from surefoot.sim.common.sources import code_digest, sources_digest
from surefoot.sim.effects import known_effects
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot
from surefoot.sim.walking.batch import known_robot

WALKING = "surefoot.sim.walk"
DRAWING = "surefoot.scenarios.training.many_walks"
TRAINING = "surefoot.models.observer.training"
CALIBRATION = "surefoot.models.calibration.calibrate"
ESTIMATION = "surefoot.scenarios.experiments.facts"
RECORDING = "surefoot.scenarios.compare"
"""Modules that make the products."""


Logs = Sequence[tuple[str, Product]]
"""Names and walks."""


@dataclass(frozen=True)
class LearntFiles:
    """Observers by loss, and their bounds by gamma and loss."""

    observers: dict[str, Product]
    bounds: dict[float, dict[str, Product]]

    def load(self, gamma: float) -> Learnt:
        """Observers, and the bounds of one gamma."""
        bounds = self.bounds.get(gamma, {}).values()
        return learnt_from([one.path for one in self.observers.values()], [b.path for b in bounds])


def make_walk(folder: Path, cell: Cell) -> Product:
    """The log of a cell's walk, with the robot and the names of declared effects as facts too."""
    walk = cell.walk
    declared = sorted({e.name for e in walk.effects}) if walk.declared else []
    made = kept_walk(folder, walk)
    return replace(made, facts=made.facts | {"robot": cell.robot, "declared": declared})


def make_drawn_walk(folder: Path, robot: str, seed: int, role: str, number: int) -> Product | None:
    """The log of a walk drawn to learn from, with facts as in `make_walk`; None if the robot falls
    each time that it is drawn.

    Args:
        folder: of the products.
        robot: name.
        seed: of all walks of the role.
        role: one of `scenarios.training.many_walks.ROLES`.
        number: of the walk in its role.
    """
    draw = DrawnWalks(known_robot(robot), role, seed).walk
    made = standing_walk(folder, draw, ATTEMPTS, number)
    return made and replace(made, facts=made.facts | {"robot": robot, "declared": []})


def walk_inputs(walk: Product) -> list[str]:
    """Inputs that a walk contributes to later products.

    Digests of its log, of the code of its declared effects, which the model compensates, and of the
    robot.
    """
    known = known_effects()
    effects = code_digest(*(known[name] for name in walk.facts["declared"]))
    return [walk.digest, effects, known_robot(walk.facts["robot"]).digest]


def filter_inputs(name: str, robot: Robot) -> dict[str, Any]:
    """Inputs of a filter's estimate besides the log: its code, parameters and IMU mounting."""
    entry = tuned(robot)
    parameters = entry.of(estimator_named(name))
    return {"code": estimator_code(name), "parameters": parameters, "mounting": entry.mounting}


def make_observer(
    folder: Path, logs: Logs, learning: Learning, loss: str, seed: int, held_out: Logs = ()
) -> Product:
    """An observer with that loss, trained on these walks with their declared effects.

    Args:
        folder: of the products.
        logs: names and walks to train on.
        learning: inputs, and network and course of the training.
        loss: "mse" or "gml".
        seed: of weights and windows.
        held_out: names and walks to stop by.
    """
    inputs = {"logs": _seen(logs), "held out": _seen(held_out), "loss": loss, "seed": seed}
    inputs |= learning_choices(learning)

    def make(path: Path) -> dict[str, Any]:
        from surefoot.models.observer.training import train

        walks = (read_walk(walk, name) for name, walk in logs)
        stop_by = [read_walk(walk, name) for name, walk in held_out]
        names = "inputs", "model", "steps", "batch", "width"
        chosen = {name: getattr(learning, name) for name in names}
        settings = TrainSettings(loss=loss, seed=seed, **chosen)
        observer = train(walks, None, settings, partial=state, held_out=stop_by)
        observer.save(path, force=True)
        state.unlink(missing_ok=True)
        return {"rmse": observer.rmse.tolist()}

    # An interrupted training continues from its state.
    state = folder / "observer" / f"{product_key('observer', inputs, TRAINING)}.partial"
    return product(folder, "observer", inputs, TRAINING, ".safetensors", make)


def _seen(logs: Logs) -> list[tuple[str, list[str]]]:
    return [(name, walk_inputs(walk)) for name, walk in logs]


def learning_choices(learning: Learning) -> dict[str, Any]:
    """Inputs of an observer besides its logs; for a plug-in network, including its sources."""
    return {
        "inputs": learning.inputs,
        "steps": [learning.steps, learning.batch],
        "width": learning.width,
        "model": [learning.model, code_digest(ARCHITECTURES[learning.model])],
    }


def make_bounds(folder: Path, observer: Product, logs: Logs, gamma: float, method: str) -> Product:
    """The observer's bounds at joint level gamma, from these walks.

    Args:
        folder: of the products.
        observer: its file.
        logs: names and walks to calibrate on.
        gamma: joint level.
        method: name of the calibration method.
    """
    inputs: dict[str, Any] = {"observer": observer.digest, "logs": _seen(logs)}
    inputs |= {"gamma": gamma, "method": method_inputs(method)}

    def make(path: Path) -> dict[str, Any]:
        bounds = calibrate(
            Observer.load(observer.path),
            (read_walk(walk, name) for name, walk in logs),
            CalibrateSettings(gamma=gamma, method=method),
        )
        bounds.save(path, force=True)
        return {"epsilon": bounds.epsilon.tolist(), "K": bounds.K, "n": bounds.n}

    return product(folder, "bounds", inputs, CALIBRATION, ".bounds", make)


def method_inputs(method: str) -> list[str]:
    """Inputs of bounds besides observer, log and level: the method's name and code."""
    return [method, code_digest(CALIBRATORS[method])]


def read_walk(walk: Product, name: str) -> Log:
    """A walk's log, named `name`, with its declared effects compensated."""
    log = replace(Log.read(walk.path), name=name)
    return declared_model(log, known_robot(walk.facts["robot"]))[0]


def drawn_start(log: Log, robot: Robot, rng: np.random.Generator) -> FilterSettings:
    """Settings for a first state off by an error drawn from its own covariance.

    Started from the truth, attitude and velocity look consistent whatever a filter does. The gyro's
    bias is left as it is: estimated at rest, it has its own error already.
    """
    state, covariance = FilterSettings().beginning(log, feet_of(log, robot))
    mean = state.pack()
    retract(mean, rng.multivariate_normal(np.zeros(len(covariance)), covariance), 0)
    drawn = NavState.unpack(mean)
    parts = {name: tuple(getattr(drawn, name).tolist()) for name in ("p_GI", "v_GI", "b_a")}
    q_GI = tuple(quaternion_from_matrix(drawn.R_GI[None])[0].tolist())
    return FilterSettings(state=StateSettings(q_GI=q_GI, **parts))


def make_estimates(
    folder: Path,
    walk: Product,
    name: str,
    learnt: LearntFiles,
    filters: Sequence[str],
    gammas: Sequence[float],
) -> tuple[dict[tuple[str, float | None], Product], dict[str, str]]:
    """Run every filter on a walk, those with bounds at every gamma; also returns why any was left
    out.

    A filter without bounds has gamma None and is run once. All start from one `drawn_start`. The
    file of an estimate contains its errors over time, the facts its metrics.

    Args:
        folder: of the products.
        walk: its log.
        name: of the log.
        learnt: files of observers and bounds.
        filters: their names.
        gammas: joint levels of the bounds.
    """
    known = known_robot(walk.facts["robot"])
    log = cache(lambda: replace(Log.read(walk.path), name=name))
    loaded = cache(learnt.load)
    start = cache(lambda: drawn_start(log(), known, np.random.default_rng(int(walk.digest, 16))))
    found: dict[tuple[str, float | None], Product] = {}
    left_out: dict[str, str] = {}
    for filter_name in filters:
        estimator = estimator_named(filter_name)
        needs = estimator.needs.learnt
        for gamma in gammas if "bounds" in needs else gammas[:1]:
            inputs: dict[str, Any] = {"walk": walk_inputs(walk), "filter": filter_name}
            inputs |= filter_inputs(filter_name, known)
            if "observers" in needs:
                inputs["observers"] = sorted(one.digest for one in learnt.observers.values())
            if {"bounds", "persistent"} & set(needs):
                bounds = learnt.bounds.get(gamma, {})
                inputs["bounds"] = sorted(one.digest for one in bounds.values())

            def make(path: Path, filter_name: str = filter_name, gamma: float = gamma) -> dict:
                result = run_filter(filter_name, log(), known, loaded(gamma), start())
                errors_over_time(log(), result.trajectory).to_parquet(path, index=False)
                return estimate_facts(log(), result, loaded(gamma))

            try:
                one = product(folder, "estimate", inputs, ESTIMATION, ".parquet", make)
            except SurefootError as error:
                left_out[filter_name] = str(error).removeprefix(f"filter {filter_name}: ")
                break
            found[filter_name, gamma if "bounds" in needs else None] = one
    return found, left_out


def make_recording(
    folder: Path,
    walk: Product,
    cell: Cell,
    learnt: LearntFiles,
    filters: Sequence[str],
    gamma: float,
) -> Product:
    """A rerun recording of a walk with every filter except the baseline.

    Args:
        folder: of the products.
        walk: its log.
        cell: of the walk.
        learnt: files of observers and bounds.
        filters: their names.
        gamma: joint level of the bounds.
    """
    name, job = cell.scenario.name, cell.walk
    bounds = learnt.bounds.get(gamma, {})
    parts = [*learnt.observers.values(), *bounds.values()]
    inputs = {
        "walk": walk_inputs(walk),
        "recipe": job.inputs,
        "learnt": sorted(one.digest for one in parts),
        "filters": {name: filter_inputs(name, job.robot) for name in filters},
    }

    def make(path: Path) -> dict[str, Any]:
        log, robot = replace(Log.read(walk.path), name=name), job.robot
        drawn = [one for one in filters if traits(one).drawn]
        found = compare_log(log, robot, learnt.load(gamma), drawn, progress=False)
        shown = found.recorded()
        assert shown is not None  # a simulated walk has joints and a reference
        path.write_bytes(recording(shown, name))
        return {}

    return product(folder, "recording", inputs, RECORDING, ".rrd", make)


def cell_inputs(experiment: Experiment, cell: Cell) -> dict[str, Any]:
    """Digest of the inputs of a cell's row, known before anything is computed.

    These are the walk, the walks for its observers and bounds, their training and calibration, and
    the filters. The code that estimates is not among them, as rows are also cached by code.
    """
    mine = [other for other in cells_of(experiment) if other.group == cell.group]
    learnings = experiment.learnings
    parts = {
        "walk": cell.walk.inputs,
        "learnt from": [(o.scenario.role, o.walk.inputs) for o in mine if o.learnt_from],
        "learning": [[asdict(one), learning_choices(one)] for one in learnings],
        "methods": [method_inputs(one.method) for one in learnings],
        "gammas": [experiment.gammas_of(one, cell.seed) for one in learnings],
        "filters": {n: filter_inputs(n, known_robot(cell.robot)) for n in experiment.filters},
        "code": [sources_digest(module) for module in (WALKING, DRAWING, TRAINING, CALIBRATION)],
    }
    return {"digest": json_digest(parts)}
