"""Options shared by several commands."""

import json
import math
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from types import NoneType
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    TypeVar,
    dataclass_transform,
    get_args,
    get_origin,
    get_type_hints,
)

from tyro.conf import Positional, UseAppendAction, arg
from tyro.extras import literal_type_from_choices

from surefoot.sim.common.errors import SurefootError

if TYPE_CHECKING:
    from surefoot.sim.log import Log

C = TypeVar("C")

OPTIONAL = "(optional)"
NEEDED = "(required)"
"""Texts of --help for optional options and for lists that must not be empty, instead of tyro's
`(default: None)` and `(default: )`.
"""
FLAG = ""
"""Text of --help for a flag, instead of tyro's `(default: False)`."""

Logs = Annotated[Positional[tuple[Path, ...]], arg(metavar="LOG...", help_behavior_hint=NEEDED)]
Force = Annotated[
    bool, arg(help="Replace what an earlier run of this command wrote.", help_behavior_hint=FLAG)
]
RobotName = Annotated[
    str | None,
    arg(
        help="Name of the robot, or its file (MJCF or URDF); by default the one named in the log.",
        metavar="NAME|FILE",
        help_behavior_hint=OPTIONAL,
    ),
]
Declared = Annotated[
    Path | None,
    arg(
        help="File of effects (TOML, such as the effects.toml of an earlier trace) to include in "
        "the model, so that only what has changed since is found. Encoder zeros, sensor biases and "
        "the reference's clock are fitted to each log.",
        metavar="PATH",
        help_behavior_hint=OPTIONAL,
    ),
]
Holdout = Annotated[
    tuple[Path, ...],
    arg(
        help="Further logs of the same robot, used by no fit, on which the result is checked.",
        metavar="LOG...",
        help_behavior_hint=OPTIONAL,
    ),
]
Observers = Annotated[
    UseAppendAction[tuple[Path, ...]],
    arg(
        help="Observer, a file from `train`; give one trained with --loss mse, one with gml, or "
        "both."
    ),
]
BoundsFiles = Annotated[
    UseAppendAction[tuple[Path, ...]],
    arg(help="Bounds (JSON), a file from `calibrate`, of an observer that is also given."),
]
SettingsFile = Annotated[
    Path | None,
    arg(
        help="File of sensor noise, initial state and its standard deviations for the filters "
        "(TOML), such as `noise` writes.",
        metavar="PATH",
        help_behavior_hint=OPTIONAL,
    ),
]
SettingLines = Annotated[
    UseAppendAction[tuple[str, ...]],
    arg(
        name="set",
        help="One setting as in the file of --settings, which it overrides, such as "
        "noise.gyro=1e-3 [rad/s/sqrt(Hz)].",
        metavar="KEY=VALUE",
    ),
]
Json = Annotated[bool, arg(name="json", help="Print the results as JSON.", help_behavior_hint=FLAG)]
Strict = Annotated[
    bool,
    arg(
        help="Stop with an error, instead of a warning, if a log contains implausible values.",
        help_behavior_hint=FLAG,
    ),
]
_METAVARS = {
    "seeds": "SEEDS",
    "cluster": "ADDRESS",
    "report": "DIR",
    "device": "DEVICE",
} | dict.fromkeys(("robot", "map", "walker"), "NAME|FILE")


@dataclass_transform(frozen_default=True, kw_only_default=True)
def command(kind: type[C]) -> type[C]:
    """A dataclass of options, its inherited ones included, with what --help shows of plain types:
    metavars, and `(optional)` for what may be None. `out` is also `-o`.
    """
    made: Any = dataclass(frozen=True, kw_only=True)(kind)
    hints = get_type_hints(made, include_extras=True)
    made.__annotations__ = {f.name: _shown(f.name, hints[f.name]) for f in fields(made)}
    return made


def _shown(name: str, kind: Any) -> Any:
    if get_origin(kind) is Annotated:
        return kind
    short: dict[str, Any] = {"aliases": ["-o"]} if name == "out" else {}
    if kind is bool:
        return Annotated[bool, arg(help_behavior_hint=FLAG, **short)]
    if NoneType in get_args(kind):
        given = next(one for one in get_args(kind) if one is not NoneType)
        # Otherwise tyro would print `{None}|PATH`.
        metavar = _METAVARS.get(name, given.__name__.upper())
        return Annotated[kind, arg(metavar=metavar, help_behavior_hint=OPTIONAL, **short)]
    if name in _METAVARS:
        short["metavar"] = _METAVARS[name]
    return Annotated[kind, arg(**short)] if short else kind


def one_of(names: Iterable[str]) -> Any:
    """Type of an option that is one of these names, such as a Registry's; --help lists them."""
    return literal_type_from_choices(tuple(names))


def read_logs(paths: tuple[Path, ...], robot: str | None = None) -> list:
    """Read the logs of these files, assigned to `robot` if that is given.

    Raises SurefootError where one is bad.
    """
    from surefoot.sim.log import Log
    from surefoot.sim.robot.model_of_log import of_robot

    return [of_robot(Log.read(path), robot) for path in paths]


def not_plausible(
    logs: Sequence["Log"], robot: str | Path | None = None, strict: bool = False
) -> dict[str, tuple[str, ...]]:
    """Check the logs' plausibility: findings, as lines, by name of the log; also printed to stderr.

    `robot` is the logs' own by default. Raises SurefootError if there are any and `strict` is set.
    """
    from surefoot.sim.plausibility import check_log
    from surefoot.sim.robot.machine import machine_for_log

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
        what = "finding" if count == 1 else "findings"
        raise SurefootError(f"--strict: {count} implausible {what} in {', '.join(found)}")
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
