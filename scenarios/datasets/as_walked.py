"""A robot as it walks: values measured on one robot's walk, scaled to another."""

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from surefoot.sim.common.errors import errors_in
from surefoot.sim.common.files import bundled
from surefoot.sim.common.toml import read_typed, typed
from surefoot.sim.effects import Effect, effect
from surefoot.sim.effects.carry import BodyScale, carried, scale_of
from surefoot.sim.gait.options import MEASURED_GAIT, GaitOptions
from surefoot.sim.ground.terrain import Strip
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario
from surefoot.sim.sensors.streams import Sensors

SHEET = 0.2
"""Friction coefficient below which a patch is a slippery sheet."""
LEVEL_UP_TO = 0.1
"""Slope up to which ground is level."""
BUNDLED = bundled("surefoot.scenarios.experiments", "suites") / "as_walked.toml"


@dataclass(frozen=True)
class Size:
    """One measured effect and the source of its size."""

    effect: str
    target: str
    value: float
    source: str

    def __post_init__(self):
        effect(self.effect, self.target, self.value)


@dataclass(frozen=True)
class AsWalked:
    """Values measured on a walk of a robot.

    Attributes:
        scale: of the robot, by which sizes are carried to others.
        source: of gait and sensors.
        gait: its options, dimensionless except for the noise of the estimate; by default those
            measured of a Go1.
        on_slopes: options that replace those of `gait` on courses with slopes or steps, where
            nothing was measured.
        on_sheets: the same on courses with slippery sheets.
        sensors: fields of `sim.sensors.streams.Sensors` that replace a scenario's.
        size: the measured effects.
    """

    scale: BodyScale
    source: str
    gait: GaitOptions = MEASURED_GAIT
    on_slopes: dict[str, float] = field(default_factory=dict)
    on_sheets: dict[str, float] = field(default_factory=dict)
    sensors: dict[str, float] = field(default_factory=dict)
    size: tuple[Size, ...] = ()

    def __post_init__(self):
        for name in ("sensors", "on_slopes", "on_sheets"):
            with errors_in(name):
                typed(getattr(self, name), Sensors if name == "sensors" else GaitOptions)

    def effects_on(self, robot: Robot) -> tuple[Effect, ...]:
        """The measured effects scaled to `robot` (`sim.effects.carry`)."""
        sizes = [effect(s.effect, s.target, s.value) for s in self.size]
        return carried(sizes, self.scale, scale_of(robot))

    def scenario(self, scenario: Scenario) -> Scenario:
        """The scenario with this gait and these sensors."""
        ground, gait = scenario.ground, self.gait
        if any(patch.mu < SHEET for patch in ground.patches):
            gait = replace(gait, **self.on_sheets)
        if any(_climbs(strip) for strip in ground.strips):
            gait = replace(gait, **self.on_slopes)
        sensors = replace(scenario.sensors, **self.sensors)
        return replace(scenario, gait=gait, sensors=sensors)


def _climbs(strip: Strip) -> bool:
    run = np.hypot(strip.end[0] - strip.start[0], strip.end[1] - strip.start[1])
    return strip.steps > 0 or abs(strip.heights[1] - strip.heights[0]) > LEVEL_UP_TO * run


def load_as_walked(path: str | Path = BUNDLED) -> AsWalked:
    """Read a file of measured walking, by default the bundled one.

    Raises SurefootError, one line with file and key, if bad.
    """
    return read_typed(path, AsWalked, "as walked")
