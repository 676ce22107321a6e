"""Where each residual stands in the table of residuals."""

from dataclasses import dataclass

from surefoot.sim.robot.legs import JOINTS, LEGS

UNITS = {
    "imu_gyro": "rad/s",
    "imu_accel": "m/s^2",
    "leg_velocity": "m/s",
    "foot_height": "m",
    "joint_torque": "N m",
    "base_wrench": "N and N m",
    "joint_rate": "rad/s",
    "contact_timing": "s",
}
"""The channels and their units."""


@dataclass(frozen=True)
class Layout:
    """names (W,) of the table's columns; channels: where each is; groups: columns that one reading
    fills; alike: columns whose noise is of one size."""

    names: tuple[str, ...]
    channels: dict[str, slice]
    groups: tuple[slice, ...]
    alike: tuple[tuple[int, ...], ...]

    @property
    def width(self) -> int:
        return len(self.names)

    def channel_of(self, column: int) -> str:
        """The channel that a column belongs to."""
        return next(n for n, s in self.channels.items() if s.start <= column < s.stop)


def _quadruped() -> Layout:
    names = [f"{kind}_{axis}" for kind in ("gyro", "accel") for axis in "xyz"]
    names += [f"leg_{leg}_{axis}" for leg in LEGS for axis in "xyz"]
    names += [f"height_{leg}" for leg in LEGS]
    names += [f"torque_{joint}" for joint in JOINTS]
    names += [f"{kind}_{axis}" for kind in ("force", "moment") for axis in "xyz"]
    names += [f"rate_{joint}" for joint in JOINTS]
    names += [f"{change}_{leg}" for change in ("touchdown", "liftoff") for leg in LEGS]
    begin, channels = 0, {}
    for name, width in zip(UNITS, (3, 3, 12, 4, 12, 6, 12, 8), strict=True):
        channels[name] = slice(begin, begin + width)
        begin += width
    legs = tuple(slice(6 + 3 * leg, 9 + 3 * leg) for leg in range(4))
    single = tuple(slice(c, c + 1) for c in range(18, 34))
    groups = (slice(0, 3), slice(3, 6), *legs, *single, slice(34, 37), slice(37, 40))
    groups += tuple(slice(c, c + 1) for c in range(40, 60))
    alike = [(c,) for c in range(6)] + [tuple(range(6 + axis, 18, 3)) for axis in range(3)]
    alike += [tuple(range(18, 22))] + [tuple(range(22 + j, 34, 3)) for j in range(3)]
    alike += [(c,) for c in range(34, 40)] + [tuple(range(40 + j, 52, 3)) for j in range(3)]
    alike += [tuple(range(52, 56)), tuple(range(56, 60))]
    return Layout(tuple(names), channels, groups, tuple(alike))


QUADRUPED = _quadruped()


def layout_of(joints: tuple[str, ...]) -> Layout:
    """The table of a machine with these joints: a quadruped's, or that of a fixed base."""
    if joints == JOINTS or not joints:
        return QUADRUPED
    count = len(joints)
    names = tuple(f"{kind}_{joint}" for kind in ("torque", "rate") for joint in joints)
    single = tuple(slice(c, c + 1) for c in range(2 * count))
    channels = {"joint_torque": slice(0, count), "joint_rate": slice(count, 2 * count)}
    return Layout(names, channels, single, tuple((c,) for c in range(2 * count)))
