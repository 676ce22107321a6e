"""Source of each column of the log, and its conversion to SI."""

import json
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from math import pi
from typing import Any

import numpy as np

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.toml import Name, Positive
from surefoot.sim.log.schema import foot_vector, is_column, joint_prefix

STANDARD_GRAVITY = 9.80665
DEGREE = pi / 180.0
_ANGLE = {"rad": 1.0, "mrad": 1e-3, "deg": DEGREE, "turn": 2.0 * pi}
_RATE = {"rad/s": 1.0, "deg/s": DEGREE, "mdeg/s": 1e-3 * DEGREE, "rpm": 6.0 * DEGREE}
_LENGTH = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
_SPEED = {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3}
_FORCE = {"N": 1.0, "kN": 1e3}
UNITS: dict[str, dict[str, float]] = {
    "t": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "gyro": _RATE,
    "accel": {"m/s^2": 1.0, "g": STANDARD_GRAVITY, "mg": 1e-3 * STANDARD_GRAVITY},
    # Of joints that slide, distances, speeds and forces.
    "q": _ANGLE | _LENGTH,
    "dq": _RATE | {"turn/s": 2.0 * pi} | _SPEED,
    "tau": {"N m": 1.0, "mN m": 1e-3, "N cm": 1e-2} | _FORCE,
    "foot": _LENGTH,
    "force_xyz": _FORCE,
    "ref_p": _LENGTH,
    "ref_v": _SPEED,
    "ref_euler": _ANGLE,
}
"""Factor of each unit to SI, by kind of column; columns of other kinds are kept as given."""
EULER = ("ref_roll", "ref_pitch", "ref_yaw")
"""An attitude in angles: R_GM = Rz(yaw) Ry(pitch) Rx(roll)."""
_KINDS = {"q_des": "q", "dq_des": "dq", "tau_ff": "tau"} | dict.fromkeys(EULER, "ref_euler")


@dataclass(frozen=True)
class MapColumn:
    """Source and conversion of a column of the log.

    Attributes:
        theirs: name in the recording.
        scale: SI = scale * theirs + offset.
        offset: see `scale`.
        wrap: value of a full turn in their unit, for angles that wrap.
        word: text that means one; any other is zero.
        source: name of the further file that has it; None for the main one.
    """

    theirs: str
    scale: float = 1.0
    offset: float = 0.0
    wrap: float | None = None
    word: str | None = None
    source: str | None = None

    def read(self, values: np.ndarray) -> np.ndarray:
        """Convert their values to the log's (N,)."""
        if self.wrap is not None:
            values = np.unwrap(values, period=self.wrap)
        return self.scale * values + self.offset


@dataclass(frozen=True)
class ColumnEntry:
    """A column in a map: SI = sign * gain * unit * theirs + offset. "name" alone is short for {
    column = "name" }.
    """

    column: Name
    """Their name; "name[3]" is an element of a list or a column of an array, counted from 0,
    `name[3][2]` one of an array of three axes, whose first is of the rows;
    "file:name" is of the further file [sources.file], "/topic:field.path[joint]" of a bag,
    "/tf[frame->child]:transform.translation.x" of a frame in another.
    """
    unit: str | None = None
    """Their unit; SI by default."""
    sign: float = 1.0
    """1 or -1."""
    gain: float = 1.0
    """Additional factor, such as that of a sensor's counts."""
    offset: float = 0.0
    """Added last, in SI."""
    wrap: Positive | None = None
    """Value of a full turn in their unit, for angles that wrap."""
    word: Name | None = None
    """Text that means 1; any other is 0."""

    def __post_init__(self):
        check_sign("sign", self.sign)
        if self.gain == 0.0:
            raise SurefootError("gain is 0")


Entries = dict[str, Name | ColumnEntry]


def read_columns(section: str, entries: Entries, sources: tuple[str, ...]) -> dict[str, MapColumn]:
    """The columns of a section of a map, by the log's names.

    `sources` are the further files. Raises SurefootError naming section and column.
    """
    found = {}
    for name, entry in entries.items():
        if not is_column(name) and name not in EULER:
            raise SurefootError(
                f"[{section}] {name}: not a column of the log (one of your own is x_<name>)"
            )
        found[name] = read_column(f"{section}.{name}", name, entry, sources)
    return found


def read_column(
    place: str, name: str, entry: Name | ColumnEntry, sources: tuple[str, ...]
) -> MapColumn:
    """Read one column; `place` is the location of its entry in the map, for messages."""
    entry = ColumnEntry(entry) if isinstance(entry, str) else entry
    units = UNITS.get(kind_of(name), {})
    if entry.unit is not None and entry.unit not in units:
        allowed = ", ".join(units) or "none: it is kept as given"
        raise SurefootError(f"[{place}] unit {entry.unit!r} (allowed: {allowed})")
    scale = entry.sign * entry.gain * (1.0 if entry.unit is None else units[entry.unit])
    source, colon, theirs = entry.column.partition(":")
    if not colon or source not in sources:
        source, theirs = None, entry.column
    return MapColumn(theirs, scale, entry.offset, entry.wrap, entry.word, source)


def kind_of(name: str) -> str:
    """Kind of a column of the log, as in UNITS: gyro, q, ref_p, ..."""
    prefix = joint_prefix(name)
    kind = prefix[:-1] if prefix else foot_vector(name) or name
    kind = _KINDS.get(kind, kind)
    return kind if kind in UNITS else kind.rsplit("_", 1)[0]


def check_sign(key: str, value: float) -> None:
    """Raise SurefootError unless it is 1 or -1."""
    if value not in (1.0, -1.0):
        raise SurefootError(f"{key} is {value:g}, not 1 or -1")


def map_line(key: str, value: Any) -> str:
    """A key and its value as a line of a map (TOML)."""
    plain = re.fullmatch(r"[\w-]+", key, re.ASCII)
    return f"{key if plain else _map_value(key)} = {_map_value(value)}"


def _map_value(value: Any) -> str:
    """A value of a map as TOML; an entry without the keys that have their default."""
    if isinstance(value, ColumnEntry):
        default = asdict(ColumnEntry(value.column))
        value = {k: x for k, x in asdict(value).items() if k == "column" or x != default[k]}
    if isinstance(value, Mapping):
        return f"{{ {', '.join(map_line(key, one) for key, one in value.items())} }}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_map_value, value))}]"
    if isinstance(value, float):
        return f"{value:.9g}" if abs(value) < 1e6 else f"{value:.6f}"
    # TOML allows no DEL and no C1 control characters, which JSON leaves as they are.
    text = json.dumps(value, ensure_ascii=False)
    return re.sub(r"[\x7f-\x9f]", lambda found: f"\\u{ord(found[0]):04x}", text)
