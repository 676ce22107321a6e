"""The sections of an import map; `sim.importing.map` reads them and checks them together."""

import math
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

import msgspec

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.toml import Name, NonNegative, Positive
from surefoot.sim.importing.columns import ColumnEntry, Entries, check_sign

EVENNESS = 4e-3 / 3
"""m: DIN 18202, table 3, group 3 allows finished floors 4 mm between points a metre apart, here
treated as three standard deviations. A log that was simulated elsewhere has evenness = 0."""
OneCharacter = Annotated[str, msgspec.Meta(pattern=r"^[^\r\n\"]\Z")]
"""Of a line, and no quotation mark."""


@dataclass(frozen=True)
class Long:
    """[sources.<name>.long] or [source.long]: a table with one reading a row."""

    name: Name
    """Column that says what a row is a reading of."""
    value: Name
    """Column of the reading."""


@dataclass(frozen=True, kw_only=True)
class Source:
    """[source], the main file, and [sources.<name>], further ones with their own rates and clocks.

    Columns of a further file are written "<name>:column".
    """

    file: Name | None = None
    """Name, beside the main file; "{name}" in it is the main file's name without its ending."""
    rate: Positive | None = None
    """Hz, where it has no times."""
    t: Name | ColumnEntry | None = None
    """Of a further file: its times, on the log's clock after unit and offset."""
    separator: Annotated[str, msgspec.Meta(pattern=r'^([^\r\n"]|\\s\+)\Z')] | None = None
    """Between the cells of a text: `,` `;` `|`, a tab or spaces are found where left out."""
    header: bool = True
    """Whether a text's first line has names; else columns are called 0, 1, 2, ..."""
    skip: Annotated[int, msgspec.Meta(ge=0, le=1_000_000)] = 0
    """Lines of a text before the first that counts."""
    comment: OneCharacter | None = None
    """What begins a comment in a text."""
    decimal: OneCharacter = "."
    """Before the decimals in a text."""
    sparse: bool = False
    """Cells may be empty: a column's readings are in the rows that have one."""
    long: Long | None = None
    """Of a table with one reading a row; what it has readings of are its columns."""
    names: tuple[Name, ...] = ()
    """Of the places in its lists, so that "positions[knee]" may be written for "positions[3]"."""


@dataclass(frozen=True, kw_only=True)
class ReferenceTable(Source):
    """[reference]: the motion that a log is compared with. It has the keys of a file too: without
    `file`, its columns are of the main file."""

    columns: Entries
    """[reference.columns]: t, ref_p_{x,y,z} and ref_q_{w,x,y,z}; or ref_roll, ref_pitch and ref_yaw
    instead of ref_q, of R = Rz(yaw) Ry(pitch) Rx(roll)."""
    frame: Literal["imu", "base"] = "imu"
    """Whose pose it is: the IMU's, or the base's of the robot."""
    offset: float | dict[str, float] = 0.0
    """s, added to its times, as `surefoot align` finds it; or a table by recording."""
    p_IM: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """m, where the tracked body is in the IMU frame."""
    q_IM: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    """(w, x, y, z) of the tracked body in the IMU frame."""
    q_GW: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    """(w, x, y, z) of its world in one with z up: of a world with y up (0.7071, 0.7071, 0, 0)."""
    inverse: bool = False
    """Its attitudes turn the world's axes into the body's, not the body's into the world's."""

    def __post_init__(self):
        check_unit("q_IM", self.q_IM)
        check_unit("q_GW", self.q_GW)
        if self.frame == "base" and (any(self.p_IM) or any(self.q_IM[1:])):
            raise SurefootError('p_IM and q_IM go with frame "imu", which they replace')


@dataclass(frozen=True)
class RobotTable:
    """[robot]: whose log it is. What is said here overrides the robot's file."""

    name: Name
    """A known name, or an MJCF or URDF file: a path, beside the map or beside the recording."""
    imu_position: tuple[float, float, float] | None = None
    """m, of the IMU in the base frame; the file's where left out."""
    imu_orientation: tuple[float, float, float, float] | None = None
    """(w, x, y, z) of the IMU in the base frame; the file's where left out."""
    foot_radius: NonNegative | None = None
    """m, at which the feet roll; the file's where left out, which `import` then says; 0 for
    points."""
    feet: dict[str, Name] | None = None
    """By leg, the body or site of the file that is its foot."""
    joint_sign: dict[str, float] = field(default_factory=dict)
    """By joint, 1 or -1: q = sign * theirs + offset."""
    joint_offset: dict[str, float] = field(default_factory=dict)
    """By joint, rad."""

    def __post_init__(self):
        if self.imu_orientation is not None:
            check_unit("imu_orientation", self.imu_orientation)
        for joint, sign in self.joint_sign.items():
            check_sign(f"joint_sign.{joint}", sign)

    def model(self) -> dict[str, Any]:
        """What a log's metadata keep of it."""
        given = {
            "p_BI": self.imu_position,
            "q_BI": self.imu_orientation,
            "foot_radius": self.foot_radius,
            "feet": self.feet,
        }
        return {key: _as_kept(key, value) for key, value in given.items() if value is not None}


@dataclass(frozen=True)
class GroundTable:
    """[ground]: where the robot walks."""

    evenness: NonNegative = EVENNESS
    """m, standard deviation of its height about a plane: a finished floor's where left out, 0 in a
    simulation."""


@dataclass(frozen=True)
class ContactTable:
    """[contact]: which feet stand, where the recording has no contact_<leg>."""

    on: float | dict[str, float]
    """Threshold from which a foot stands; a number, or a table by leg."""
    off: float | dict[str, float]
    """Threshold from which it does not."""
    of: Literal["force", "torque", "kinematics", "gait"] = "force"
    """What is compared: force_<leg>, in its own unit; the upward force [N] that the joints' torques
    put on the foot; how fast the foot moves beside the lowest one [m/s]; or, of legs that swing
    together, as the diagonals of a trot do, how high their feet are above the lowest others [m]."""
    offset: float | dict[str, float] = 0.0
    """Taken off before."""
    debounce: NonNegative = 0.0
    """s beyond `on` before a foot stands."""

    def by_leg(self, legs: tuple[str, ...]) -> dict[str, tuple[float, float, float]]:
        """Offset, on and off of each leg; of kinematics and gait all negative, for slower or lower
        is loaded."""
        table = {key: _by_leg(key, getattr(self, key), legs) for key in ("offset", "on", "off")}
        falling = self.of in ("kinematics", "gait")
        sign = -1.0 if falling else 1.0
        for leg in legs:
            if sign * table["off"][leg] > sign * table["on"][leg]:
                where = "below" if falling else "above"
                raise SurefootError(f"[contact] off is {where} on for {leg}")
        return {
            leg: (sign * table["offset"][leg], sign * table["on"][leg], sign * table["off"][leg])
            for leg in legs
        }


@dataclass(frozen=True)
class MotorLaw:
    """[motor_law]: torque = kp (q_des - q) + kd (dq_des - dq) + tau_ff, at the joint."""

    kp: NonNegative | dict[str, float]
    """N m/rad; a number, or a table by joint."""
    kd: NonNegative | dict[str, float]
    """N m s/rad."""


@dataclass(frozen=True)
class EvenTable:
    """[even]: rows at an even rate, and streams that are held made continuous."""

    rate: Positive | None = None
    """Hz, of the rows; the median of what was recorded where left out."""
    held: tuple[Name, ...] = ()
    """Kinds of columns ("q", "dq", "gyro", ...) that repeat a reading until the next: rows between
    get values on straight lines from one to the next."""
    late: dict[str, float] = field(default_factory=dict)
    """s by which kinds of columns ("foot", "dq", ...), or columns, come after what they measure:
    they are moved to when it was. Of a further file, its times have an offset instead."""

    def __post_init__(self):
        for kind, delay in self.late.items():
            if not abs(delay) < 1.0:
                raise SurefootError(f"[even] late.{kind}: {delay:g} s is no delay of a sensor")


def check_unit(key: str, q: tuple[float, ...]) -> None:
    """Raise SurefootError unless q is of unit length, to the digits that people write."""
    if abs(sum(c * c for c in q) - 1.0) > 1e-4:
        raise SurefootError(f"{key} is not a unit quaternion (w, x, y, z)")


def _as_kept(key: str, value: Any) -> Any:
    if not isinstance(value, tuple):
        return value
    length = math.hypot(*value) if key == "q_BI" else 1.0
    return [c / length for c in value]


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
