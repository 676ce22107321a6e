"""Read and check the files that settings name; say what to know of a log before its estimates are
believed.
"""

import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from surefoot.estimator.initial import start_of, starts_in_motion
from surefoot.models.calibration.bounds import Bounds
from surefoot.models.observer.observer import Observer, log_digest
from surefoot.scenarios.estimate.contract import Learnt
from surefoot.scenarios.estimate.run import declared_model, feet_of
from surefoot.scenarios.estimate.settings import FilterSettings
from surefoot.sim.common.errors import SurefootError, errors_in
from surefoot.sim.effects.file import load_effects
from surefoot.sim.log import Log
from surefoot.sim.plausibility import check_log
from surefoot.sim.plausibility.finding import Finding
from surefoot.sim.robot import Robot
from surefoot.sim.robot.catalog import of_robot
from surefoot.sim.robot.feet import Feet
from surefoot.sim.robot.machine import machine_for_log

STARTS = {
    "reference": "the reference",
    "rest": "gravity, as if at rest",
    "moving": "gravity and legs over the first second",
}
"""What a first state is taken from, in words."""


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
        known = {(one["name"], one["target"]) for one in log.meta.effects}
        for one in effects:
            one.members(limbs)
            if (one.name, one.target) in known:
                raise SurefootError(f"{log.name} declares {one.name} of {one.target} itself")
    declared = (*log.meta.effects, *(one.as_dict() for one in effects))
    return replace(log, meta=replace(log.meta, effects=declared))


def as_declared(logs: Iterable[Log]) -> Iterator[Log]:
    """The logs with their declared effects compensated, as the filters see them."""
    return (declared_model(log, Robot.for_log(log))[0] for log in logs)


def learnt_from(observers: Sequence[Path], bounds: Sequence[Path]) -> Learnt:
    """Load these observers and bounds."""
    return Learnt(
        tuple(Observer.load(path) for path in observers),
        tuple(Bounds.load(path) for path in bounds),
    )


def notes_on(
    log: Log, robot: Robot | None, learnt: Learnt, settings: FilterSettings
) -> tuple[str, ...]:
    """Lines that say whether a log is of another robot, was used in training, or starts in motion.

    Args:
        log: as the filters see it, with its declared effects compensated.
        robot: as which it is estimated.
        learnt: observers that its filters use.
        settings: of the filters.
    """
    start = _start(log, feet_of(log, robot), settings)
    lines = (_other_robot(log, robot), _trained_on(log, learnt), start)
    return tuple(filter(None, lines))


def start_note(log: Log) -> str:
    """From what filters start on a log whose robot already moves in its first rows; "" if it rests,
    and without an IMU.
    """
    try:
        feet = machine_for_log(log).feet
    except SurefootError:  # without a known robot, its legs show nothing
        feet = None
    try:
        return _start(log, feet, FilterSettings())
    except SurefootError as error:
        return f"start: the robot moves already in the first rows; {error}"


def _other_robot(log: Log, robot: Robot | None) -> str:
    named = log.meta.robot
    # Imported logs of 0.1.0 name the robot's file.
    if robot is None or not named or Path(named).name in (robot.name, robot.file.name):
        return ""
    return f"robot: the log is of {named}, but estimated as {robot.name}; filters trust its legs"


def _trained_on(log: Log, learnt: Learnt) -> str:
    if not learnt.observers:
        return ""
    digest = log_digest(log)
    losses = [one.loss for one in learnt.observers if digest in {x.sha256 for x in one.logs}]
    if not losses:
        return ""
    which = " and ".join(f"the {loss} observer" for loss in losses)
    return f"training: {which} was trained on this log; errors on a log it has not seen are larger"


def _start(log: Log, feet: Feet | None, settings: FilterSettings) -> str:
    given = settings.start.velocity is not None or settings.state.v_GI is not None
    if given or not starts_in_motion(log):
        return ""
    state, covariance = settings.beginning(log, feet)
    std = np.sqrt(covariance.diagonal())
    taken = STARTS[settings.start.kind or start_of(log)]
    taken = taken if state.v_GI.any() else taken.replace(" and legs", "")
    return (
        f"start: the robot moves already in the first rows; filters start from {taken}, at "
        f"{np.linalg.norm(state.v_GI):.2f} ± {std[3]:.2f} m/s, with a gyro bias known to "
        f"{np.degrees(std[12]):.1g} deg/s; begin the log where it stands, if you can"
    )
