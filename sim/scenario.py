"""Scenario files: a course, the ground, and what a seed varies; TOML as typed data."""

from collections.abc import Iterator
from dataclasses import dataclass, field, fields, replace
from itertools import chain
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import msgspec
import numpy as np

from surefoot.sim.common.errors import SurefootError, errors_in
from surefoot.sim.common.files import protect
from surefoot.sim.common.limits import check_limit
from surefoot.sim.common.toml import Count, FileName, Name, NonNegative, read_typed
from surefoot.sim.gait.course import Segment
from surefoot.sim.gait.options import GaitOptions
from surefoot.sim.ground.ground_from_file import GroundFile, ground_from_file
from surefoot.sim.ground.terrain import (
    Friction,
    Ground,
    Layer,
    Length,
    Patch,
    Strip,
    rectangles_overlap,
)
from surefoot.sim.scenario_catalog import scenario_file
from surefoot.sim.sensors.streams import Sensors

Role = Literal["train", "calibrate", "test"]
Factor = Annotated[float, msgspec.Meta(ge=0.01, le=100.0)]
Speed = Annotated[float, msgspec.Meta(ge=-20.0, le=20.0)]
"""[m/s or rad/s]; the limit is twice the speed of any legged robot."""
SHORTEST_SEGMENT = 0.004
"""Shortest segment [s]: a tick of the controller."""


@dataclass(frozen=True)
class Ranges:
    """Ranges from which a seed draws uniformly, each a factor on, or an offset from, the file's own
    value.

    The bumps of rough strips are always drawn. Without ranges, walks of different seeds differ in
    these bumps and in sensor noise only.
    """

    mu: tuple[Factor, Factor] = (1.0, 1.0)  # factor on every friction coefficient
    speed: tuple[Factor, Factor] = (1.0, 1.0)  # factor on each segment's velocities
    period: tuple[Factor, Factor] = (1.0, 1.0)  # factor on the gait's period
    clearance: tuple[Factor, Factor] = (1.0, 1.0)  # factor on the swing foot's height
    patch_shift: Annotated[float, msgspec.Meta(ge=0.0, le=1e3)] = 0.0  # m, of a patch along x and y
    rough: tuple[NonNegative, NonNegative] = (1.0, 1.0)  # factor on the height of bumps
    gain: tuple[Factor, Factor] = (1.0, 1.0)  # factor on the controller's course and level gains
    payload: tuple[float, float] = (0.0, 0.0)  # kg on the base that the controller ignores

    def __post_init__(self):
        for name in (one.name for one in fields(self) if isinstance(one.default, tuple)):
            low, high = getattr(self, name)
            if low > high:
                raise SurefootError(f"{name} must be [low, high], is [{low:g}, {high:g}]")
        if max(map(abs, self.payload)) > 1e3 or self.rough[1] > 100.0:
            raise SurefootError("payload must lie within 1000 kg, rough within 100")


@dataclass(frozen=True)
class Scenario:
    """A walk to simulate: course, speed, ground and sensors."""

    name: str
    segments: tuple[Segment, ...]
    ground: Ground
    robot: str | None = None
    role: Role | None = None
    ranges: Ranges = field(default_factory=Ranges)
    sensors: Sensors = field(default_factory=Sensors)
    gait: GaitOptions = field(default_factory=GaitOptions)
    stand: float = 1.0  # s, standing still before the first step
    laps: int = 1

    @classmethod
    def load(cls, name_or_path: str | Path) -> "Scenario":
        """Read a bundled scenario such as "demo/walk", or a file.

        Raises SurefootError naming the file and the key at fault.
        """
        path = scenario_file(name_or_path)
        protect(path)
        file = read_typed(path, _File, "scenario")
        with errors_in(f"scenario {path}"):
            ground = file.ground.ground(path.resolve().parent)
        segments = tuple(chain.from_iterable(entry.segments() for entry in file.segment))
        name = path.stem if file.name is None else file.name
        changed = ("name", "segment", "ground")
        same: dict[str, Any] = {key: one for key, one in vars(file).items() if key not in changed}
        return cls(name, segments, ground, **same)


@dataclass(frozen=True)
class DrawnScenario:
    """A scenario with the random draws of a seed."""

    scenario: Scenario
    period: float  # factors on the gait's numbers
    clearance: float
    gain: float
    payload: float  # kg


def drawn(scenario: Scenario, rng: np.random.Generator) -> DrawnScenario:
    """Draw a scenario's ranges, and the bumps of its rough strips, from `rng`."""
    r = scenario.ranges
    ground = scenario.ground.with_friction(rng.uniform(*r.mu))
    speeds = rng.uniform(*r.speed, size=len(scenario.segments))
    period, clearance = rng.uniform(*r.period), rng.uniform(*r.clearance)
    shifts = rng.uniform(-r.patch_shift, r.patch_shift, size=(len(ground.patches), 2))
    gain, payload = rng.uniform(*r.gain), rng.uniform(*r.payload)
    rough = rng.uniform(*r.rough)
    patches = tuple(
        replace(p, center_x=p.center_x + dx, center_y=p.center_y + dy)
        for p, (dx, dy) in zip(ground.patches, shifts, strict=True)
    )
    # A height field is divided along its lattice, and the true friction with it.
    for layer in (*[s for s in ground.strips if s.rough][:1], *ground.fields):
        patches = tuple(p.snapped(layer) if _on(p, layer) else p for p in patches)
    strips = tuple(replace(s, rough=s.rough * rough).roughened(rng) for s in ground.strips)
    segments = tuple(
        # Slower stretches last longer, so that the course keeps its shape.
        Segment(s.duration / k, s.forward * k, s.lateral * k, s.turn * k)
        for s, k in zip(scenario.segments, speeds, strict=True)
    )
    ground = replace(ground, patches=patches, strips=strips)
    as_walked = replace(scenario, segments=segments, ground=ground)
    return DrawnScenario(as_walked, period, clearance, gain, payload)


def _on(patch: Patch, layer: Layer) -> bool:
    """Whether a patch overlaps a layer of heights; always for rough strips, which share a
    lattice.
    """
    return isinstance(layer, Strip) or rectangles_overlap(patch.rectangle, layer.rectangle)


@dataclass(frozen=True)
class _SegmentEntry:
    """A segment in a file, by time, length or angle; or `repeat` repetitions of other segments."""

    duration: Length | None = None  # s
    distance: Length | None = None  # m
    angle: Length | None = None  # rad
    forward: Speed = 0.0  # m/s
    lateral: Speed = 0.0  # m/s, positive to the left
    turn: Speed = 0.0  # rad/s, positive to the left
    repeat: Count | None = None  # rounds of the segments below it
    segment: tuple["_SegmentEntry", ...] = ()  # what is repeated, [[segment.segment]]

    OTHER_WORDS: ClassVar = {
        **dict.fromkeys(("speed", "velocity", "vx", "v"), "forward"),
        **dict.fromkeys(("sideways", "vy"), "lateral"),
        **dict.fromkeys(("yaw", "yaw_rate", "omega", "wz"), "turn"),
        **dict.fromkeys(("time", "seconds"), "duration"),
    }

    def __post_init__(self):
        lasts = [self.duration, self.distance, self.angle]
        moves = [*lasts, self.forward, self.lateral, self.turn]
        if self.repeat is not None or self.segment:
            if self.repeat is None or not self.segment or any(moves):
                raise SurefootError("repeat goes with segment, and with nothing else")
        elif sum(one is not None for one in lasts) != 1:
            raise SurefootError("needs one of duration [s], distance [m] or angle [rad]")
        elif self.distance and not (self.forward or self.lateral):
            raise SurefootError("distance needs a speed other than zero")
        elif self.angle and not self.turn:
            raise SurefootError("angle needs a speed other than zero")
        check_limit("items", self.count, "repeat makes too many segments")

    @property
    def count(self) -> int:
        """Number of segments, repetitions included."""
        return (self.repeat or 0) * sum(one.count for one in self.segment) or 1

    def segments(self) -> Iterator[Segment]:
        if self.repeat is not None:
            yield from [one for entry in self.segment for one in entry.segments()] * self.repeat
            return
        if self.distance is not None:
            duration = self.distance / np.hypot(self.forward, self.lateral)
        elif self.angle is not None:
            duration = self.angle / abs(self.turn)
        else:
            duration = self.duration
        assert duration is not None
        if duration < SHORTEST_SEGMENT:
            raise SurefootError(f"segment: {duration:g} s is less than {SHORTEST_SEGMENT:g} s")
        yield Segment(duration, self.forward, self.lateral, self.turn)


@dataclass(frozen=True)
class _PatchEntry:
    """A rectangle of different friction."""

    center: tuple[float, float]  # m
    size: tuple[Length, Length]  # m, along x and y
    mu: Friction  # friction coefficient


@dataclass(frozen=True)
class _StripEntry(Strip):
    """A straight section of ground: level, a ramp, stairs, or rough."""

    mu: Friction | None = None  # friction coefficient; the ground's where left out


@dataclass(frozen=True)
class _GroundTable:
    """The floor."""

    mu: Friction = 0.8  # friction coefficient
    half_size: Length = 100.0  # m, from the centre to the edge of the floor
    patch: tuple[_PatchEntry, ...] = ()  # [[ground.patch]], of another friction
    strip: tuple[_StripEntry, ...] = ()  # [[ground.strip]], of another height
    height_field: tuple[GroundFile, ...] = ()  # [[ground.height_field]], of a file

    OTHER_WORDS: ClassVar = {"friction": "mu", "ramp": "[[ground.strip]]"}

    def __post_init__(self):
        pieces = sum(max(strip.steps, 1) for strip in self.strip) + len(self.height_field) + 1
        check_limit("bodies", pieces * (len(self.patch) + 1), "pieces of ground, cut by patches")
        for patch in self.patch:
            if max(map(abs, patch.center)) > self.half_size:
                raise SurefootError(f"patch: its center {patch.center} lies beyond half_size")

    def ground(self, folder: Path) -> Ground:
        """The ground; its files are relative to the scenario's folder."""
        fields = []
        for k, entry in enumerate(self.height_field, 1):
            try:
                fields.append(ground_from_file(folder, entry))
            except SurefootError as error:
                raise SurefootError(f"[[ground.height_field]] {k} {error}") from None
        return Ground(
            mu=self.mu,
            patches=tuple(Patch(*p.center, *p.size, p.mu) for p in self.patch),
            half_size=self.half_size,
            strips=tuple(Strip(**vars(strip)) for strip in self.strip),
            fields=tuple(fields),
        )


@dataclass(frozen=True)
class _File:
    """Keys at the top of the file."""

    name: FileName | None = None  # the file's own where left out
    robot: Name | None = None  # that walks; another may be given on the command line
    role: Role | None = None  # of the walk, in a suite
    stand: NonNegative = 1.0  # s, standing still before the first step
    laps: Count = 1  # times that the course is walked
    segment: tuple[_SegmentEntry, ...] = ()  # [[segment]], one after another; one at least
    ground: _GroundTable = field(default_factory=_GroundTable)  # [ground]
    ranges: Ranges = field(default_factory=Ranges)  # [ranges], which the seed draws from
    sensors: Sensors = field(default_factory=Sensors)  # [sensors], their errors
    gait: GaitOptions = field(default_factory=GaitOptions)  # [gait]

    OTHER_WORDS: ClassVar = {
        **dict.fromkeys(("friction", "mu"), "[ground] mu"),
        **{name: f"[[ground.{name}]]" for name in ("patch", "strip", "height_field")},
        **dict.fromkeys(("terrain", "floor"), "[ground]"),
    }

    def __post_init__(self):
        if not self.segment:
            raise SurefootError("needs at least one [[segment]]")
        count = self.laps * sum(entry.count for entry in self.segment)
        check_limit("items", count, "laps make too many segments")
        seconds = sum(one.duration for entry in self.segment for one in entry.segments())
        longest = self.stand + self.laps * seconds / self.ranges.speed[0]
        check_limit("walk", longest, "the walk takes too many seconds")
