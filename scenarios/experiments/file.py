"""Experiment files: a grid over scenarios, robots, conditions, gamma, filters and seeds. TOML."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any
from zlib import crc32

from surefoot.models.observer.observer import check_inputs, check_loss, check_model
from surefoot.models.observer.training import DEFAULT
from surefoot.models.registry import CALIBRATORS
from surefoot.scenarios.estimate.registry import ESTIMATORS
from surefoot.scenarios.experiments.imperfections import Imperfection, load_imperfections
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.files import bundled
from surefoot.sim.common.toml import read_toml
from surefoot.sim.effects import Effect
from surefoot.sim.effects.file import load_effects
from surefoot.sim.scenario import ROLES, Scenario
from surefoot.sim.scenario_catalog import scenario_file
from surefoot.sim.sensors.streams import Sensors
from surefoot.sim.walking.batch import Job, known_robot

SUITES_FOLDER = bundled("surefoot.scenarios.experiments", "suites")
SUITES = ("spot", "vision60")
KEYS = (
    "title", "scenarios", "robots", "seeds", "gammas", "filters", "published", "roles", "observer",
    "sweep", "condition",
)  # fmt: skip


@dataclass(frozen=True)
class Learning:
    """How the observers are trained and bounded: one of each loss for each robot, condition, seed.

    model is one of surefoot.models.observer.architectures, method (of calibration) one of
    surefoot.models.calibration.regions.
    """

    losses: tuple[str, ...] = ("mse", "gml")
    inputs: str = "q,dq,tau"
    steps: int = DEFAULT.steps
    model: str = "gru"
    method: str = "conformal"


@dataclass(frozen=True)
class Condition:
    """What the walks are made under besides their scenario, and what no filter is told of.

    effects: of every robot; imperfections: drawn by each seed, which stands for one robot.
    sensors: names of `sim.sensors.streams.Sensors` and what they are instead of the scenario's.
    """

    name: str
    words: str = ""
    effects: tuple[Effect, ...] = ()
    declared: bool = False
    imperfections: tuple[Imperfection, ...] = ()
    sensors: tuple[tuple[str, float], ...] = ()

    def effects_of(self, seed: int) -> tuple[Effect, ...]:
        """All that robot number `seed` has."""
        drawn = [one for part in self.imperfections for one in part.drawn(seed)]
        return (*self.effects, *drawn)


PLAIN = Condition("plain", "the scenarios as they are written")


@dataclass(frozen=True)
class Sweep:
    """Further gammas, for the filters that use bounds, on some of the seeds."""

    gammas: tuple[float, ...] = ()
    seeds: tuple[int, ...] = ()


@dataclass(frozen=True)
class Experiment:
    """A grid, and what to learn from it. The first of `gammas` is the one that tables show first.

    scenarios carry their roles: observers learn from those to train on, bounds from the one to
    calibrate with, and averages are over those to test on. robots None: each scenario's own.
    """

    title: str
    scenarios: tuple[Scenario, ...]
    robots: tuple[str, ...] | None = None
    seeds: tuple[int, ...] = (0,)
    gammas: tuple[float, ...] = (0.8,)
    filters: tuple[str, ...] = field(default_factory=lambda: tuple(ESTIMATORS))
    published: str | None = None
    learning: Learning = field(default_factory=Learning)
    sweep: Sweep = field(default_factory=Sweep)
    conditions: tuple[Condition, ...] = (PLAIN,)

    @classmethod
    def load(cls, name_or_path: str | Path) -> "Experiment":
        """Read an experiment file, or the bundled suite "spot" or "vision60".

        Raises SurefootError naming the file and the key at fault.
        """
        path = Path(name_or_path)
        if str(name_or_path) in SUITES:
            path = SUITES_FOLDER / f"{name_or_path}.toml"
        table = read_toml(path, "experiment")
        try:
            return _experiment(table, path)
        except SurefootError as error:
            raise SurefootError(f"experiment {path}: {error}") from None

    def with_seeds(self, seeds: tuple[int, ...]) -> "Experiment":
        """The same with other seeds; the sweep keeps those of its own that are among them."""
        kept = tuple(s for s in self.sweep.seeds if s in seeds) or seeds[:1]
        return replace(self, seeds=seeds, sweep=replace(self.sweep, seeds=kept))

    def robots_of(self, scenario: Scenario) -> tuple[str, ...]:
        """Names of the robots that walk it."""
        return self.robots or ((scenario.robot,) if scenario.robot else ())

    def with_role(self, role: str, robot: str) -> tuple[Scenario, ...]:
        """The scenarios of that role that this robot walks."""
        return tuple(
            s for s in self.scenarios if (s.role or "test") == role and robot in self.robots_of(s)
        )


def walk_seed(scenario: Scenario, seed: int) -> int:
    """Another seed a sequence: the same robot, switched on anew, on ground laid anew."""
    return crc32(f"{scenario.name}/{seed}".encode())


def walk_to_make(scenario: Scenario, robot: str, condition: Condition, seed: int) -> Job:
    """The walk of a scenario by robot number `seed` under a condition."""
    sensed = replace(scenario, sensors=replace(scenario.sensors, **dict(condition.sensors)))
    return Job(
        sensed, robot, walk_seed(scenario, seed), condition.effects_of(seed), condition.declared
    )


def _experiment(table: Mapping[str, Any], path: Path) -> Experiment:
    _only(table, KEYS, "")
    roles = _table(table, "roles")
    scenarios = tuple(
        _with_role(Scenario.load(scenario_file(name, path.parent)), roles)
        for name in _strings(table, "scenarios")
    )
    names = [scenario.name for scenario in scenarios]
    for name in names:
        if names.count(name) > 1:
            raise SurefootError(f"scenarios: two are named {name}")
    for name in roles:
        if name not in names:
            raise SurefootError(f"[roles] {name}: no scenario has that name")
    robots = _strings(table, "robots") if "robots" in table else None
    for scenario in scenarios:
        if not robots and not scenario.robot:
            raise SurefootError(f"scenario {scenario.name} names no robot: give robots")
        for robot in robots or (str(scenario.robot),):
            known_robot(robot)
    conditions = tuple(_condition(c, path.parent, n) for n, c in enumerate(_tables(table), 1))
    filters = _strings(table, "filters") if "filters" in table else tuple(ESTIMATORS)
    for name in filters:
        if name not in ESTIMATORS:
            raise SurefootError(f"filters: unknown '{name}'; known: {', '.join(ESTIMATORS)}")
    found = Experiment(
        title=_string(table, "title", path.stem),
        scenarios=scenarios,
        robots=robots,
        seeds=_whole(table, "seeds", (0,)),
        gammas=_levels(table, "gammas", (0.8,)),
        filters=filters,
        published=_string(table, "published", None),
        learning=_learning(_table(table, "observer")),
        sweep=_sweep(_table(table, "sweep")),
        conditions=conditions or (PLAIN,),
    )
    _check(found)
    return found


def _check(found: Experiment) -> None:
    for name in (names := [c.name for c in found.conditions]):
        if names.count(name) > 1:
            raise SurefootError(f"two conditions are named {name}")
    if not set(found.sweep.seeds) <= set(found.seeds):
        raise SurefootError("[sweep] seeds must be among seeds")
    for robot in {r for s in found.scenarios for r in found.robots_of(s)}:
        count = len(found.with_role("calibrate", robot))
        if count > 1:
            raise SurefootError(f"{count} scenarios of {robot} are to calibrate with: give one")


def _with_role(scenario: Scenario, roles: Mapping[str, Any]) -> Scenario:
    role = roles.get(scenario.name, scenario.role)
    if role is not None and role not in ROLES:
        raise SurefootError(f"[roles] {scenario.name}: must be one of {', '.join(ROLES)}")
    return replace(scenario, role=role)


def _condition(table: Mapping[str, Any], folder: Path, number: int) -> Condition:
    where = f"[[condition]] {number} "
    keys = ("name", "words", "effects", "declared", "imperfections", "sensors")
    _only(table, keys, where)
    name = _string(table, "name", None)
    if not name:
        raise SurefootError(f"{where}needs name")
    sensors = _table(table, "sensors")
    try:
        Sensors(**sensors)
    except TypeError:
        raise SurefootError(f"{where}sensors: unknown or not a number: {sensors}") from None
    effects, imperfections = table.get("effects"), table.get("imperfections")
    return Condition(
        name=name,
        words=_string(table, "words", "") or "",
        effects=load_effects(folder / str(effects)) if effects else (),
        declared=bool(table.get("declared", False)),
        imperfections=load_imperfections(folder / str(imperfections)) if imperfections else (),
        sensors=tuple(sensors.items()),
    )


def _learning(table: Mapping[str, Any]) -> Learning:
    default = Learning()
    _only(table, tuple(f.name for f in fields(Learning)), "[observer] ")
    losses = _strings(table, "losses") if "losses" in table else default.losses
    for loss in losses:
        check_loss(loss)
    model, inputs, method = (
        _string(table, key, getattr(default, key)) for key in ("model", "inputs", "method")
    )
    check_inputs(inputs)
    check_model(model)
    if method not in CALIBRATORS:
        raise SurefootError(f"[observer] method {method}: choose {' | '.join(CALIBRATORS)}")
    (steps,) = _whole({"steps": [table.get("steps", default.steps)]}, "steps", ())
    return Learning(losses, inputs, steps, model, method)


def _sweep(table: Mapping[str, Any]) -> Sweep:
    _only(table, ("gammas", "seeds"), "[sweep] ")
    if not table:
        return Sweep()
    return Sweep(_levels(table, "gammas", ()), _whole(table, "seeds", (0,)))


def _only(table: Mapping[str, Any], known: tuple[str, ...], where: str) -> None:
    unknown = sorted(set(table) - set(known))
    if unknown:
        raise SurefootError(f"{where}unknown key '{unknown[0]}'; known: {', '.join(known)}")


def _table(table: Mapping[str, Any], key: str) -> dict[str, Any]:
    value = table.get(key, {})
    if not isinstance(value, dict):
        raise SurefootError(f"{key} must be a table, [{key}]")
    return value


def _tables(table: Mapping[str, Any]) -> list[dict[str, Any]]:
    value = table.get("condition", [])
    if not isinstance(value, list) or not all(isinstance(v, dict) for v in value):
        raise SurefootError("condition must be an array of tables, [[condition]]")
    return value


def _string(table: Mapping[str, Any], key: str, default: str | None) -> Any:
    value = table.get(key, default)
    if value is not default and not isinstance(value, str):
        raise SurefootError(f"{key} must be text, is {value!r}")
    return value


def _list(table: Mapping[str, Any], key: str, default: tuple, kind: type, words: str) -> tuple:
    value = table.get(key, list(default))
    good = isinstance(value, list) and all(type(v) is kind for v in value)
    if not good or not value or len(set(value)) < len(value):
        raise SurefootError(f"{key} must be a list of {words}, each once, is {value!r}")
    return tuple(value)


def _strings(table: Mapping[str, Any], key: str) -> tuple[str, ...]:
    return _list(table, key, (), str, "names")


def _whole(table: Mapping[str, Any], key: str, default: tuple[int, ...]) -> tuple[int, ...]:
    values = _list(table, key, default, int, "whole numbers")
    if min(values) < 0:
        raise SurefootError(f"{key} must not be negative, is {min(values)}")
    return values


def _levels(table: Mapping[str, Any], key: str, default: tuple[float, ...]) -> tuple[float, ...]:
    values = _list(table, key, default, float, "numbers between 0 and 1")
    if not all(0.0 < v < 1.0 for v in values):
        raise SurefootError(f"{key} must lie between 0 and 1, is {list(values)}")
    return values
