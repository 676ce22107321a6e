"""Conditions: how the robots of a set of walks deviate from their model."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from zlib import crc32

from surefoot.scenarios.datasets.as_walked import AsWalked, load_as_walked
from surefoot.scenarios.datasets.imperfections import Imperfection, load_imperfections
from surefoot.scenarios.datasets.kept_walks import DrawnWalk
from surefoot.sim.common.errors import errors_in
from surefoot.sim.common.toml import FileName, read_toml, typed
from surefoot.sim.effects import Effect
from surefoot.sim.effects.file import load_effects
from surefoot.sim.gait.options import GaitOptions
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Ranges, Scenario
from surefoot.sim.sensors.streams import Sensors


@dataclass(frozen=True)
class Condition:
    """How robots deviate from their model on all walks of a grid, beyond the scenarios.

    Attributes:
        name: of the condition.
        words: its description.
        effects: of every robot, known to the filters only if `declared`.
        declared: whether the filters know the effects.
        imperfections: drawn for each seed, which represents one robot.
        sensors: fields of `sim.sensors.streams.Sensors` that replace the scenario's.
        gait: fields of `sim.gait.options.GaitOptions`, likewise.
        ranges: fields of `sim.scenario.Ranges`, likewise.
        walked: gait, sensors and effects measured on a robot's walk, scaled to each robot
            (`sim.effects.carry`).
        learns: name of the condition whose walks observers and bounds are learnt from instead of
            its own, so that it is a shift between training and test.
    """

    name: str
    words: str = ""
    effects: tuple[Effect, ...] = ()
    declared: bool = False
    imperfections: tuple[Imperfection, ...] = ()
    sensors: dict[str, float] = field(default_factory=dict, hash=False)
    gait: dict[str, float | str] = field(default_factory=dict, hash=False)
    ranges: dict[str, float | tuple[float, float]] = field(default_factory=dict, hash=False)
    walked: AsWalked | None = field(default=None, hash=False)
    learns: str | None = None

    def effects_of(self, seed: int, robot: Robot) -> tuple[Effect, ...]:
        """Effects of robot number `seed` of its kind: given, drawn and measured."""
        drawn = [one for part in self.imperfections for one in part.drawn(seed, robot.limbs)]
        walked = self.walked.effects_on(robot) if self.walked else ()
        return (*self.effects, *drawn, *walked)

    def walk(self, scenario: Scenario, robot: Robot, seed: int) -> DrawnWalk:
        """The walk of robot number `seed` of its kind on a scenario, under this condition."""
        if self.walked:
            scenario = self.walked.scenario(scenario)
        parts = {"sensors": self.sensors, "gait": self.gait, "ranges": self.ranges}
        changed = {name: replace(getattr(scenario, name), **x) for name, x in parts.items()}
        scenario = replace(scenario, **changed)
        # A seed for each sequence, so that noise and ground differ between walks of one robot.
        own = crc32(f"{scenario.name}/{seed}".encode())
        return DrawnWalk(scenario, robot, own, self.effects_of(seed, robot), self.declared)


PLAIN = Condition("plain", "the scenarios as they are written")


@dataclass(frozen=True)
class ConditionTable:
    """A `[[condition]]` of an experiment file, which see (`scenarios.experiments.file`)."""

    name: FileName
    words: str = ""
    effects: str | None = None
    declared: bool = False
    imperfections: str | None = None
    sensors: dict[str, float] = field(default_factory=dict)
    gait: dict[str, float | str] = field(default_factory=dict)
    ranges: dict[str, float | tuple[float, float]] = field(default_factory=dict)
    walked: str | None = None
    learns: str | None = None

    def __post_init__(self):
        for name, kind in {"sensors": Sensors, "gait": GaitOptions, "ranges": Ranges}.items():
            with errors_in(name):
                typed(getattr(self, name), kind)

    def condition(self, folder: Path) -> Condition:
        """Load the files that it names, relative to the experiment's folder."""
        effects = load_effects(folder / self.effects) if self.effects else ()
        drawn = load_imperfections(folder / self.imperfections) if self.imperfections else ()
        walked = load_as_walked(folder / self.walked) if self.walked else None
        read = {"effects": effects, "imperfections": drawn, "walked": walked}
        return Condition(**vars(self) | read)


def load_conditions(path: Path) -> tuple[Condition, ...]:
    """The conditions of an experiment file alone."""
    tables = typed(read_toml(path, "experiment")["condition"], tuple[ConditionTable, ...])
    return tuple(one.condition(path.parent) for one in tables)
