"""Runs an experiment: walks, observers, bounds and estimates, each made once and then found again.

Every piece is a product in a folder that outlives the run: a run that was killed goes on where it
stopped, and one whose file changed makes only what the change decides.
"""

from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from surefoot.scenarios.cache import Product
from surefoot.scenarios.experiments.file import Condition, Experiment, walk_to_make
from surefoot.scenarios.experiments.products import (
    LearntFiles,
    make_bounds,
    make_estimates,
    make_observer,
    make_recording,
    make_walk,
)
from surefoot.scenarios.stages import processes, stage
from surefoot.sim.scenario import Scenario
from surefoot.sim.walking.batch import Job


@dataclass(frozen=True)
class Cell:
    """One walk of the grid: robot number `seed` under a condition on a scenario."""

    scenario: Scenario
    robot: str
    condition: Condition
    seed: int

    @property
    def group(self) -> tuple[str, str, int]:
        """What shares observers and bounds: a robot, a condition and a seed."""
        return self.robot, self.condition.name, self.seed

    def title(self, experiment: Experiment) -> str:
        """The sequence's name, and whatever else the experiment has more than one of."""
        parts = [self.scenario.name]
        if len(experiment.robots_of(self.scenario)) > 1:
            parts.append(self.robot)
        if len(experiment.conditions) > 1:
            parts.append(self.condition.name.replace(" ", "_"))
        return "_".join(parts)


@dataclass(frozen=True)
class Estimated:
    """One row of the grid: a filter at a gamma on a walk. gamma None: it uses no bounds."""

    cell: Cell
    filter: str
    gamma: float | None
    product: Product


@dataclass(frozen=True)
class Outcome:
    """All that an experiment made: walks, what was learnt, estimates, and what was left out."""

    walks: dict[Cell, Product]
    learnt: dict[tuple[str, str, int], LearntFiles]
    estimates: list[Estimated]
    left_out: dict[str, str]
    recordings: dict[str, Product]


def run(
    experiment: Experiment, folder: Path, workers: int = 1, recordings: bool = False
) -> Outcome:
    """Make, or find in `folder`, everything that the experiment asks for.

    workers: processes at once; each stage shows its own bar. recordings: also one of each sequence
    under each condition, of the first seed.
    """
    cells = [
        Cell(scenario, robot, condition, seed)
        for condition in experiment.conditions
        for seed in experiment.seeds
        for scenario in experiment.scenarios
        for robot in experiment.robots_of(scenario)
    ]
    with processes(workers) as pool:
        tasks = {cell: (make_walk, folder, _job(cell)) for cell in cells}
        walks = stage(pool, "walks", tasks)
        learnt = _learn(pool, experiment, folder, walks)
        estimates, left_out = _estimate(pool, experiment, folder, walks, learnt)
        recorded = _record(pool, experiment, folder, walks, learnt) if recordings else {}
    return Outcome(walks, learnt, estimates, left_out, recorded)


def _job(cell: Cell) -> Job:
    return walk_to_make(cell.scenario, cell.robot, cell.condition, cell.seed)


def _learn(
    pool: ProcessPoolExecutor | None,
    experiment: Experiment,
    folder: Path,
    walks: dict[Cell, Product],
) -> dict[tuple[str, str, int], LearntFiles]:
    """Observers and bounds of every group that has walks to learn from."""
    by_role: dict[str, dict[tuple, list[tuple[str, Product]]]] = {"train": {}, "calibrate": {}}
    for cell, walk in walks.items():
        if cell.scenario.role in by_role and not walk.facts["falls"]:
            named = by_role[cell.scenario.role].setdefault(cell.group, [])
            named.append((cell.scenario.name, walk))
    learning, held_out = experiment.learning, by_role["calibrate"]
    method = learning.method
    observers = stage(
        pool,
        "observers",
        {
            (group, loss): (make_observer, folder, logs, learning, loss, group[2])
            for group, logs in by_role["train"].items()
            for loss in learning.losses
        },
    )
    bounds = stage(
        pool,
        "bounds",
        {
            (group, gamma, loss): (make_bounds, folder, observer, held_out[group][0], gamma, method)
            for (group, loss), observer in observers.items()
            if group in held_out
            for gamma in _gammas(experiment, group[2])
        },
    )
    found: dict[tuple[str, str, int], LearntFiles] = {}
    for (group, loss), observer in observers.items():
        found.setdefault(group, LearntFiles({}, {})).observers[loss] = observer
    for (group, gamma, loss), one in bounds.items():
        found[group].bounds.setdefault(gamma, {})[loss] = one
    return found


def _gammas(experiment: Experiment, seed: int) -> tuple[float, ...]:
    more = experiment.sweep.gammas if seed in experiment.sweep.seeds else ()
    return tuple(dict.fromkeys((*experiment.gammas, *more)))


def _estimate(
    pool: ProcessPoolExecutor | None,
    experiment: Experiment,
    folder: Path,
    walks: dict[Cell, Product],
    learnt: dict[tuple[str, str, int], LearntFiles],
) -> tuple[list[Estimated], dict[str, str]]:
    """Estimates of all walks that did not fall, and why any filter was left out.

    Args:
        pool: of processes, or None for this one.
        experiment: filters and levels.
        folder: of the products.
        walks: log of each cell.
        learnt: files of observers and bounds of each group of cells.
    """
    tasks = {}
    for cell, walk in walks.items():
        if not walk.facts["falls"]:
            files = learnt.get(cell.group, LearntFiles({}, {}))
            gammas = _gammas(experiment, cell.seed)
            what = (cell.scenario.name, cell.robot, files, experiment.filters, gammas)
            tasks[cell] = (make_estimates, folder, walk, *what)
    found, left_out = [], {}
    for cell, (products, why) in stage(pool, "estimates", tasks).items():
        found += [Estimated(cell, name, gamma, one) for (name, gamma), one in products.items()]
        left_out |= why
    return found, left_out


def _record(
    pool: ProcessPoolExecutor | None,
    experiment: Experiment,
    folder: Path,
    walks: dict[Cell, Product],
    learnt: dict[tuple[str, str, int], LearntFiles],
) -> dict[str, Product]:
    """Recordings of the first seed's walks, by title.

    Args:
        pool: of processes, or None for this one.
        experiment: filters and levels.
        folder: of the products.
        walks: log of each cell.
        learnt: files of observers and bounds of each group of cells.
    """
    tasks = {}
    for cell, walk in walks.items():
        if cell.seed == experiment.seeds[0] and not walk.facts["falls"]:
            files = learnt.get(cell.group, LearntFiles({}, {}))
            what = (_job(cell), files, experiment.filters, experiment.gammas[0])
            tasks[cell.title(experiment)] = (make_recording, folder, walk, *what)
    return stage(pool, "recordings", tasks)
