"""Scenario files: a course, the ground under it, and what a seed may vary. TOML, schema-checked."""

import tomllib
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from sim.errors import SurefootError
from sim.sensors import Sensors
from sim.terrain import Ground, Patch

T = TypeVar("T")


@dataclass(frozen=True)
class Segment:
    """A stretch of the course at one commanded velocity of the base."""

    duration: float  # s
    forward: float = 0.0  # m/s
    lateral: float = 0.0  # m/s, positive to the left
    turn: float = 0.0  # rad/s, positive to the left


@dataclass(frozen=True)
class Ranges:
    """What a seed draws, uniformly, each a factor or an amount about the file's own value."""

    mu: tuple[float, float] = (1.0, 1.0)  # factor on every friction coefficient
    speed: tuple[float, float] = (1.0, 1.0)  # factor on each segment's velocities
    period: tuple[float, float] = (1.0, 1.0)  # factor on the gait's period
    clearance: tuple[float, float] = (1.0, 1.0)  # factor on the swing foot's height
    patch_shift: float = 0.0  # m, largest shift of a patch along x and y


@dataclass(frozen=True)
class Scenario:
    """A walk to be made: where, how fast, on what ground, with which sensors."""

    name: str
    segments: tuple[Segment, ...]
    ground: Ground
    robot: str | None = None
    ranges: Ranges = field(default_factory=Ranges)
    sensors: Sensors = field(default_factory=Sensors)
    stand: float = 1.0  # s, standing still before the first step
    laps: int = 1

    @classmethod
    def load(cls, path: str | Path) -> "Scenario":
        """Read a scenario file. Raises SurefootError naming the file and the key at fault."""
        path = Path(path)
        try:
            table = tomllib.loads(path.read_text(encoding="utf-8"))
        except OSError as error:
            raise SurefootError(f"scenario {path}: {error.strerror or error}") from None
        except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
            raise SurefootError(f"scenario {path}: not valid TOML: {error}") from None
        try:
            return _scenario(table, path.stem)
        except SurefootError as error:
            raise SurefootError(f"scenario {path}: {error}") from None


def drawn(scenario: Scenario, rng: np.random.Generator) -> tuple[Scenario, dict[str, float]]:
    """The scenario with its ranges drawn from `rng`, and the drawn gait factors by name."""
    r = scenario.ranges
    mu = rng.uniform(*r.mu)
    speeds = rng.uniform(*r.speed, size=len(scenario.segments))
    gait = {"period": rng.uniform(*r.period), "clearance": rng.uniform(*r.clearance)}
    shifts = rng.uniform(-r.patch_shift, r.patch_shift, size=(len(scenario.ground.patches), 2))
    patches = tuple(
        Patch(p.center_x + dx, p.center_y + dy, p.size_x, p.size_y, p.mu * mu)
        for p, (dx, dy) in zip(scenario.ground.patches, shifts, strict=True)
    )
    segments = tuple(
        # Slower stretches last longer, so that the course keeps its shape.
        Segment(s.duration / k, s.forward * k, s.lateral * k, s.turn * k)
        for s, k in zip(scenario.segments, speeds, strict=True)
    )
    ground = Ground(scenario.ground.mu * mu, patches, scenario.ground.half_size)
    return replace(scenario, segments=segments, ground=ground), gait


def _scenario(table: dict[str, Any], stem: str) -> Scenario:
    _only(table, {"name", "robot", "stand", "laps", "segment", "ground", "ranges", "sensors"}, "")
    if not table.get("segment"):
        raise SurefootError("needs at least one [[segment]]")
    ground = dict(table.get("ground", {}))
    patches = ground.pop("patch", [])
    _only(ground, {"mu", "half_size"}, "[ground] ")
    segments = tuple(
        _build(Segment, s, f"[[segment]] {i + 1} ") for i, s in enumerate(table["segment"])
    )
    for i, segment in enumerate(segments):
        if segment.duration <= 0:
            raise SurefootError(
                f"[[segment]] {i + 1} duration must be positive, is {segment.duration}"
            )
    name = table.get("name", stem)
    robot = table.get("robot")
    if not isinstance(name, str) or not (robot is None or isinstance(robot, str)):
        raise SurefootError("name and robot must be strings")
    built = Ground(
        _number(ground.get("mu", 0.8), "[ground] mu"),
        tuple(_patch(p, f"[[ground.patch]] {i + 1} ") for i, p in enumerate(patches)),
        _number(ground.get("half_size", 100.0), "[ground] half_size"),
    )
    for mu in (built.mu, *(p.mu for p in built.patches)):
        if not 0.01 <= mu <= 3.0:
            raise SurefootError(f"mu must lie between 0.01 and 3, is {mu}")
    laps = table.get("laps", 1)
    if not isinstance(laps, int) or laps < 1:
        raise SurefootError(f"laps must be a whole number from 1, is {laps!r}")
    return Scenario(
        name=name,
        segments=segments,
        ground=built,
        robot=robot,
        ranges=_build(Ranges, table.get("ranges", {}), "[ranges] "),
        sensors=_build(Sensors, table.get("sensors", {}), "[sensors] "),
        stand=_number(table.get("stand", 1.0), "stand"),
        laps=laps,
    )


def _patch(table: dict[str, Any], where: str) -> Patch:
    _only(table, {"center", "size", "mu"}, where)
    for key in ("center", "size"):
        if key not in table or len(table[key]) != 2:
            raise SurefootError(f"{where}{key} must be two numbers [x, y] in metres")
    if "mu" not in table:
        raise SurefootError(f"{where}needs mu")
    x, y = (_number(v, where + "center") for v in table["center"])
    w, h = (_number(v, where + "size") for v in table["size"])
    if w <= 0 or h <= 0:
        raise SurefootError(f"{where}size must be positive")
    return Patch(x, y, w, h, _number(table["mu"], where + "mu"))


def _build(cls: type[T], table: dict[str, Any], where: str) -> T:
    """A frozen dataclass of numbers and (low, high) pairs from a TOML table."""
    known = {f.name: f for f in fields(cls)}  # type: ignore[arg-type]
    _only(table, set(known), where)
    values: dict[str, Any] = {}
    for key, value in table.items():
        if isinstance(value, list):
            pair = tuple(_number(v, where + key) for v in value)
            if len(pair) != 2 or pair[0] > pair[1]:
                raise SurefootError(f"{where}{key} must be [low, high]")
            values[key] = pair
        else:
            values[key] = _number(value, where + key)
    try:
        return cls(**values)
    except TypeError as error:
        missing = str(error).split("argument")[-1].lstrip("s: ")
        raise SurefootError(f"{where}needs {missing}") from None


def _only(table: dict[str, Any], allowed: set[str], where: str) -> None:
    unknown = sorted(set(table) - allowed)
    if unknown:
        raise SurefootError(
            f"{where}unknown key '{unknown[0]}'; known: {', '.join(sorted(allowed))}"
        )


def _number(value: Any, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise SurefootError(f"{where} must be a number, is {value!r}")
    return float(value)
