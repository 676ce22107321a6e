"""A robot as it walks: what was measured of one robot's walk, carried to another by a rule."""

from dataclasses import dataclass, field, replace
from pathlib import Path

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.files import bundled
from surefoot.sim.common.toml import Positive, read_typed, typed
from surefoot.sim.effects import Effect, effect
from surefoot.sim.effects.carry import carried, scale_of
from surefoot.sim.gait.options import GaitOptions
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario
from surefoot.sim.sensors.streams import Sensors

BUNDLED = bundled("surefoot.scenarios.experiments", "suites") / "as_walked.toml"
SHEET = 0.3
"""Friction below which a patch is a slippery sheet."""


@dataclass(frozen=True)
class Size:
    """One measured effect and where its size comes from."""

    effect: str
    target: str
    value: float
    source: str

    def __post_init__(self):
        effect(self.effect, self.target, self.value)


@dataclass(frozen=True)
class AsWalked:
    """What was measured on the walk of `robot`.

    period: of its stride there [s]; gait: options, without dimension but for the noise of the
    estimate; sensors: names of `sim.sensors.streams.Sensors` and what they are; sheets: factor on
    the friction of patches below SHEET; source: of gait, sensors and sheets.
    """

    robot: str
    period: Positive
    source: str
    gait: GaitOptions = field(default_factory=GaitOptions)
    sensors: dict[str, float] = field(default_factory=dict)
    sheets: Positive = 1.0
    size: tuple[Size, ...] = ()

    def __post_init__(self):
        try:
            typed(self.sensors, Sensors)
        except SurefootError as error:
            raise SurefootError(f"sensors: {error}") from None

    def effects_on(self, robot: Robot) -> tuple[Effect, ...]:
        """The measured effects as `robot` would have them."""
        sizes = [effect(s.effect, s.target, s.value) for s in self.size]
        measured = Robot.load(self.robot)
        return carried(sizes, scale_of(measured, self.period), scale_of(robot))

    def scenario(self, scenario: Scenario) -> Scenario:
        """The scenario in this gait, with these sensors, its sheets as slippery as these."""
        ground = scenario.ground
        patches = tuple(
            replace(p, mu=p.mu * self.sheets) if p.mu < SHEET else p for p in ground.patches
        )
        return replace(
            scenario,
            gait=self.gait,
            sensors=replace(scenario.sensors, **self.sensors),
            ground=replace(ground, patches=patches),
        )


def load_as_walked(path: str | Path = BUNDLED) -> AsWalked:
    """The file's robot, gait and sizes.

    Raises SurefootError, one line with file and key, if bad.
    """
    found = read_typed(path, AsWalked, "as walked")
    try:
        Robot.load(found.robot)
    except SurefootError as error:
        raise SurefootError(f"as walked {path}: {error}") from None
    return found
