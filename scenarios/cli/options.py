"""What several commands of the command line share."""

from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from surefoot.sim.common.errors import SurefootError

Out = Annotated[Path, arg(aliases=["-o"])]


def read_logs(paths: tuple[Path, ...]) -> list:
    """The logs of these files. Raises SurefootError where none is given or one is bad."""
    from surefoot.sim.log import Log

    if not paths:
        raise SurefootError("give at least one log")
    return [Log.read(path) for path in paths]


def read_as_declared(paths: tuple[Path, ...]) -> list:
    """The logs as the filters see them: the effects that they declare undone."""
    from surefoot.scenarios.estimate.registry import declared_model
    from surefoot.sim.robot import Robot

    return [declared_model(log, Robot.for_log(log))[0] for log in read_logs(paths)]


def learnt_from(observers: tuple[Path, ...], bounds: tuple[Path, ...]):
    """The observers and bounds of these files, as `scenarios.estimate.registry.Learnt`."""
    from surefoot.models.calibration.bounds import Bounds
    from surefoot.models.observer.observer import Observer
    from surefoot.scenarios.estimate.registry import Learnt

    return Learnt(
        tuple(Observer.load(path) for path in observers),
        tuple(Bounds.load(path) for path in bounds),
    )
