"""Cells of an experiment's grid, one per walk, and the inputs that each depends on."""

import hashlib
import json
from dataclasses import asdict, dataclass
from typing import Any

from surefoot.scenarios.experiments.file import Condition, Experiment, walk_to_make
from surefoot.scenarios.experiments.products import (
    CALIBRATION,
    TRAINING,
    WALKING_MODULE,
    filter_inputs,
    job_inputs,
    learning_choices,
    method_inputs,
)
from surefoot.sim.common.sources import sources_digest
from surefoot.sim.scenario import Scenario
from surefoot.sim.walking.batch import Job, known_robot

Group = tuple[str, str, int]
"""Robot, condition and seed; the cells of a group share observers and bounds."""


@dataclass(frozen=True)
class Cell:
    """One walk of the grid: robot number `seed` under a condition on a scenario."""

    scenario: Scenario
    robot: str
    condition: Condition
    seed: int

    @property
    def group(self) -> Group:
        """Group of cells with the same observers and bounds."""
        return self.robot, self.condition.name, self.seed

    @property
    def job(self) -> Job:
        """The walk to simulate."""
        return walk_to_make(self.scenario, self.robot, self.condition, self.seed)

    @property
    def learnt_from(self) -> bool:
        """Whether observers are trained, or bounds calibrated, on this walk."""
        return self.scenario.role in ("train", "calibrate")

    def title(self, experiment: Experiment) -> str:
        """The sequence's name, with robot and condition where the experiment has several."""
        parts = [self.scenario.name]
        if len(experiment.robots_of(self.scenario)) > 1:
            parts.append(self.robot)
        if len(experiment.conditions) > 1:
            parts.append(self.condition.name.replace(" ", "_"))
        return "_".join(parts)


def cells_of(experiment: Experiment) -> list[Cell]:
    """All cells, by condition and seed."""
    return [
        Cell(scenario, robot, condition, seed)
        for condition in experiment.conditions
        for seed in experiment.seeds
        for scenario in experiment.scenarios
        for robot in experiment.robots_of(scenario)
    ]


def cell_inputs(experiment: Experiment, cell: Cell) -> dict[str, Any]:
    """Digest of the inputs of a cell's row, known before anything is computed.

    These are the walk, the walks for its observers and bounds, their training and calibration, and
    the filters. The code that estimates is not among them, as rows are also cached by code.
    """
    mine = [other for other in cells_of(experiment) if other.group == cell.group]
    learnings = experiment.learnings
    parts = {
        "walk": job_inputs(cell.job),
        "learnt from": [(o.scenario.role, job_inputs(o.job)) for o in mine if o.learnt_from],
        "learning": [[asdict(one), learning_choices(one)] for one in learnings],
        "methods": [method_inputs(one.method) for one in learnings],
        "gammas": [experiment.gammas_of(one, cell.seed) for one in learnings],
        "filters": {n: filter_inputs(n, known_robot(cell.robot)) for n in experiment.filters},
        "code": [sources_digest(module) for module in (WALKING_MODULE, TRAINING, CALIBRATION)],
    }
    text = json.dumps(parts, sort_keys=True)
    return {"digest": hashlib.sha256(text.encode()).hexdigest()}
