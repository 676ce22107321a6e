"""The rules of plausibility, in the order in which they are checked.

A rule is checked only where no earlier rule doubts what it compares. One fault therefore gives one
finding, and a second fault of a log may show only when the first is corrected. Rules that compare
fewer columns come before those that compare more, and rules that find a symptom of several causes
last. Notes put nothing in doubt.
"""

from operator import attrgetter

from surefoot.sim.log import Log
from surefoot.sim.plausibility import (
    clock,
    contacts,
    drives,
    imu,
    joints,
    legs,
    loads,
    noise,
    place,
    reference,
    streams,
)
from surefoot.sim.plausibility.finding import Finding, Rule
from surefoot.sim.plausibility.view import LogView
from surefoot.sim.robot.machine import Machine

_FILES = clock, joints, streams, noise, reference, imu, place, contacts, legs, loads, drives
"""In the order in which rules of equal place are checked: the readings of a reference's attitudes
come before those of the gyro, since more can be wrong with them.
"""
RULES = tuple(
    sorted(
        (one for file in _FILES for one in vars(file).values() if isinstance(one, Rule)),
        key=attrgetter("place"),
    )
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
        if rule.finds != "note":
            doubted.update(*(one.streams for one in new))
    return tuple(found)


def rules_table() -> list[dict[str, str]]:
    """The rules as rows of a table."""
    return [{"Rule": rule.name} | rule.explained for rule in RULES]
