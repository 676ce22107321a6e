"""How options and their values are shown, and options that commands share."""

import json
from collections.abc import Iterable
from dataclasses import MISSING, Field, dataclass, fields
from types import NoneType
from typing import (
    Annotated,
    Any,
    TypeVar,
    dataclass_transform,
    get_args,
    get_origin,
    get_type_hints,
)

from tyro.conf import Positional, UseAppendAction, arg
from tyro.constructors import PrimitiveConstructorSpec
from tyro.extras import literal_type_from_choices

from surefoot.sim.common.files import plain_json

C = TypeVar("C")

OPTIONAL = "(optional)"
NEEDED = "(required)"
"""Texts of --help for optional options and for lists that must not be empty, instead of tyro's
`(default: None)` and `(default: )`.
"""
FLAG = ""
"""Text of --help for a flag, instead of tyro's `(default: False)`."""
BY_NAME = ("out", "filter", "robot")
"""Required options that are given by name; every other one is positional."""
REPEATED = ("observer", "bounds", "set")
"""Lists that are given one by one, each with the option's name."""
_METAVARS = {
    "seeds": "SEEDS",
    "cluster": "ADDRESS",
    "report": "DIR",
    "device": "DEVICE",
    "set": "KEY=VALUE",
    "filter": "NAME",
    "filters": "NAME,NAME",
    "start": "reference|rest|moving",
} | dict.fromkeys(("robot", "map", "walker"), "NAME|FILE")

_BY_COMMAS = PrimitiveConstructorSpec(
    nargs=1,
    metavar=_METAVARS["filters"],
    instance_from_str=lambda given: tuple(
        filter(None, dict.fromkeys(given[0].replace(" ", "").split(",")))
    ),
    is_instance=lambda value: isinstance(value, tuple),
    str_from_instance=lambda value: [",".join(value)],
)


@dataclass(frozen=True, kw_only=True)
class JsonOption:
    """How results are printed."""

    json: bool = False
    """Print the results as JSON."""


@dataclass(frozen=True, kw_only=True)
class TableOption(JsonOption):
    """How tables are printed."""

    wide: bool = False
    """Print every column of a table; by default those that fit into 100 characters."""


@dataclass_transform(frozen_default=True, kw_only_default=True)
def command(kind: type[C]) -> type[C]:
    """A dataclass of options, its inherited ones included, with what --help shows of plain types:
    metavars, `(optional)` for what may be None, and which are positional. `out` is also `-o`.
    """
    made: Any = dataclass(frozen=True, kw_only=True)(kind)
    hints = get_type_hints(made, include_extras=True)
    made.__annotations__ = {f.name: _shown(f, hints[f.name]) for f in fields(made)}
    return made


def _shown(field: Field, kind: Any) -> Any:
    if get_origin(kind) is Annotated:
        return kind
    name, several = field.name, get_origin(kind) is tuple
    shown: dict[str, Any] = {"metavar": _METAVARS[name]} if name in _METAVARS else {}
    if name == "out":
        shown["aliases"] = ["-o"]
    if kind is bool:
        shown["help_behavior_hint"] = FLAG
    elif field.default is MISSING and name not in BY_NAME:
        kind = Positional[kind]
        shown["metavar"] = f"{name.removesuffix('s').upper()}..." if several else name.upper()
        if several:
            shown["help_behavior_hint"] = NEEDED
    elif name == "filters":
        kind = Annotated[kind, _BY_COMMAS]
        shown["help_behavior_hint"] = OPTIONAL
    elif name in REPEATED and several:
        kind = UseAppendAction[kind]
    elif several:
        shown |= {"metavar": "LOG...", "help_behavior_hint": OPTIONAL}
    elif NoneType in get_args(kind):
        given = next(one for one in get_args(kind) if one is not NoneType)
        # Otherwise tyro would print `{None}|PATH`.
        shown = {"metavar": given.__name__.upper(), "help_behavior_hint": OPTIONAL} | shown
    return Annotated[kind, arg(**shown)] if shown else kind


def one_of(names: Iterable[str]) -> Any:
    """Type of an option that is one of these names, such as a Registry's; --help lists them."""
    return literal_type_from_choices(tuple(names))


def print_json(value: Any) -> None:
    """Print as JSON: non-finite values as null, arrays as lists, files as names."""
    print(json.dumps(plain_json(value), indent=2))
