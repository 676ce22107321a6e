"""The rules of plausibility, in the order in which they are checked.

A rule is checked only where no earlier rule doubts what it compares. One fault therefore gives one
finding, and a second fault of a log may show only when the first is corrected. Rules that compare
fewer columns come before those that compare more, since fewer may be at fault, and rules that find
a symptom of several causes last. Notes put nothing in doubt.

Rules may find columns one by one: those of one cause are one finding.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from functools import reduce
from typing import Any

from surefoot.sim.log import Log
from surefoot.sim.plausibility import (
    attitude,
    clock,
    contacts,
    imu,
    joints,
    legs,
    loads,
    reference,
    streams,
)
from surefoot.sim.plausibility.finding import Finding, Rule
from surefoot.sim.plausibility.view import LogView
from surefoot.sim.robot.machine import Machine

RULES: tuple[Rule, ...] = (
    # Stamps, and columns by themselves.
    clock.stamps, clock.single_rows, clock.speed,
    streams.frozen, streams.held, streams.interpolated, streams.overflows,
    streams.saturated, streams.copies, streams.derived,
    # Sizes and units, of one sensor at a time.
    joints.units, joints.torques, joints.magnitudes,
    reference.position, reference.even_samples, imu.gravity, imu.gyro_unit,
    contacts.flickering, contacts.dead,
    # Two readings of one quantity.
    clock.leaps, joints.rates, joints.commands, streams.spikes,
    attitude.attitude, reference.velocity, imu.gyro,
    loads.driven, loads.followed, streams.coarse, streams.noisy,
    # IMU, reference and legs together.
    imu.accelerometer, reference.point, reference.motion, imu.averaged,
    imu.turning_of_legs, reference.from_legs, legs.kinematics, loads.carrying,
    # Symptoms of several causes.
    joints.stops, joints.zeros, streams.lagging, contacts.inverted,
)  # fmt: skip
_GROUPS = {"ref": "reference"}
"""Group of columns of a log by what a rule needs, where it has another name."""


def check_log(log: Log, machine: Machine | None = None) -> tuple[Finding, ...]:
    """Find what is implausible in a log; takes about a second per minute of log.

    `machine` is the robot or other machine of the log, None if unknown.
    """
    view = LogView(log, machine)
    found: list[Finding] = []
    doubted: set[str] = set()
    for rule in RULES:
        if not _applies(rule, view, doubted):
            continue
        new = [one for one in rule.find(view) if not doubted.issuperset(one.streams)]
        found += (replace(one, rule=rule.name) for one in _together(new))
        if not rule.is_note:
            doubted.update(*(one.streams for one in new))
    return tuple(found)


def _together(found: Iterable[Finding]) -> Iterator[Finding]:
    """One finding for all that have the same cause, with the evidence of the first."""
    by_cause: dict[str, list[Finding]] = {}
    for one in found:
        by_cause.setdefault(one.cause, []).append(one)
    for same in by_cause.values():
        first, streams = same[0], dict.fromkeys(name for one in same for name in one.streams)
        alike = all(one.evidence == first.evidence for one in same)
        evidence = first.evidence if alike else f"{first.streams[0]}: {first.evidence}"
        changes = reduce(_united, (one.changes for one in same))
        yield replace(first, streams=tuple(streams), evidence=evidence, changes=changes)


def _united(a: Mapping[str, Any], b: Mapping[str, Any]) -> dict[str, Any]:
    """Two tables as one, with the tables and lists that both have."""
    united = dict(a)
    for key, value in b.items():
        if key in a and isinstance(value, Mapping):
            value = _united(a[key], value)
        elif key in a and isinstance(value, tuple):
            value = (*a[key], *value)
        united[key] = value
    return united


def _applies(rule: Rule, view: LogView, doubted: set[str]) -> bool:
    """Whether a log has what a rule needs, and nothing of it is in doubt."""
    compared = (*rule.needs, *rule.beside)
    if any(column == one or column.startswith(f"{one}_") for column in doubted for one in compared):
        return False
    has_all = all(one == "t" or view.log.has(_GROUPS.get(one, one)) for one in rule.needs)
    return has_all and all(getattr(view, one) for one in rule.when)


def rules_table() -> list[dict[str, str]]:
    """The rules as rows of a table."""
    return [{"Rule": rule.name} | rule.explained for rule in RULES]
