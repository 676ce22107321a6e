"""Read and check the files that settings name."""

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from surefoot.models.calibration.bounds import Bounds
from surefoot.models.observer.observer import Observer
from surefoot.scenarios.estimate.contract import Learnt
from surefoot.scenarios.estimate.run import declared_model
from surefoot.sim.common.errors import SurefootError, errors_in
from surefoot.sim.effects.file import load_effects
from surefoot.sim.log import Log
from surefoot.sim.plausibility import check_log
from surefoot.sim.plausibility.finding import Finding
from surefoot.sim.robot import Robot
from surefoot.sim.robot.catalog import of_robot
from surefoot.sim.robot.machine import machine_for_log


def read_logs(paths: Sequence[Path], robot: str | None = None) -> list[Log]:
    """Read the logs of these files, assigned to `robot` if that is given.

    Raises SurefootError where one is bad.
    """
    return [of_robot(Log.read(path), robot) for path in paths]


def not_plausible(
    logs: Sequence[Log], robot: str | Path | None = None, strict: bool = False
) -> list[tuple[str, ...]]:
    """Check the logs' plausibility: lines on the findings of each; also printed to stderr.

    `robot` is the logs' own by default. Raises SurefootError if there are any and `strict` is set.
    """
    return warned([(log.name, findings_of(log, robot)) for log in logs], strict)


def findings_of(log: Log, robot: str | Path | None = None) -> tuple[Finding, ...]:
    """What is implausible in a log of `robot`, by default its own."""
    try:
        machine = machine_for_log(log, robot)
    except SurefootError:  # whoever needs the robot says why there is none
        machine = None
    return check_log(log, machine)


def warned(
    findings: Sequence[tuple[str, Sequence[Finding]]], strict: bool = False
) -> list[tuple[str, ...]]:
    """Print the findings of each log, after its name, to stderr; returns their lines. Raises as
    `not_plausible`.
    """
    for name, every in findings:
        for one in every:
            print(f"{'error' if strict else 'warning'}: {name}: {one.line}", file=sys.stderr)
    count = sum(len(every) for _, every in findings)
    if strict and count:
        what = "finding" if count == 1 else "findings"
        names = ", ".join(name for name, every in findings if every)
        raise SurefootError(f"strict: {count} implausible {what} in {names}")
    return [tuple(one.line for one in every) for _, every in findings]


def with_effects(log: Log, robot: Robot | None, file: Path | None) -> Log:
    """The log, declaring the effects of a file too: `declared_model` then compensates them.

    Raises SurefootError, naming the file, where it is bad, where the robot has no such part, and
    where the log declares one of the effects itself.
    """
    if file is None:
        return log
    effects = load_effects(file)
    with errors_in(f"effects {file}"):
        limbs = (robot or machine_for_log(log)).limbs
        own = {(one["name"], one["target"]) for one in log.meta.effects}
        for one in effects:
            one.members(limbs)
            if (one.name, one.target) in own:
                raise SurefootError(f"{log.name} declares {one.name} of {one.target} itself")
    declared = (*log.meta.effects, *(one.as_dict() for one in effects))
    return replace(log, meta=replace(log.meta, effects=declared))


def as_declared(logs: Sequence[Log]) -> list[Log]:
    """The logs with their declared effects compensated, as the filters see them."""
    return [declared_model(log, Robot.for_log(log))[0] for log in logs]


def learnt_from(observers: Sequence[Path], bounds: Sequence[Path]) -> Learnt:
    """Load these observers and bounds."""
    return Learnt(
        tuple(Observer.load(path) for path in observers),
        tuple(Bounds.load(path) for path in bounds),
    )
