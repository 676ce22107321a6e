"""Experiment files (TOML): a grid over scenarios, robots, conditions, gamma, filters and seeds."""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec

from surefoot.models.observer.observer import WIDEST, check_inputs, check_network
from surefoot.models.observer.settings import TRAIN_DEFAULT
from surefoot.models.registry import CALIBRATORS, LOSSES
from surefoot.scenarios.datasets.conditions import PLAIN, Condition, ConditionTable
from surefoot.scenarios.datasets.kept_walks import DrawnWalk
from surefoot.scenarios.estimate.estimators import ESTIMATORS, check_filter, estimator_named
from surefoot.scenarios.experiments.catalog import experiment_file
from surefoot.sim.common.errors import SurefootError, check_known, errors_in
from surefoot.sim.common.files import protect
from surefoot.sim.common.limits import check_limit
from surefoot.sim.common.toml import Level, Name, Seed, read_toml, typed
from surefoot.sim.scenario import Scenario
from surefoot.sim.scenario_catalog import scenario_file
from surefoot.sim.walking.batch import known_robot

TrainingSteps = Annotated[int, msgspec.Meta(ge=1, le=10**6)]
LayerWidth = Annotated[int, msgspec.Meta(ge=1, le=WIDEST)]
WalkCount = Annotated[int, msgspec.Meta(ge=0, le=10**4)]


@dataclass(frozen=True)
class Learning:
    """Training and calibration of the observers: one of each loss for each robot and seed.

    Attributes:
        losses: of the observers.
        inputs: of the observers.
        steps: of the training, at most.
        batch: windows in each of them.
        width: units in each layer of the network, by default the architecture's own.
        model: one of surefoot.models.observer.architectures.
        method: of calibration, one of surefoot.models.registry.CALIBRATORS.
        walks: to train on, drawn at random (`scenarios.training.many_walks`); 0 trains on the
            scenarios with role "train", for each condition anew.
        calibration_walks: the same for the bounds, and the role "calibrate".
    """

    losses: tuple[str, ...] = LOSSES
    inputs: str = "q,dq,tau"
    steps: TrainingSteps = TRAIN_DEFAULT.steps
    batch: TrainingSteps = TRAIN_DEFAULT.batch
    width: LayerWidth | None = None
    model: str = "gru"
    method: str = "conformal"
    walks: WalkCount = 0
    calibration_walks: WalkCount = 0

    def __post_init__(self):
        _each_once("losses", self.losses)
        for loss in self.losses:
            check_network(self.model, loss)
        check_inputs(self.inputs)
        check_known("method", self.method, CALIBRATORS)

    @property
    def words(self) -> str:
        """What tells it from another."""
        source = f"{self.walks} drawn walks" if self.walks else "the training walks"
        return f"{self.inputs} from {source}, {self.method}"


LEARNT_BY = ("walks", "inputs", "method")
"""Fields of `Learning` by which tables tell one from another."""


@dataclass(frozen=True)
class Sweep:
    """Further gammas, for the filters that use bounds, on the first seed."""

    gammas: tuple[Level, ...]


@dataclass(frozen=True, kw_only=True)
class Grid:
    """What an experiment has as its file has it.

    Attributes:
        robots: None for each scenario's own.
        seeds: of the robots.
        gammas: joint levels of the bounds; the tables show the first.
        filters: names.
        published: table of the paper's figures to print for comparison.
        further: other ways to learn, at the first gamma only, for the filters that they affect.
        sweep: see `Sweep`.
    """

    robots: tuple[str, ...] | None = None
    seeds: tuple[Seed, ...] = (0,)
    gammas: tuple[Level, ...] = (0.8,)
    filters: tuple[str, ...] = field(default_factory=lambda: tuple(ESTIMATORS))
    published: str | None = None
    further: tuple[Learning, ...] = ()
    sweep: Sweep = Sweep(())


@dataclass(frozen=True)
class Experiment(Grid):
    """A grid of scenarios, robots, conditions and seeds, and the filters that run on it.

    Attributes:
        title: of the report.
        scenarios: observers are trained on the walks with role "train", bounds calibrated on that
            with "calibrate", averages taken over those with "test".
        learning: of the main tables.
        conditions: of the robots.
    """

    title: str
    scenarios: tuple[Scenario, ...]
    learning: Learning = field(default_factory=Learning)
    conditions: tuple[Condition, ...] = (PLAIN,)

    @classmethod
    def load(cls, name_or_path: str | Path) -> "Experiment":
        """Read an experiment file, or the bundled suite "spot" or "vision60".

        Raises SurefootError naming the file and the key at fault.
        """
        path = experiment_file(name_or_path)
        protect(path)
        table = read_toml(path, "experiment")
        with errors_in(f"experiment {path}"):
            return _experiment(typed(table, _File), path)

    @property
    def learnings(self) -> tuple[Learning, ...]:
        """`learning`, which the main tables show, first."""
        return self.learning, *self.further

    @property
    def first(self) -> dict[str, Any]:
        """Gamma and learning that the main tables show."""
        one = self.learning
        return {"gamma": self.gammas[0]} | {name: getattr(one, name) for name in LEARNT_BY}

    def filters_of(self, learning: Learning) -> tuple[str, ...]:
        """The filters to run with a learning: all with the first, else those that it affects.

        Other observers affect every filter that has one; another calibration method only those
        with bounds on velocities.
        """
        if learning == self.learning:
            return self.filters
        known = {name: estimator_named(name) for name in self.filters}
        if replace(learning, method=self.learning.method) == self.learning:
            return tuple(name for name, one in known.items() if hasattr(one, "bounded_by"))
        return tuple(name for name, one in known.items() if one.needs.learnt)

    def gammas_of(self, learning: Learning, seed: int) -> tuple[float, ...]:
        """Levels of the bounds; those of the sweep apply to the first learning only."""
        if learning != self.learning:
            return self.gammas[:1]
        more = self.sweep.gammas if seed == self.seeds[0] else ()
        return tuple(dict.fromkeys((*self.gammas, *more)))

    def robots_of(self, scenario: Scenario) -> tuple[str, ...]:
        """Names of the robots that walk it."""
        return self.robots or ((scenario.robot,) if scenario.robot else ())


Group = tuple[str, str, int]
"""Robot, condition to learn from, and seed; the cells of a group share observers and bounds."""


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
        return self.robot, self.condition.learns or self.condition.name, self.seed

    @property
    def walk(self) -> DrawnWalk:
        """The walk to simulate."""
        return self.condition.walk(self.scenario, known_robot(self.robot), self.seed)

    @property
    def learnt_from(self) -> bool:
        """Whether observers are trained, or bounds calibrated, on this walk."""
        return self.scenario.role in ("train", "calibrate") and not self.condition.learns

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


@dataclass(frozen=True)
class _File(Grid):
    scenarios: tuple[str, ...]
    title: Name | None = None
    roles: dict[str, Literal["train", "calibrate", "test"]] = field(default_factory=dict)
    observer: Learning = field(default_factory=Learning)
    condition: tuple[ConditionTable, ...] = ()

    def __post_init__(self):
        for key in ("scenarios", "seeds", "gammas", "filters", "robots"):
            values = getattr(self, key)
            if values is not None:
                _each_once(key, values)
        for name in self.filters:
            with errors_in("filters"):
                check_filter(name)


def _each_once(key: str, values: Sequence) -> None:
    if not values or len(set(values)) < len(values):
        raise SurefootError(f"{key} must be a list of values, each once, is {list(values)}")


def _experiment(file: _File, path: Path) -> Experiment:
    loaded = [Scenario.load(scenario_file(name, path.parent)) for name in file.scenarios]
    scenarios = tuple(replace(s, role=file.roles.get(s.name, s.role)) for s in loaded)
    names = [scenario.name for scenario in scenarios]
    _each_once("names of scenarios", names)
    with errors_in("[roles]"):
        for name in file.roles:
            check_known("scenario", name, names)
    for scenario in scenarios:
        if not file.robots and not scenario.robot:
            raise SurefootError(f"scenario {scenario.name} names no robot: give robots")
        for robot in file.robots or (str(scenario.robot),):
            known_robot(robot)
    conditions = tuple(c.condition(path.parent) for c in file.condition) or (PLAIN,)
    grid = {one.name: getattr(file, one.name) for one in fields(Grid)}
    found = Experiment(file.title or path.stem, scenarios, file.observer, conditions, **grid)
    _check(found)
    return found


def _check(found: Experiment) -> None:
    walks = sum(len(found.robots_of(s)) for s in found.scenarios)
    walks *= len(found.seeds) * len(found.conditions)
    check_limit("walks", walks * len(found.gammas), "walks times gammas")
    _each_once("names of conditions", [c.name for c in found.conditions])
    own = [one.name for one in found.conditions if not one.learns]
    for one in found.conditions:
        if one.learns:
            with errors_in(f"[[condition]] {one.name}: learns"):
                check_known("condition", one.learns, own)
    with errors_in("[[further]]"):
        ways = [tuple(getattr(one, name) for name in LEARNT_BY) for one in found.learnings]
        _each_once(f"{', '.join(LEARNT_BY)} of it and of [observer]", ways)
