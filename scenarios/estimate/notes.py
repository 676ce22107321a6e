"""What to know about a log, beside what is implausible in it, before its estimates are believed."""

import numpy as np

from surefoot.estimator.initial import start_of
from surefoot.scenarios.estimate.contract import Learnt
from surefoot.scenarios.estimate.run import feet_of
from surefoot.scenarios.estimate.settings import FilterSettings
from surefoot.sim.importing.start import start_line
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot

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
    lines = (_other_robot(log, robot), _trained_on(log, learnt), _start(log, robot, settings))
    return tuple(filter(None, lines))


def _other_robot(log: Log, robot: Robot | None) -> str:
    own = log.meta.robot
    if robot is None or not own or own == robot.name:
        return ""
    return f"robot: the log is of {own}, but estimated as {robot.name}; filters trust its legs"


def _trained_on(log: Log, learnt: Learnt) -> str:
    if not learnt.observers:
        return ""
    from surefoot.models.observer.observer import log_digest

    digest = log_digest(log)
    losses = [one.loss for one in learnt.observers if digest in {x.sha256 for x in one.logs}]
    if not losses:
        return ""
    which = " and ".join(f"the {loss} observer" for loss in losses)
    return f"training: {which} was trained on this log; errors on a log it has not seen are larger"


def _start(log: Log, robot: Robot | None, settings: FilterSettings) -> str:
    given = settings.start.velocity is not None or settings.state.v_GI is not None
    if given or not start_line(log):
        return ""
    state, covariance = settings.beginning(log, feet_of(log, robot))
    std = np.sqrt(covariance.diagonal())
    taken = STARTS[settings.start.kind or start_of(log)]
    taken = taken if state.v_GI.any() else taken.replace(" and legs", "")
    return (
        f"start: the robot moves already in the first rows; filters start from {taken}, at "
        f"{np.linalg.norm(state.v_GI):.2f} ± {std[3]:.2f} m/s, with a gyro bias known to "
        f"{np.degrees(std[12]):.1g} deg/s; begin the log where it stands, if you can"
    )
