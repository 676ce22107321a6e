"""Sections of an import map; `sim.importing.map` reads them and checks them together."""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.toml import Name, NonNegative, SampleRate
from surefoot.sim.importing.columns import ColumnEntry, Entries, check_sign
from surefoot.sim.robot.catalog import SUFFIXES

EVENNESS = 4e-3 / 3
"""Default unevenness of the ground [m]: DIN 18202, table 3, group 3 allows finished floors 4 mm
between points a metre apart, taken as three standard deviations. A log simulated elsewhere has
evenness = 0.
"""
_FARTHEST = 100.0
"""Distance of a sensor or a tracked body from the robot's base beyond which a map is wrong [m]."""
UpToOne = Annotated[float, msgspec.Meta(ge=0, le=1.0)]
"""A radius of feet [m] or a duration of contacts [s]; a larger one is in another unit."""
Quantity = Literal["force", "torque", "kinematics", "gait"]
"""What a rule compares to detect contacts; see `ContactTable`."""
OneCharacter = Annotated[str, msgspec.Meta(pattern=r"^[^\r\n\"]\Z")]
"""Within a line, and no quotation mark."""


@dataclass(frozen=True)
class Long:
    """[sources.<name>.long] or [source.long]: a table with one reading per row."""

    name: Name
    """Column with the name of each row's quantity."""
    value: Name
    """Column with the reading."""


@dataclass(frozen=True, kw_only=True)
class Source:
    """[source], the main file, and [sources.<name>], further ones with their own rates and clocks.

    Columns of a further file are written "<name>:column".
    """

    file: Name | None = None
    """File name, relative to the main file; "{name}" in it is the main file's name without its
    suffix.
    """
    rate: SampleRate | None = None
    """Rate of the rows [Hz], for a file without times."""
    t: Name | ColumnEntry | None = None
    """Times of a further file, on the log's clock after unit and offset."""
    separator: Annotated[str, msgspec.Meta(pattern=r'^([^\r\n"]|\\s\+)\Z')] | None = None
    """Separator of a text: `,` `;` `|`, a tab or spaces are detected by default."""
    header: bool = True
    """Whether a text's first line has the column names; else columns are called 0, 1, 2, ..."""
    skip: Annotated[int, msgspec.Meta(ge=0, le=1_000_000)] = 0
    """Number of lines of a text to skip at the beginning."""
    comment: OneCharacter | None = None
    """Prefix of comments in a text."""
    decimal: OneCharacter = "."
    """Decimal sign of a text."""
    sparse: bool = False
    """Whether cells may be empty: a column's readings are in the rows that have one."""
    long: Long | None = None
    """For a table with one reading per row; the quantities become its columns."""
    names: tuple[Name, ...] = ()
    """Names of the elements of its lists, so that "positions[knee]" may be written for
    "positions[3]".
    """

    @property
    def scattered(self) -> bool:
        """Whether its columns have readings in rows of their own."""
        return self.sparse or self.long is not None


@dataclass(frozen=True, kw_only=True)
class ReferenceTable(Source):
    """[reference]: the motion that a log is compared with. Has the keys of a file too; without
    `file`, its columns are in the main file.
    """

    columns: Entries
    """[reference.columns]: t, ref_p_{x,y,z} and ref_q_{w,x,y,z}; or ref_roll, ref_pitch and ref_yaw
    instead of ref_q, with R = Rz(yaw) Ry(pitch) Rx(roll).
    """
    frame: Literal["imu", "base"] = "imu"
    """Frame of the poses: the IMU's, or the robot's base."""
    offset: float | dict[str, float] = 0.0
    """Added to its times [s], as found by `surefoot align`; or a table by recording."""
    p_IM: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Position of the tracked body in the IMU frame [m]."""
    q_IM: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    """Attitude (w, x, y, z) of the tracked body in the IMU frame."""
    q_GW: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    """Attitude (w, x, y, z) of its world in one with z up; (0.7071, 0.7071, 0, 0) for a world with
    y up.
    """
    inverse: bool = False
    """Whether its attitudes map the world's axes to the body's, instead of the body's to the
    world's.
    """

    def __post_init__(self):
        _check_near("p_IM", self.p_IM)
        check_unit("q_IM", self.q_IM)
        check_unit("q_GW", self.q_GW)
        if self.frame == "base" and (any(self.p_IM) or any(self.q_IM[1:])):
            raise SurefootError('p_IM and q_IM go with frame "imu", which they replace')


@dataclass(frozen=True)
class RobotTable:
    """[robot]: the robot of the log. Values here override those of its file."""

    name: Name
    """A known name, or an MJCF or URDF file: its path, relative to the map's folder. It is also
    searched for in the recording's folder, then in the current one.
    """
    imu_position: tuple[float, float, float] | None = None
    """Position of the IMU in the base frame [m]; by default the file's."""
    imu_orientation: tuple[float, float, float, float] | None = None
    """Attitude (w, x, y, z) of the IMU in the base frame; by default the file's."""
    foot_radius: UpToOne | None = None
    """Radius on which the feet roll [m]; by default the file's, which `import` then reports; 0 for
    points.
    """
    feet: dict[str, Name] | None = None
    """By leg, the body or site of the file that is its foot."""
    joint_sign: dict[str, float] = field(default_factory=dict)
    """By joint, 1 or -1: q = sign * theirs + offset."""
    joint_offset: dict[str, float] = field(default_factory=dict)
    """By joint [rad]."""
    passive: tuple[Name, ...] = ()
    """Joints without a drive, whose torques are 0 where no column has them."""

    def __post_init__(self):
        if Path(self.name).suffix not in SUFFIXES and Path(self.name).name != self.name:
            raise SurefootError(
                f"name: {self.name!r} is neither a robot's name nor an MJCF or URDF"
            )
        _check_near("imu_position", self.imu_position or ())
        if self.imu_orientation is not None:
            check_unit("imu_orientation", self.imu_orientation)
        for joint, sign in self.joint_sign.items():
            check_sign(f"joint_sign.{joint}", sign)

    def model(self) -> dict[str, Any]:
        """The entries that a log's metadata keep."""
        position, q = self.imu_position, self.imu_orientation
        given = {
            "p_BI": position and list(position),
            "q_BI": q and [c / math.hypot(*q) for c in q],
            "foot_radius": self.foot_radius,
            "feet": self.feet,
        }
        return {key: value for key, value in given.items() if value is not None}


@dataclass(frozen=True)
class GroundTable:
    """[ground]: the ground on which the robot walks."""

    evenness: NonNegative = EVENNESS
    """Standard deviation of its height about a plane [m]; by default a finished floor's, 0 for a
    simulation.
    """


@dataclass(frozen=True)
class ContactTable:
    """[contact]: detection of contacts, for a recording without contact_<leg>."""

    on: float | dict[str, float]
    """Threshold above which a foot stands; a number, or a table by leg."""
    off: float | dict[str, float]
    """Threshold below which it no longer does."""
    of: Quantity = "force"
    """Quantity that is compared: force_<leg>, in its own unit; the upward force [N] of the joints'
    torques on the foot; the foot's speed relative to the lowest one [m/s]; or, for legs that swing
    together like the diagonals of a trot, the height of their feet above the lowest others [m],
    across the plane in which the feet walk.
    """
    offset: float | dict[str, float] = 0.0
    """Subtracted first."""
    debounce: UpToOne = 0.0
    """Time above `on` before a foot stands [s]."""

    @property
    def sign(self) -> float:
        """-1 for quantities of which a standing foot has less."""
        return -1.0 if self.of in ("kinematics", "gait") else 1.0

    def by_leg(self, legs: tuple[str, ...]) -> dict[str, tuple[float, float, float]]:
        """Offset, on and off of each leg; negative for kinematics and gait, where slower or lower
        is loaded.
        """
        sign, where = self.sign, "below" if self.sign < 0 else "above"
        offset, on, off = (
            by_name(f"contact.{key}", getattr(self, key), legs) for key in ("offset", "on", "off")
        )
        for leg in legs:
            if sign * off[leg] > sign * on[leg]:
                raise SurefootError(f"[contact] off is {where} on for {leg}")
        return {leg: (sign * offset[leg], sign * on[leg], sign * off[leg]) for leg in legs}


@dataclass(frozen=True)
class MotorLaw:
    """[motor_law]: torque = kp (q_des - q) + kd (dq_des - dq) + tau_ff, at the joint."""

    kp: NonNegative | dict[str, float]
    """Position gain [N m/rad]; a number, or a table by joint."""
    kd: NonNegative | dict[str, float]
    """Rate gain [N m s/rad]."""


@dataclass(frozen=True)
class EvenTable:
    """[even]: resampling to an even rate, and interpolation of held streams."""

    rate: SampleRate | None = None
    """Rate of the rows [Hz]; by default the median of the recording."""
    held: tuple[Name, ...] = ()
    """Kinds of columns ("q", "dq", "gyro", ...) that repeat a reading until the next: rows between
    are interpolated linearly.
    """
    late: dict[str, float] = field(default_factory=dict)
    """Delay [s] of kinds of columns ("foot", "dq", "contact", ...), or of columns, which is
    removed; also of contacts that [contact] detects. The times of a further file have an offset
    instead.
    """

    def __post_init__(self):
        for kind, delay in self.late.items():
            if not abs(delay) < 1.0:
                raise SurefootError(f"[even] late.{kind}: {delay:g} s is no delay of a sensor")


def check_unit(key: str, q: tuple[float, ...]) -> None:
    """Raise SurefootError unless q is of unit length, within the rounding of written numbers."""
    if abs(sum(c * c for c in q) - 1.0) > 1e-4:
        raise SurefootError(f"{key} is not a unit quaternion (w, x, y, z)")


def _check_near(key: str, position: tuple[float, ...]) -> None:
    """Raise SurefootError where a position on the robot is beyond _FARTHEST from it."""
    if math.hypot(*position) > _FARTHEST:
        raise SurefootError(f"{key} is {math.hypot(*position):.3g} m away, {_FARTHEST:g} m at most")


def by_name(
    place: str, value: float | dict[str, float], names: tuple[str, ...]
) -> dict[str, float]:
    """Values by name, of a number for all or a table, which is at `place` in the map. Raises
    SurefootError where the table has other names.
    """
    if not isinstance(value, dict):
        return dict.fromkeys(names, value)
    for name in (*value, *names):
        if name not in names:
            raise SurefootError(f"[{place}] unknown key {name!r}; known: {', '.join(names)}")
        if name not in value:
            raise SurefootError(f"[{place}] {name} is missing")
    return value
