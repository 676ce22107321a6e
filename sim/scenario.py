"""Scenario files: a course, the ground under it, and what a seed may vary. TOML, schema-checked."""

from collections.abc import Iterator
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.toml import read_toml
from surefoot.sim.ground.terrain import Ground, Patch, Strip
from surefoot.sim.scenario_catalog import scenario_file
from surefoot.sim.sensors.streams import Sensors

T = TypeVar("T")
ROLES = ("train", "calibrate", "test")
KEYS = {"name", "robot", "role", "stand", "laps", "segment", "ground", "ranges", "sensors"}


@dataclass(frozen=True)
class Segment:
    """A stretch of the course at one commanded velocity of the base."""

    duration: float  # s
    forward: float = 0.0  # m/s
    lateral: float = 0.0  # m/s, positive to the left
    turn: float = 0.0  # rad/s, positive to the left


@dataclass(frozen=True)
class Ranges:
    """What a seed draws, uniformly, each a factor or an amount about the file's own value.

    The bumps of rough strips are always drawn.
    """

    mu: tuple[float, float] = (1.0, 1.0)  # factor on every friction coefficient
    speed: tuple[float, float] = (1.0, 1.0)  # factor on each segment's velocities
    period: tuple[float, float] = (1.0, 1.0)  # factor on the gait's period
    clearance: tuple[float, float] = (1.0, 1.0)  # factor on the swing foot's height
    patch_shift: float = 0.0  # m, largest shift of a patch along x and y
    rough: tuple[float, float] = (1.0, 1.0)  # factor on the height of bumps
    gain: tuple[float, float] = (1.0, 1.0)  # factor on the controller's course and level gains
    payload: tuple[float, float] = (0.0, 0.0)  # kg on the base that the controller ignores


@dataclass(frozen=True)
class Scenario:
    """A walk to be made: where, how fast, on what ground, with which sensors."""

    name: str
    segments: tuple[Segment, ...]
    ground: Ground
    robot: str | None = None
    role: str | None = None  # one of ROLES
    ranges: Ranges = field(default_factory=Ranges)
    sensors: Sensors = field(default_factory=Sensors)
    stand: float = 1.0  # s, standing still before the first step
    laps: int = 1

    @classmethod
    def load(cls, name_or_path: str | Path) -> "Scenario":
        """Read a bundled scenario such as "demo/walk", or a file.

        Raises SurefootError naming the file and the key at fault.
        """
        path = scenario_file(name_or_path)
        table = read_toml(path, "scenario")
        try:
            return _scenario(table, path.stem)
        except SurefootError as error:
            raise SurefootError(f"scenario {path}: {error}") from None


@dataclass(frozen=True)
class Drawn:
    """What a seed made of a scenario."""

    scenario: Scenario
    period: float  # factors on the gait's numbers
    clearance: float
    gain: float
    payload: float  # kg


def drawn(scenario: Scenario, rng: np.random.Generator) -> Drawn:
    """The scenario with its ranges, and the bumps of rough strips, drawn from `rng`."""
    r, ground = scenario.ranges, scenario.ground
    mu = rng.uniform(*r.mu)
    speeds = rng.uniform(*r.speed, size=len(scenario.segments))
    period, clearance = rng.uniform(*r.period), rng.uniform(*r.clearance)
    shifts = rng.uniform(-r.patch_shift, r.patch_shift, size=(len(ground.patches), 2))
    gain, payload = rng.uniform(*r.gain), rng.uniform(*r.payload)
    rough = rng.uniform(*r.rough)
    patches = tuple(
        Patch(p.center_x + dx, p.center_y + dy, p.size_x, p.size_y, p.mu * mu)
        for p, (dx, dy) in zip(ground.patches, shifts, strict=True)
    )
    if any(strip.rough for strip in ground.strips):
        # A height field is cut along its lattice: so is the friction that is truth.
        patches = tuple(p.snapped() for p in patches)
    strips = tuple(_drawn_strip(s, mu, rough, rng) for s in ground.strips)
    segments = tuple(
        # Slower stretches last longer, so that the course keeps its shape.
        Segment(s.duration / k, s.forward * k, s.lateral * k, s.turn * k)
        for s, k in zip(scenario.segments, speeds, strict=True)
    )
    return Drawn(
        replace(
            scenario,
            segments=segments,
            ground=Ground(ground.mu * mu, patches, ground.half_size, strips),
        ),
        period,
        clearance,
        gain,
        payload,
    )


def _drawn_strip(strip: Strip, mu: float, rough: float, rng: np.random.Generator) -> Strip:
    own_mu = None if strip.mu is None else strip.mu * mu
    return replace(strip, mu=own_mu, rough=strip.rough * rough).roughened(rng)


def _scenario(table: dict[str, Any], stem: str) -> Scenario:
    _only(table, KEYS, "")
    name, robot, role = table.get("name", stem), table.get("robot"), table.get("role")
    if not isinstance(name, str) or not (robot is None or isinstance(robot, str)):
        raise SurefootError("name and robot must be strings")
    if role is not None and role not in ROLES:
        raise SurefootError(f"role must be one of {', '.join(ROLES)}, is {role!r}")
    laps = table.get("laps", 1)
    if isinstance(laps, bool) or not isinstance(laps, int) or laps < 1:
        raise SurefootError(f"laps must be a whole number from 1, is {laps!r}")
    segments = tuple(_segments(_tables(table, "segment", ""), "[[segment]]"))
    if not segments:
        raise SurefootError("needs at least one [[segment]]")
    return Scenario(
        name=name,
        segments=segments,
        ground=_ground(_table(table, "ground")),
        robot=robot,
        role=role,
        ranges=_build(Ranges, _table(table, "ranges"), "[ranges] "),
        sensors=_build(Sensors, _table(table, "sensors"), "[sensors] "),
        stand=_number(table.get("stand", 1.0), "stand"),
        laps=laps,
    )


def _segments(tables: list[dict[str, Any]], where: str) -> Iterator[Segment]:
    """Segments, where a table with `repeat` and `segment` stands for that many rounds of others."""
    for i, table in enumerate(tables):
        here = f"{where} {i + 1} "
        if "repeat" in table:
            _only(table, {"repeat", "segment"}, here)
            rounds = _number(table["repeat"], here + "repeat")
            if rounds < 1 or rounds != round(rounds):
                raise SurefootError(f"{here}repeat must be a whole number from 1, is {rounds:g}")
            inner = tuple(_segments(_tables(table, "segment", here), here + "segment"))
            yield from inner * round(rounds)
            continue
        values = {k: v for k, v in table.items() if k not in ("distance", "angle")}
        if sum(k in table for k in ("duration", "distance", "angle")) != 1:
            raise SurefootError(f"{here}needs one of duration [s], distance [m] or angle [rad]")
        segment = _build(Segment, {"duration": 1.0, **values}, here)
        for key, speed in (
            ("distance", np.hypot(segment.forward, segment.lateral)),
            ("angle", abs(segment.turn)),
        ):
            if key in table:
                if speed == 0.0:
                    raise SurefootError(f"{here}{key} needs a speed other than zero")
                segment = replace(segment, duration=_number(table[key], here + key) / speed)
        if segment.duration <= 0:
            raise SurefootError(f"{here}must last longer than 0 s, lasts {segment.duration:g}")
        yield segment


def _ground(table: dict[str, Any]) -> Ground:
    _only(table, {"mu", "half_size", "patch", "strip"}, "[ground] ")
    ground = Ground(
        mu=_number(table.get("mu", 0.8), "[ground] mu"),
        patches=tuple(
            _patch(p, f"[[ground.patch]] {i + 1} ")
            for i, p in enumerate(_tables(table, "patch", "[ground] "))
        ),
        half_size=_number(table.get("half_size", 100.0), "[ground] half_size"),
        strips=tuple(
            _strip(s, f"[[ground.strip]] {i + 1} ")
            for i, s in enumerate(_tables(table, "strip", "[ground] "))
        ),
    )
    for mu in (ground.mu, *(part.mu for part in (*ground.patches, *ground.strips))):
        if mu is not None and not 0.01 <= mu <= 3.0:
            raise SurefootError(f"mu must lie between 0.01 and 3, is {mu}")
    if ground.half_size <= 0:
        raise SurefootError(f"[ground] half_size must be positive, is {ground.half_size:g}")
    return ground


def _strip(table: dict[str, Any], where: str) -> Strip:
    _only(table, {f.name for f in fields(Strip)} - {"bumps"}, where)
    values: dict[str, Any] = {}
    for key, value in table.items():
        pair = key in ("start", "end", "heights")
        values[key] = _pair(value, where + key) if pair else _number(value, where + key)
    missing = [key for key in ("start", "end", "width") if key not in values]
    if missing:
        raise SurefootError(f"{where}needs {missing[0]}")
    try:
        return Strip(**{**values, "steps": int(values.get("steps", 0))})
    except SurefootError as error:
        raise SurefootError(f"{where}{error}") from None


def _patch(table: dict[str, Any], where: str) -> Patch:
    _only(table, {"center", "size", "mu"}, where)
    for key in ("center", "size", "mu"):
        if key not in table:
            raise SurefootError(f"{where}needs {key}")
    size = _pair(table["size"], where + "size")
    if min(size) <= 0:
        raise SurefootError(f"{where}size must be positive")
    center = _pair(table["center"], where + "center")
    return Patch(*center, *size, _number(table["mu"], where + "mu"))


def _build(cls: type[T], table: dict[str, Any], where: str) -> T:
    """A frozen dataclass of numbers and (low, high) pairs from a TOML table."""
    pairs = {f.name: isinstance(f.default, tuple) for f in fields(cls)}  # type: ignore[arg-type]
    _only(table, set(pairs), where)
    values: dict[str, Any] = {}
    for key, value in table.items():
        if pairs[key]:
            values[key] = _pair(value, where + key)
            if values[key][0] > values[key][1]:
                raise SurefootError(f"{where}{key} must be [low, high], is {value}")
        else:
            values[key] = _number(value, where + key)
    return cls(**values)


def _table(table: dict[str, Any], key: str) -> dict[str, Any]:
    value = table.get(key, {})
    if not isinstance(value, dict):
        raise SurefootError(f"{key} must be a table, [{key}]")
    return value


def _tables(table: dict[str, Any], key: str, where: str) -> list[dict[str, Any]]:
    value = table.get(key, [])
    if not isinstance(value, list) or not all(isinstance(v, dict) for v in value):
        raise SurefootError(f"{where}{key} must be an array of tables, [[{key}]]")
    return value


def _only(table: dict[str, Any], allowed: set[str], where: str) -> None:
    unknown = sorted(set(table) - allowed)
    if unknown:
        raise SurefootError(
            f"{where}unknown key '{unknown[0]}'; known: {', '.join(sorted(allowed))}"
        )


def _pair(value: Any, where: str) -> tuple[float, float]:
    if not isinstance(value, list) or len(value) != 2:
        raise SurefootError(f"{where} must be two numbers, is {value!r}")
    return _number(value[0], where), _number(value[1], where)


def _number(value: Any, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise SurefootError(f"{where} must be a number, is {value!r}")
    return float(value)
