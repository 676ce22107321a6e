"""An import map: the TOML file that says what the columns of a recording are.

    [source]     file, rate (Hz, where there is no time column)
    [columns]    <log column> = "their column" | { column, unit, sign, offset }, the offset in SI
                 and added last; a bag's columns are "topic:field.path" (`sim.importing.bag`), and
                 the topic of t is the log's clock
    [reference]  file (not of a bag; "{name}" in it is the recording's own name), frame ("imu" |
                 "base"), offset (s, added to its stamps; a number, or a table by recording), p_IM
                 (m) and q_IM (w, x, y, z) of the tracked body in the IMU frame, and
                 [reference.columns] as above, with a t of its own; `surefoot align` finds the
                 offset, p_IM and q_IM
    [robot]      name, imu_position (m, in B), imu_orientation (w, x, y, z of I in B), foot_radius,
                 feet (by leg, the body or site that is its foot), joint_sign and joint_offset by
                 joint: q = sign * theirs + offset. Without a foot_radius the declared model has
                 feet that do not roll: a map declares only what it says
    [ground]     evenness: standard deviation (m) of its height about a plane, EVENNESS if left out
    [contact]    offset by leg, on, off (raw), debounce (s): contact_<leg> from force_<leg>
    [motor_law]  kp (N m/rad), kd (N m s/rad): a number, or a table by joint

A key that is not listed is an error: a misspelt sign that was ignored would cost days.
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.files import bundled
from surefoot.sim.common.toml import Name, NonNegative, Positive, read_typed
from surefoot.sim.log.schema import GROUPS, foot_vector, is_column, joint_prefix, leg_names

BUNDLED_MAPS = bundled("surefoot.sim.importing", "maps")
STANDARD_GRAVITY = 9.80665
STEM = "{name}"
"""In the name of a reference's file: the name of the recording's, without its ending."""
DEGREE = 0.017453292519943295
EVENNESS = 4e-3 / 3
"""m: DIN 18202, table 3, group 3 allows finished floors 4 mm between points a metre apart, here
treated as three standard deviations. A log that was simulated elsewhere has evenness = 0."""
_UNITS: dict[str, dict[str, float]] = {
    "t": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "gyro": {"rad/s": 1.0, "deg/s": DEGREE},
    "accel": {"m/s^2": 1.0, "g": STANDARD_GRAVITY},
    "q": {"rad": 1.0, "deg": DEGREE},
    "dq": {"rad/s": 1.0, "deg/s": DEGREE, "rpm": 6.0 * DEGREE},
    "tau": {"N m": 1.0, "mN m": 1e-3},
    "foot": {"m": 1.0, "cm": 1e-2, "mm": 1e-3},
    "force_xyz": {"N": 1.0, "kN": 1e3},
    "ref_p": {"m": 1.0, "cm": 1e-2, "mm": 1e-3},
    "ref_v": {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3},
}
_KINDS = {"q_des": "q", "dq_des": "dq", "tau_ff": "tau"}


@dataclass(frozen=True)
class MapColumn:
    """Where a log column comes from: `theirs` times `scale` (unit and sign together), plus
    `offset`, is SI."""

    theirs: str
    scale: float = 1.0
    offset: float = 0.0

    def read(self, values: np.ndarray) -> np.ndarray:
        """The log's values (N,) of theirs."""
        return self.scale * values + self.offset


@dataclass(frozen=True)
class MapReference:
    """The reference's own file beside the main one (None in a bag), its columns, whose pose.

    offset: s to add to its stamps, or by recording; p_IM (3,) [m] and q_IM (w, x, y, z): where the
    tracked body M is in the IMU frame I, and how it is turned.
    """

    file: str | None
    columns: dict[str, MapColumn]
    frame: str = "imu"
    offset: float | dict[str, float] = 0.0
    p_IM: tuple[float, float, float] = (0.0, 0.0, 0.0)
    q_IM: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Contact:
    """How raw force becomes contact; `offset`, `on` and `off` by leg, in the force's unit."""

    offset: dict[str, float]
    on: dict[str, float]
    off: dict[str, float]
    debounce: float


@dataclass(frozen=True)
class ImportMap:
    """A checked map. `model` is what goes into `Meta.model`; gains are numbers or by joint."""

    path: Path
    columns: dict[str, MapColumn]
    file: str | None = None
    rate: float | None = None
    reference: MapReference | None = None
    robot: str | None = None
    model: dict[str, Any] = field(default_factory=dict)
    joint_sign: dict[str, float] = field(default_factory=dict)
    joint_offset: dict[str, float] = field(default_factory=dict)
    contact: Contact | None = None
    motor_law: dict[str, float | dict[str, float]] | None = None

    @classmethod
    def read(cls, path: str | Path) -> "ImportMap":
        """The map at `path`, or the bundled one of that name.

        Raises SurefootError naming file, section and key.
        """
        path = find_map(path)
        file = read_typed(path, _File)
        try:
            return file.checked(path)
        except SurefootError as error:
            raise SurefootError(f"{path}: {error}") from None


def find_map(path: str | Path) -> Path:
    """The file of a map given by path, or by the name of a bundled one."""
    path = Path(path)
    bundled = BUNDLED_MAPS / f"{path.name.removesuffix('.toml')}.toml"
    if path.is_file():
        return path
    if path.parent == Path() and bundled.is_file():
        return bundled
    names = ", ".join(sorted(file.stem for file in BUNDLED_MAPS.glob("*.toml")))
    raise SurefootError(f"{path}: no such import map (bundled: {names})")


@dataclass(frozen=True)
class _ColumnEntry:
    column: Name
    unit: str | None = None
    sign: float = 1.0
    offset: float = 0.0

    def __post_init__(self):
        _check_sign("sign", self.sign)


_Columns = dict[str, Name | _ColumnEntry]


@dataclass(frozen=True)
class _Source:
    file: Name | None = None
    rate: Positive | None = None


@dataclass(frozen=True)
class _ReferenceTable:
    columns: _Columns
    file: Name | None = None
    frame: Literal["imu", "base"] = "imu"
    offset: float | dict[str, float] = 0.0
    p_IM: tuple[float, float, float] = (0.0, 0.0, 0.0)
    q_IM: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)

    def __post_init__(self):
        _check_unit("q_IM", self.q_IM)
        if self.frame == "base" and (any(self.p_IM) or any(self.q_IM[1:])):
            raise SurefootError('p_IM and q_IM go with frame "imu", which they replace')


@dataclass(frozen=True)
class _Robot:
    name: Name
    imu_position: tuple[float, float, float] | None = None
    imu_orientation: tuple[float, float, float, float] | None = None
    foot_radius: NonNegative = 0.0
    feet: dict[str, Name] | None = None
    joint_sign: dict[str, float] = field(default_factory=dict)
    joint_offset: dict[str, float] = field(default_factory=dict)

    def __post_init__(self):
        if self.imu_orientation is not None:
            _check_unit("imu_orientation", self.imu_orientation)
        for joint, sign in self.joint_sign.items():
            _check_sign(f"joint_sign.{joint}", sign)

    def model(self) -> dict[str, Any]:
        given = {"p_BI": self.imu_position, "q_BI": self.imu_orientation}
        poses = {key: list(value) for key, value in given.items() if value is not None}
        named = {} if self.feet is None else {"feet": self.feet}
        return {"foot_radius": self.foot_radius, **poses, **named}


@dataclass(frozen=True)
class _Ground:
    evenness: NonNegative


@dataclass(frozen=True)
class _Contact:
    on: float | dict[str, float]
    off: float | dict[str, float]
    offset: float | dict[str, float] = 0.0
    debounce: NonNegative = 0.0

    def by_leg(self, legs: tuple[str, ...]) -> Contact:
        offset, on, off = (
            _by_leg(key, getattr(self, key), legs) for key in ("offset", "on", "off")
        )
        for leg in legs:
            if off[leg] > on[leg]:
                raise SurefootError(f"[contact] off is above on for {leg}")
        return Contact(offset, on, off, self.debounce)


@dataclass(frozen=True)
class _MotorLaw:
    kp: NonNegative | dict[str, float]
    kd: NonNegative | dict[str, float]


@dataclass(frozen=True)
class _File:
    columns: _Columns
    source: _Source = field(default_factory=_Source)
    reference: _ReferenceTable | None = None
    robot: _Robot | None = None
    ground: _Ground = field(default_factory=lambda: _Ground(EVENNESS))
    contact: _Contact | None = None
    motor_law: _MotorLaw | None = None

    def checked(self, path: Path) -> ImportMap:
        columns = _columns("columns", self.columns)
        if ("t" in columns) == (self.source.rate is not None):
            raise SurefootError("[columns] t or [source] rate must be given, and not both")
        contact, legs = None, leg_names(columns)
        if self.contact is not None:
            if not legs or any(f"force_{leg}" not in columns for leg in legs):
                raise SurefootError("[contact] needs force_<leg> of every leg in [columns]")
            if any(name.startswith("contact_") for name in columns):
                raise SurefootError("[contact] is given beside contact_<leg> in [columns]")
            contact = self.contact.by_leg(legs)
        model = self.robot.model() if self.robot else {}
        referenced = any(name.startswith("ref_") for name in columns)
        if self.reference is not None and referenced:
            raise SurefootError("[columns] has ref_ columns beside a [reference] file")
        if self.reference is not None or referenced:
            model["ground_evenness"] = self.ground.evenness
        return ImportMap(
            path=path,
            columns=columns,
            file=self.source.file,
            rate=self.source.rate,
            reference=_reference(self.reference) if self.reference else None,
            robot=self.robot.name if self.robot else None,
            model=model,
            joint_sign=self.robot.joint_sign if self.robot else {},
            joint_offset=self.robot.joint_offset if self.robot else {},
            contact=contact,
            motor_law=vars(self.motor_law) if self.motor_law else None,
        )


def _reference(table: _ReferenceTable) -> MapReference:
    columns = _columns("reference.columns", table.columns)
    needed = ("t", *GROUPS["reference"])
    for name in needed:
        if name not in columns:
            raise SurefootError(f"[reference.columns] {name} is missing")
    for name in columns:
        if name not in needed:
            raise SurefootError(f"[reference.columns] {name}: only t, ref_p and ref_q go here")
    return MapReference(table.file, columns, table.frame, table.offset, table.p_IM, table.q_IM)


def _columns(section: str, entries: _Columns) -> dict[str, MapColumn]:
    found = {}
    for name, entry in entries.items():
        if not is_column(name):
            raise SurefootError(
                f"[{section}] {name}: not a column of the log (one of your own is x_<name>)"
            )
        if isinstance(entry, str):
            found[name] = MapColumn(entry)
            continue
        prefix = joint_prefix(name)
        kind = prefix[:-1] if prefix else foot_vector(name) or name.rsplit("_", 1)[0]
        units = _UNITS.get(_KINDS.get(kind, kind), {})
        if entry.unit is not None and entry.unit not in units:
            allowed = ", ".join(units) or "none: it is kept as given"
            raise SurefootError(f"[{section}.{name}] unit {entry.unit!r} (allowed: {allowed})")
        scale = entry.sign if entry.unit is None else entry.sign * units[entry.unit]
        found[name] = MapColumn(entry.column, scale, entry.offset)
    return found


def _by_leg(key: str, value: float | dict[str, float], legs: tuple[str, ...]) -> dict[str, float]:
    if not isinstance(value, dict):
        return dict.fromkeys(legs, value)
    for leg in value:
        if leg not in legs:
            raise SurefootError(f"[contact.{key}] unknown key {leg!r}; known: {', '.join(legs)}")
    for leg in legs:
        if leg not in value:
            raise SurefootError(f"[contact.{key}] {leg} is missing")
    return value


def _check_unit(key: str, q: tuple[float, ...]) -> None:
    if abs(sum(c * c for c in q) - 1.0) > 1e-5:
        raise SurefootError(f"{key} is not a unit quaternion (w, x, y, z)")


def _check_sign(key: str, value: float) -> None:
    if value not in (1.0, -1.0):
        raise SurefootError(f"{key} is {value:g}, not 1 or -1")
