"""What to know about a log, beside what is implausible in it, before its estimates are believed."""

import numpy as np

from surefoot.estimator.initial import start_of, starts_in_motion
from surefoot.models.observer.observer import log_digest
from surefoot.scenarios.estimate.contract import Learnt
from surefoot.scenarios.estimate.run import feet_of
from surefoot.scenarios.estimate.settings import FilterSettings
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot
from surefoot.sim.robot.feet import Feet
from surefoot.sim.robot.machine import machine_for_log

STARTS = {
    "reference": "the reference",
    "rest": "gravity, as if at rest",
    "moving": "gravity and legs over the first second",
}
"""What a first state is taken from, in words."""


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
    own = log.meta.robot
    if robot is None or not own or own == robot.name:
        return ""
    return f"robot: the log is of {own}, but estimated as {robot.name}; filters trust its legs"


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
