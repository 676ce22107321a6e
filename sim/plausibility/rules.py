"""The rules of plausibility, in the order in which they are checked.

A rule is checked only where no earlier rule doubts what it compares. One fault therefore gives one
finding, and a second fault of a log may show only when the first is corrected. Minor rules put
nothing in doubt.
"""

from surefoot.sim.log import Log
from surefoot.sim.plausibility import (
    clock,
    contacts,
    drives,
    imu,
    joints,
    legs,
    noise,
    place,
    reference,
    streams,
)
from surefoot.sim.plausibility.finding import Finding, Rule
from surefoot.sim.plausibility.view import LogView
from surefoot.sim.robot.machine import Machine

RULES: tuple[Rule, ...] = (
    # What each column is by itself.
    clock.stamps,
    clock.speed,
    streams.frozen,
    streams.copies,
    streams.overflows,
    streams.saturated,
    imu.gyro_unit,
    imu.gravity,
    reference.position,
    joints.units,
    streams.coarse,
    joints.rates,
    streams.spikes,
    clock.leaps,
    reference.even_samples,
    # IMU and reference with each other.
    reference.attitude,
    imu.gyro,
    noise.noisy,
    imu.averaged,
    imu.turning_of_legs,
    reference.velocity,
    imu.accelerometer,
    place.point,
    place.motion,
    # Legs with both.
    contacts.dead,
    legs.kinematics,
    joints.stops,
    contacts.flickering,
    contacts.missed,
    joints.zeros,
    legs.climbing,
    legs.zeros_of_most,
    place.from_legs,
    contacts.inverted,
    # Torques and commands.
    joints.torques,
    joints.magnitudes,
    drives.driving,
    legs.weight_carried,
    legs.late_torques,
    joints.commands,
    drives.followed,
    # What is good to know.
    streams.held,
    streams.interpolated,
    streams.late,
    clock.single_rows,
    streams.derived,
)


def check_log(log: Log, machine: Machine | None = None) -> tuple[Finding, ...]:
    """Find what is implausible in a log; takes about a second per minute of log.

    `machine` is the robot or other machine of the log, None if unknown.
    """
    view = LogView(log, machine)
    found: list[Finding] = []
    doubted: set[str] = set()
    for rule in RULES:
        new = rule.findings(view, doubted)
        found += new
        if not rule.minor:
            doubted.update(*(one.streams for one in new))
    return tuple(found)


def rules_table() -> list[dict[str, str]]:
    """The rules as rows of a table."""
    return [{"Rule": rule.name} | rule.explained for rule in RULES]
