"""Run an experiment: walks, observers, bounds and estimates, each computed once and then reused.

Every product is stored in a folder that outlives the run: an interrupted run continues where it
stopped, and after a change to the file only what depends on it is recomputed. The tables need only
a small row of each cell, which can be stored apart from the products (`data`), so that the
experiment can continue elsewhere without them.
"""

from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import Any

from msgspec import convert

from surefoot.models.calibration.regions import BoundsError
from surefoot.scenarios.cache import Product, finished_case, read_case
from surefoot.scenarios.estimate.estimators import estimator_named
from surefoot.scenarios.experiments.file import Cell, Experiment, Group, Learning, cells_of
from surefoot.scenarios.experiments.products import (
    ESTIMATION,
    LearntFiles,
    Logs,
    cell_inputs,
    make_bounds,
    make_drawn_walk,
    make_estimates,
    make_observer,
    make_recording,
    make_walk,
)
from surefoot.scenarios.settings import GridSettings
from surefoot.scenarios.stages import processes, stage
from surefoot.scenarios.training.many_walks import held_out_walks

Learnings = dict[Learning, LearntFiles]
"""Observers and bounds of a group of cells, by how they were learnt."""


@dataclass(frozen=True)
class Estimated:
    """A filter's estimate of a walk.

    Attributes:
        filter: name.
        gamma: of the bounds, None without bounds.
        walks: drawn ones on which the observers were trained, None without observers.
        inputs: of the observers, None without observers.
        method: of the bounds, None without bounds.
        facts: metrics, from `surefoot.scenarios.experiments.facts`.
        errors: name of the file with its errors over time.
    """

    filter: str
    gamma: float | None
    walks: int | None
    inputs: str | None
    method: str | None
    facts: dict[str, Any]
    errors: str


@dataclass(frozen=True)
class CellResult:
    """Contents of the tables for a cell.

    Attributes:
        walk: facts of the walk.
        estimates: of the filters.
        left_out: filter -> why it could not run.
    """

    walk: dict[str, Any]
    estimates: tuple[Estimated, ...] = ()
    left_out: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Outcome:
    """Results of an experiment.

    Attributes:
        cells: in the grid's order.
        errors: folder of the errors over time, without those of cells whose rows came from `data`.
        recordings: by title.
    """

    cells: dict[Cell, CellResult]
    errors: Path
    recordings: dict[str, Product]

    @property
    def left_out(self) -> dict[str, str]:
        """Filter -> why it was left out on a walk."""
        reasons: dict[str, dict[str, None]] = {}
        for one in self.cells.values():
            for name, why in one.left_out.items():
                reasons.setdefault(name, {})[why] = None
        return {name: "; ".join(why) for name, why in reasons.items()}


def run(experiment: Experiment, folder: Path, settings: GridSettings) -> Outcome:
    """Compute, or find in `folder`, everything that the experiment needs, seed by seed.

    Cells whose rows are in the settings' `data` are not run. Each stage shows its own bar.
    """
    data = settings.data
    found: dict[Cell, CellResult] = {}
    recorded: dict[str, Product] = {}
    cells = cells_of(experiment)
    with processes(settings.workers) as pool:
        for seed in experiment.seeds:
            mine = [cell for cell in cells if cell.seed == seed]
            rows = {c: read_case(data, *_case(experiment, c), ESTIMATION) for c in mine if data}
            kept = {cell: convert(row, CellResult) for cell, row in rows.items() if row}
            record = not settings.no_recordings and seed == experiment.seeds[0]
            wanted = [cell for cell in mine if record or cell not in kept]
            groups = {cell.group for cell in wanted}
            # Walks from which the observers and bounds of the wanted cells are learnt.
            further = [c for c in mine if c.learnt_from and c.group in groups and c not in wanted]
            tasks = {cell: (make_walk, folder, cell) for cell in wanted + further}
            walks = stage(pool, f"seed {seed}: walks", tasks)
            learnt = _learn(pool, experiment, folder, walks)
            made = {
                cell: (_result, experiment, folder, cell, walks[cell], learnt[cell.group], data)
                for cell in wanted
                if cell not in kept
            }
            found |= kept | stage(pool, f"seed {seed}: estimates", made)
            if record:
                recorded = _record(pool, experiment, folder, walks, learnt)
    return Outcome({cell: found[cell] for cell in cells}, folder / "estimate", recorded)


def _case(experiment: Experiment, cell: Cell) -> tuple[str, dict[str, Any]]:
    """Name of a cell's row, and what determines it."""
    return f"{cell.title(experiment)}_{cell.seed}", cell_inputs(experiment, cell)


def _learn(
    pool: ProcessPoolExecutor | None,
    experiment: Experiment,
    folder: Path,
    walks: dict[Cell, Product],
) -> dict[Group, Learnings]:
    """Train and calibrate for every group that has walks to learn from."""
    label = ", ".join(f"seed {seed}" for seed in {cell.seed for cell in walks})
    groups = list(dict.fromkeys(cell.group for cell in walks))
    drawn = _drawn(pool, experiment, folder, groups, label)

    def logs(group: Group, role: str, count: int) -> Logs:
        """Drawn walks, or without a count those of the scenarios with the role."""
        robot, _, seed = group
        if count:
            every = ((f"{role}_{k}", drawn[robot, seed, role, k]) for k in range(count))
        else:
            mine = [c for c in walks if c.group == group and c.scenario.role == role]
            every = ((c.scenario.name, None if walks[c].facts["falls"] else walks[c]) for c in mine)
        return [(name, walk) for name, walk in every if walk is not None]

    # Tasks by what determines them: groups whose walks are drawn share observers, and learnings
    # that differ only in their calibration do.
    training, observer_of = {}, {}
    for group, one in product(groups, experiment.learnings):
        robot, condition, seed = group
        seen, held_out = logs(group, "train", one.walks), held_out_walks(one.walks)
        stop_by = logs(group, "held_out", held_out) if one.walks else []
        for loss in one.losses if seen else ():
            how = replace(one, method=Learning.method, calibration_walks=0)
            key = robot, "" if one.walks else condition, seed, how, loss
            training[key] = make_observer, folder, seen, one, loss, seed, stop_by
            observer_of[group, one, loss] = key
    observers = stage(pool, f"{label}: observers", training)
    calibrating, bounds_of = {}, {}
    for (group, one, loss), trained in observer_of.items():
        unseen = logs(group, "calibrate", one.calibration_walks)
        for gamma in experiment.gammas_of(one, group[2]) if unseen else ():
            source = "" if one.calibration_walks else group[1]
            key = trained, source, one.calibration_walks, one.method, gamma
            how = folder, observers[trained], unseen, gamma, one.method
            calibrating[key] = (_bounds, one == experiment.learning, *how)
            bounds_of[group, one, loss, gamma] = key
    bounds = stage(pool, f"{label}: bounds", calibrating)
    found: dict[Group, Learnings] = {
        group: {one: LearntFiles({}, {}) for one in experiment.learnings} for group in groups
    }
    for (group, one, loss), key in observer_of.items():
        found[group][one].observers[loss] = observers[key]
    for (group, one, loss, gamma), key in bounds_of.items():
        if (made := bounds[key]) is not None:
            found[group][one].bounds.setdefault(gamma, {})[loss] = made
    return found


def _drawn(
    pool: ProcessPoolExecutor | None,
    experiment: Experiment,
    folder: Path,
    groups: Sequence[Group],
    label: str,
) -> dict[tuple[str, int, str, int], Product | None]:
    """Walks drawn to learn from, by robot, seed, role and number."""
    walks = max(one.walks for one in experiment.learnings)
    counts = {"train": walks, "held_out": held_out_walks(walks) if walks else 0}
    counts["calibrate"] = max(one.calibration_walks for one in experiment.learnings)
    tasks = {
        (robot, seed, role, number): (make_drawn_walk, folder, robot, seed, role, number)
        for robot, seed in {(robot, seed): None for robot, _, seed in groups}
        for role, count in counts.items()
        for number in range(count)
    }
    return stage(pool, f"{label}: walks to learn from", tasks)


def _bounds(required: bool, *arguments: Any) -> Product | None:
    """`make_bounds`; if the walk is too short, None unless the bounds are required."""
    try:
        return make_bounds(*arguments)
    except BoundsError:
        if required:
            raise
        return None


def _result(
    experiment: Experiment,
    folder: Path,
    cell: Cell,
    walk: Product,
    learnt: Learnings,
    data: Path | None,
) -> CellResult:
    """Run every filter on a walk, with everything that was learnt, or find it in `folder`; a walk
    that fell has no estimates.

    Args:
        experiment: filters and levels.
        folder: of the products.
        cell: of the walk.
        walk: its log.
        learnt: files of observers and bounds.
        data: folder in which the result is stored as a row, or None.
    """
    if data:

        def make() -> dict[str, Any]:
            return asdict(_result(experiment, folder, cell, walk, learnt, None))

        row = finished_case(data, *_case(experiment, cell), ESTIMATION, make)
        return convert(row, CellResult)
    found, left_out = [], {}
    for learning, files in {} if walk.facts["falls"] else learnt.items():
        products, why = make_estimates(
            folder,
            walk,
            cell.scenario.name,
            files,
            experiment.filters_of(learning),
            experiment.gammas_of(learning, cell.seed),
        )
        further = learning != experiment.learning
        if further and not files.bounds:
            why = dict.fromkeys(why, "the walk to calibrate with is too short for this method")
        for (name, gamma), one in products.items():
            learns = bool(estimator_named(name).needs.learnt)
            walks, inputs = (learning.walks, learning.inputs) if learns else (None, None)
            method = None if gamma is None else learning.method
            found.append(Estimated(name, gamma, walks, inputs, method, one.facts, one.path.name))
        way = f", {learning.words}" if further else ""
        left_out |= {name + way: text for name, text in why.items()}
    return CellResult(walk.facts, tuple(found), left_out)


def _record(
    pool: ProcessPoolExecutor | None,
    experiment: Experiment,
    folder: Path,
    walks: dict[Cell, Product],
    learnt: dict[Group, Learnings],
) -> dict[str, Product]:
    """Recordings of the walks of a seed, by title.

    Args:
        pool: of processes, or None for this one.
        experiment: filters and levels.
        folder: of the products.
        walks: log of each cell.
        learnt: files of observers and bounds of each group of cells.
    """
    tasks, filters, gamma = {}, experiment.filters, experiment.gammas[0]
    for cell, walk in walks.items():
        if not walk.facts["falls"]:
            files = learnt[cell.group][experiment.learning]
            task = (make_recording, folder, walk, cell, files, filters, gamma)
            tasks[cell.title(experiment)] = task
    return stage(pool, "recordings", tasks)
