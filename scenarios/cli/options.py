"""Options shared by several commands."""

import json
import math
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tyro.conf import Positional, UseAppendAction, arg
from tyro.extras import literal_type_from_choices

from surefoot.sim.common.errors import SurefootError

if TYPE_CHECKING:
    from surefoot.sim.log import Log

OPTIONAL = "(optional)"
NEEDED = "(required)"
"""Texts of --help for optional options and for lists that must not be empty, instead of tyro's
`(default: None)` and `(default: )`.
"""

Logs = Annotated[Positional[tuple[Path, ...]], arg(metavar="LOG...", help_behavior_hint=NEEDED)]
# Each has a metavar, since tyro would print `{None}|PATH`.
OptionalPath = Annotated[Path | None, arg(metavar="PATH", help_behavior_hint=OPTIONAL)]
OptionalOut = Annotated[
    Path | None, arg(aliases=["-o"], metavar="PATH", help_behavior_hint=OPTIONAL)
]
OptionalNamed = Annotated[str | None, arg(metavar="NAME|FILE", help_behavior_hint=OPTIONAL)]
OptionalSeeds = Annotated[str | None, arg(metavar="SEEDS", help_behavior_hint=OPTIONAL)]
OptionalInt = Annotated[int | None, arg(metavar="INT", help_behavior_hint=OPTIONAL)]
OptionalFloat = Annotated[float | None, arg(metavar="FLOAT", help_behavior_hint=OPTIONAL)]
Out = Annotated[Path, arg(aliases=["-o"])]
Force = Annotated[bool, arg(help="Replace what an earlier run of this command wrote.")]
RobotName = Annotated[
    str | None,
    arg(
        help="Name of the robot, or its MJCF or URDF; the log's own where left out.",
        metavar="NAME|FILE",
        help_behavior_hint=OPTIONAL,
    ),
]
Declared = Annotated[
    Path | None,
    arg(
        help="Effects (TOML, such as a trace's effects.toml) that belong to the model: what is "
        "traced is what has changed since. Zeros and clocks are then the log's own.",
        metavar="PATH",
        help_behavior_hint=OPTIONAL,
    ),
]
Holdout = Annotated[
    tuple[Path, ...],
    arg(
        help="Logs of the same machine that no fit sees and that judge what was found.",
        metavar="LOG...",
        help_behavior_hint=OPTIONAL,
    ),
]
Observers = Annotated[
    UseAppendAction[tuple[Path, ...]],
    arg(help="An observer; may be given twice, once trained with mse and once with gml."),
]
BoundsFiles = Annotated[
    UseAppendAction[tuple[Path, ...]], arg(help="Bounds; each belongs to one observer.")
]
SettingsFile = Annotated[
    Path | None,
    arg(
        help="Noise, priors and start of the filters (TOML), as `noise` writes it.",
        metavar="PATH",
        help_behavior_hint=OPTIONAL,
    ),
]
SettingLines = Annotated[
    UseAppendAction[tuple[str, ...]],
    arg(name="set", help="A line of such a file, as noise.gyro=1e-3; may be given several times."),
]
Workers = Annotated[int, arg(help="Number of processes on this machine.")]
Json = Annotated[bool, arg(name="json", help="Print the results as JSON.")]
Strict = Annotated[
    bool, arg(help="Stop where a log's numbers are not plausible, instead of warning.")
]
Cluster = Annotated[
    str | None,
    arg(
        help="Address of a Dask scheduler to run on, such as tcp://127.0.0.1:8786.",
        metavar="ADDRESS",
        help_behavior_hint=OPTIONAL,
    ),
]


def one_of(names: Iterable[str]) -> Any:
    """Type of an option that is one of these names, such as a Registry's; --help lists them."""
    return literal_type_from_choices(tuple(names))


def read_logs(paths: tuple[Path, ...], robot: str | None = None) -> list:
    """Read the logs of these files, assigned to `robot` if that is given.

    Raises SurefootError where none is given or one is bad.
    """
    from surefoot.sim.log import Log
    from surefoot.sim.robot.model_of_log import of_robot

    if not paths:
        raise SurefootError("give at least one log")
    return [of_robot(Log.read(path), robot) for path in paths]


def not_plausible(
    logs: Sequence["Log"], robot: str | Path | None = None, strict: bool = False
) -> dict[str, tuple[str, ...]]:
    """Check the logs' plausibility: findings, as lines, by name of the log; also printed to stderr.

    `robot` is the logs' own by default. Raises SurefootError if there are any and `strict` is set.
    """
    from surefoot.sim.plausibility import check_log
    from surefoot.sim.robot.fixed_base import machine_for_log

    found: dict[str, tuple[str, ...]] = {}
    for log in logs:
        try:
            machine = machine_for_log(log, robot)
        except SurefootError:  # whoever needs the robot says why there is none
            machine = None
        if lines := tuple(one.line for one in check_log(log, machine)):
            found[log.name] = lines
        for line in lines:
            print(f"{'error' if strict else 'warning'}: {log.name}: {line}", file=sys.stderr)
    if strict and found:
        count = sum(map(len, found.values()))
        raise SurefootError(f"--strict: {count} things in {', '.join(found)} are not plausible")
    return found


def as_declared(logs: Sequence["Log"]) -> list:
    """The logs with their declared effects compensated, as the filters see them."""
    from surefoot.scenarios.estimate.run import declared_model
    from surefoot.sim.robot import Robot

    return [declared_model(log, Robot.for_log(log))[0] for log in logs]


def learnt_from(observers: tuple[Path, ...], bounds: tuple[Path, ...]):
    """Load these observers and bounds as `scenarios.estimate.contract.Learnt`."""
    from surefoot.scenarios.estimate.contract import Learnt

    if not (observers or bounds):
        return Learnt()
    # Only learnt filters need torch, which is an extra.
    from surefoot.models.calibration.bounds import Bounds
    from surefoot.models.observer.observer import Observer

    return Learnt(
        tuple(Observer.load(path) for path in observers),
        tuple(Bounds.load(path) for path in bounds),
    )


def print_json(value: Any) -> None:
    """Print as JSON: non-finite values as null, arrays as lists, files as names."""
    print(json.dumps(_plain(value), indent=2))


def _plain(value: Any) -> Any:
    if is_dataclass(value) and not isinstance(value, type):
        value = {field.name: getattr(value, field.name) for field in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): _plain(one) for key, one in value.items()}
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [_plain(one) for one in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if isinstance(value, str | int | None) else str(value)
