"""An import map: the TOML file that says what the columns of somebody's recording are.

    [source]     file, rate (Hz, where there is no time column)
    [columns]    <log column> = "their column" | { column, unit, sign }; a bag's columns are
                 "topic:field.path" (`sim.importing.bag_table`), and the topic of t is the log's
    clock
    [reference]  file (not of a bag), frame ("imu" | "base"), and [reference.columns] as above, with
                 a t of its own
    [robot]      name, imu_position (m, in B), imu_orientation (w, x, y, z of I in B), foot_radius,
                 joint_sign and joint_offset by joint: q = sign * theirs + offset. Without a
                 foot_radius the declared model has feet that do not roll: a map declares only
                 what it says
    [ground]     evenness: standard deviation (m) of its height about a plane, EVENNESS if left out
    [contact]    offset by leg, on, off (raw), debounce (s): contact_<leg> from force_<leg>
    [motor_law]  kp (N m/rad), kd (N m s/rad): a number, or a table by joint

A key that is not listed is an error: a misspelt sign that was ignored would cost days.
"""

import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.files import bundled
from surefoot.sim.importing.map_checks import (
    check_keys,
    checked_by_name,
    checked_number,
    checked_text,
    checked_vector,
)
from surefoot.sim.log.schema import GROUPS, LEGS, is_column, joint_prefix

BUNDLED = bundled("surefoot.sim.importing", "maps")
G = 9.80665
DEGREE = 0.017453292519943295
EVENNESS = 4e-3 / 3
"""m: DIN 18202, table 3, group 3 allows finished floors 4 mm between points a metre apart, here
taken for three standard deviations. A log that was simulated elsewhere has evenness = 0."""
_UNITS: dict[str, dict[str, float]] = {
    "t": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "gyro": {"rad/s": 1.0, "deg/s": DEGREE},
    "accel": {"m/s^2": 1.0, "g": G},
    "q": {"rad": 1.0, "deg": DEGREE},
    "dq": {"rad/s": 1.0, "deg/s": DEGREE, "rpm": 6.0 * DEGREE},
    "tau": {"N m": 1.0, "mN m": 1e-3},
    "ref_p": {"m": 1.0, "cm": 1e-2, "mm": 1e-3},
    "ref_v": {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3},
}
_KINDS = {"q_des": "q", "dq_des": "dq", "tau_ff": "tau"}


@dataclass(frozen=True)
class Column:
    """Where a log column comes from: `theirs` times `scale` (unit and sign together) is SI."""

    theirs: str
    scale: float = 1.0


@dataclass(frozen=True)
class Reference:
    """The reference's own file beside the main one (None in a bag), its columns, whose pose."""

    file: str | None
    columns: dict[str, Column]
    frame: str = "imu"


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
    columns: dict[str, Column]
    file: str | None = None
    rate: float | None = None
    reference: Reference | None = None
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
        try:
            sections = tomllib.loads(path.read_text(encoding="utf-8"))
        except (tomllib.TOMLDecodeError, UnicodeDecodeError, OSError) as error:
            raise SurefootError(f"{path}: {' '.join(str(error).split())}") from error
        try:
            return _parse(path, sections)
        except SurefootError as error:
            raise SurefootError(f"{path}: {error}") from error


def find_map(path: str | Path) -> Path:
    """The file of a map given by path, or by the name of a bundled one."""
    path = Path(path)
    bundled = BUNDLED / f"{path.name.removesuffix('.toml')}.toml"
    if path.is_file():
        return path
    if path.parent == Path() and bundled.is_file():
        return bundled
    names = ", ".join(sorted(file.stem for file in BUNDLED.glob("*.toml")))
    raise SurefootError(f"{path}: no such import map (bundled: {names})")


def _parse(path: Path, sections: dict[str, Any]) -> ImportMap:
    check_keys("map", sections, required=("columns",), optional=tuple(_SECTIONS))
    for name in sections:
        if not isinstance(sections[name], dict):
            raise SurefootError(f"[{name}] is not a table")
    parts: dict[str, Any] = {"columns": _columns("columns", sections["columns"])}
    for name, parse in _SECTIONS.items():
        if name in sections:
            parts |= parse(sections[name])
    if ("t" in parts["columns"]) == ("rate" in parts):
        raise SurefootError("[columns] t or [source] rate must be given, and not both")
    contact = parts.get("contact")
    if contact and not all(f"force_{leg}" in parts["columns"] for leg in LEGS):
        raise SurefootError("[contact] needs force_<leg> of every leg in [columns]")
    if contact and any(name.startswith("contact_") for name in parts["columns"]):
        raise SurefootError("[contact] is given beside contact_<leg> in [columns]")
    evenness = parts.pop("evenness", EVENNESS)
    if "reference" in parts or any(name.startswith("ref_") for name in parts["columns"]):
        model = {"ground_evenness": evenness}
        parts["model"] = parts.get("model", {}) | model
    if "reference" in parts and any(name.startswith("ref_") for name in parts["columns"]):
        raise SurefootError("[columns] has ref_ columns beside a [reference] file")
    return ImportMap(path=path, **parts)


def _source(section: dict[str, Any]) -> dict[str, Any]:
    check_keys("source", section, optional=("file", "rate"))
    parts: dict[str, Any] = {}
    if "file" in section:
        parts["file"] = checked_text("source", "file", section["file"])
    if "rate" in section:
        parts["rate"] = checked_number("source", "rate", section["rate"], above=0.0)
    return parts


def _reference(section: dict[str, Any]) -> dict[str, Any]:
    check_keys("reference", section, required=("columns",), optional=("file", "frame"))
    columns = _columns("reference.columns", section["columns"])
    needed = ("t", *GROUPS["reference"])
    for name in needed:
        if name not in columns:
            raise SurefootError(f"[reference.columns] {name} is missing")
    for name in columns:
        if name not in needed:
            raise SurefootError(f"[reference.columns] {name}: only t, ref_p and ref_q go here")
    frame = section.get("frame", "imu")
    if frame not in ("imu", "base"):
        raise SurefootError(f'[reference] frame is {frame!r}, not "imu" or "base"')
    file = checked_text("reference", "file", section["file"]) if "file" in section else None
    return {"reference": Reference(file, columns, frame)}


def _robot(section: dict[str, Any]) -> dict[str, Any]:
    keys = ("imu_position", "imu_orientation", "foot_radius", "joint_sign", "joint_offset")
    check_keys("robot", section, required=("name",), optional=keys)
    parts: dict[str, Any] = {"robot": checked_text("robot", "name", section["name"])}
    model: dict[str, Any] = {"foot_radius": 0.0}
    parts["model"] = model
    if "imu_position" in section:
        model["p_BI"] = checked_vector("robot", "imu_position", section["imu_position"], 3)
    if "imu_orientation" in section:
        q = checked_vector("robot", "imu_orientation", section["imu_orientation"], 4)
        if abs(sum(c * c for c in q) - 1.0) > 1e-5:
            raise SurefootError("[robot] imu_orientation is not a unit quaternion (w, x, y, z)")
        model["q_BI"] = q
    if "foot_radius" in section:
        radius = checked_number("robot", "foot_radius", section["foot_radius"], least=0.0)
        model["foot_radius"] = radius
    for key in ("joint_sign", "joint_offset"):
        if key in section:
            parts[key] = checked_by_name("robot", key, section[key])
    for joint, sign in parts.get("joint_sign", {}).items():
        if sign not in (1.0, -1.0):
            raise SurefootError(f"[robot] joint_sign.{joint} is {sign:g}, not 1 or -1")
    return parts


def _ground(section: dict[str, Any]) -> dict[str, Any]:
    check_keys("ground", section, required=("evenness",))
    return {"evenness": checked_number("ground", "evenness", section["evenness"], least=0.0)}


def _contact(section: dict[str, Any]) -> dict[str, Any]:
    check_keys("contact", section, required=("on", "off"), optional=("offset", "debounce"))
    values = {key: _by_leg(key, section.get(key, 0.0)) for key in ("offset", "on", "off")}
    for leg in LEGS:
        if values["off"][leg] > values["on"][leg]:
            raise SurefootError(f"[contact] off is above on for {leg}")
    debounce = checked_number("contact", "debounce", section.get("debounce", 0.0), least=0.0)
    return {"contact": Contact(**values, debounce=debounce)}


def _motor_law(section: dict[str, Any]) -> dict[str, Any]:
    check_keys("motor_law", section, required=("kp", "kd"))
    law: dict[str, float | dict[str, float]] = {}
    for key, value in section.items():
        if isinstance(value, dict):
            law[key] = checked_by_name("motor_law", key, value)
        else:
            law[key] = checked_number("motor_law", key, value, least=0.0)
    return {"motor_law": law}


_SECTIONS = {
    "source": _source,
    "reference": _reference,
    "robot": _robot,
    "ground": _ground,
    "contact": _contact,
    "motor_law": _motor_law,
}


def _columns(section: str, columns: Any) -> dict[str, Column]:
    if not isinstance(columns, dict):
        raise SurefootError(f"[{section}] is not a table")
    return {name: _column(section, name, spec) for name, spec in columns.items()}


def _column(section: str, name: str, spec: Any) -> Column:
    prefix = joint_prefix(name)
    if not is_column(name):
        raise SurefootError(f"[{section}] {name}: not a column of the log (see DESIGN, x_<name>)")
    if isinstance(spec, str):
        return Column(spec)
    where = f"{section}.{name}"
    if not isinstance(spec, dict):
        raise SurefootError(f"[{section}] {name}: a column name or a table of column, unit, sign")
    check_keys(where, spec, required=("column",), optional=("unit", "sign"))
    scale = float(spec.get("sign", 1)) if spec.get("sign", 1) in (1, -1) else None
    if scale is None:
        raise SurefootError(f"[{where}] sign is {spec['sign']!r}, not 1 or -1")
    if "unit" in spec:
        kind = prefix[:-1] if prefix else name.rsplit("_", 1)[0]
        units = _UNITS.get(_KINDS.get(kind, kind), {})
        if spec["unit"] not in units:
            allowed = ", ".join(units) or "none: it is kept as given"
            raise SurefootError(f"[{where}] unit {spec['unit']!r} (allowed: {allowed})")
        scale *= units[spec["unit"]]
    return Column(checked_text(where, "column", spec["column"]), scale)


def _by_leg(key: str, value: Any) -> dict[str, float]:
    if not isinstance(value, dict):
        return dict.fromkeys(LEGS, checked_number("contact", key, value))
    check_keys(f"contact.{key}", value, required=LEGS)
    return {leg: checked_number("contact", f"{key}.{leg}", value[leg]) for leg in LEGS}
