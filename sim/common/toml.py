"""TOML files as typed data: frozen dataclasses whose annotations are the schema.

A field without a default is required; an unknown key is an error. Ranges are part of the annotation
(`Annotated[float, msgspec.Meta(gt=0)]`, or aliases such as `Positive`), choices are a `Literal`.
Conditions on several keys are checked in the dataclass's `__post_init__`, which raises
SurefootError. The optional `OTHER_WORDS` maps likely wrong keys to the correct ones.
"""

import re
import reprlib
import tomllib
from dataclasses import MISSING, fields, is_dataclass
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import msgspec
import numpy as np

from surefoot.sim.common.errors import (
    LARGEST_WHOLE,
    SurefootError,
    did_you_mean,
    errors_in,
    shortened,
)
from surefoot.sim.common.limits import bounded_text, check_limit, check_toml_keys

T = TypeVar("T")
Positive = Annotated[float, msgspec.Meta(gt=0)]
NonNegative = Annotated[float, msgspec.Meta(ge=0)]
SLOWEST_RATE = 0.01
"""Rate below which stamps must be in another unit [Hz]: 20 Hz in ms reads as 0.02, in us as 2e-5.
"""
SampleRate = Annotated[float, msgspec.Meta(ge=SLOWEST_RATE, le=1e6)]
"""Hz. A million is beyond any sensor of a robot."""
Level = Annotated[float, msgspec.Meta(gt=0, lt=1)]
Count = Annotated[int, msgspec.Meta(ge=1, le=LARGEST_WHOLE)]
Name = Annotated[str, msgspec.Meta(min_length=1, max_length=1000)]
_DEVICE = r"(?i:con|prn|aux|nul|com\d|lpt\d)(\.|$)"
FileName = Annotated[str, msgspec.Meta(pattern=rf"^(?!{_DEVICE})\w[\w .+=(),-]{{0,99}}$")]
"""A name that becomes part of a file name: letters, digits and a few signs, and none that Windows
reserves for a device.
"""
Seed = Annotated[int, msgspec.Meta(ge=0, le=LARGEST_WHOLE)]

_Place = tuple[str | int, ...]  # keys, and the indices of tables in their arrays
_WORDS = {
    "float": "a number",
    "int": "a whole number",
    "str": "a string",
    "bool": "true or false",
    "array": "an array",
    "object": "a table",
}


def read_toml(path: str | Path, what: str = "") -> dict[str, Any]:
    """Read the tables of a TOML file. Raises SurefootError in one line that starts with `what` and
    the path.
    """
    name = f"{what} {path}".lstrip()
    text = bounded_text(path, what)
    try:
        check_toml_keys(text)
        return tomllib.loads(text)
    except RecursionError:
        raise SurefootError(f"{name}: not valid TOML: nested too deeply") from None
    except ValueError as error:  # of TOML, of a key, or of digits beyond what Python converts
        raise SurefootError(f"{name}: not valid TOML: {' '.join(str(error).split())}") from None


def read_typed(path: str | Path, kind: type[T], what: str = "") -> T:
    """Read a TOML file as an instance of `kind`: a dataclass, or a dict of them by name.

    Raises SurefootError, in one line that starts with `what` and the path and names section and
    key, for a missing file, an unknown or missing key, and a value of the wrong type or out of
    range.
    """
    table = read_toml(path, what)
    with errors_in(f"{what} {path}".lstrip()):
        return typed(table, kind)


def typed(table: dict[str, Any], kind: type[T]) -> T:
    """Convert tables to an instance of `kind`. Raises SurefootError as `read_typed` does."""
    return _typed(table, kind, ())


def _typed(value: Any, kind: Any, place: _Place) -> Any:
    arms = get_args(kind) if get_origin(kind) in (UnionType, Union) else (kind,)
    for arm in arms:
        inner = get_args(arm)
        if isinstance(value, dict) and is_dataclass(arm):
            return _dataclass(value, arm, place)
        if isinstance(value, dict) and get_origin(arm) is dict:
            return {name: _typed(item, inner[1], (*place, name)) for name, item in value.items()}
        if isinstance(value, list) and get_origin(arm) is tuple and inner[1:] == (...,):
            check_limit("items", len(value), f"{_key(place)} has too many entries")
            return tuple(
                _typed(item, inner[0], _element(place, index, item))
                for index, item in enumerate(value)
            )
    return _leaf(value, kind, arms, place)


def _dataclass(table: dict[str, Any], kind: Any, place: _Place) -> Any:
    hints = get_type_hints(kind, include_extras=True)
    # A field of an array is drawn or computed later: no key of the file.
    known = [field for field in fields(kind) if np.ndarray not in get_args(hints[field.name])]
    names = [field.name for field in known]
    for name in table:
        if name not in names:
            meant = getattr(kind, "OTHER_WORDS", {}).get(name)
            hint = f"; did you mean {meant}?" if meant else did_you_mean(name, names)
            raise SurefootError(
                f"{_section(place)}unknown key '{name}'; known: {', '.join(names)}{hint}"
            )
    for field in known:
        required = field.default is MISSING and field.default_factory is MISSING
        if required and field.name not in table:
            raise SurefootError(f"{_section(place)}{field.name} is missing")
    values = {name: _typed(item, hints[name], (*place, name)) for name, item in table.items()}
    try:
        return kind(**values)
    except SurefootError as error:
        raise SurefootError(f"{_section(place)}{error}") from None


def _leaf(value: Any, kind: Any, arms: tuple[Any, ...], place: _Place) -> Any:
    """Convert a number, a string, a choice, or an array of fixed length."""
    try:
        found = msgspec.convert(value, kind)
    except msgspec.ValidationError as error:
        expected = _expected(str(error), arms)
        raise SurefootError(f"{_key(place)} must be {expected}, is {_shown(value)}") from None
    # TOML allows NaN and infinity, which no key accepts.
    if any(isinstance(v, float) and not np.isfinite(v) for v in np.atleast_1d(found)):
        raise SurefootError(f"{_key(place)} must be a number, is {_shown(value)}")
    return found


def _shown(value: Any) -> str:
    """A value for an error message, shortened in the middle if it is long."""
    if isinstance(value, int) and abs(value) >= 2**63:
        return f"a number of {value.bit_length()} bits"
    return reprlib.repr(value) if isinstance(value, list | dict) else shortened(repr(value))


def _expected(error: str, arms: tuple[Any, ...]) -> str:
    """The expected type according to msgspec's error, in the terms of TOML; the choices of a
    literal.
    """
    choices = [str(c) for arm in arms if get_origin(arm) is Literal for c in get_args(arm)]
    if choices:
        return f"one of {', '.join(choices)}"
    if "out of range" in error:
        return "a number of fewer digits"
    if "regex" in error:
        return "a name of 1 to 100 letters, digits, spaces or . _ + = ( ) , - and no path"
    types, limit = re.findall(r"`([^`]*)`([^,`]*)", error)[0]
    names = [str(_WORDS.get(name, name)) for name in types.split(" | ") if name != "null"]
    if any(get_origin(arm) is tuple and is_dataclass(get_args(arm)[0]) for arm in arms):
        names[-1] = "an array of tables"
    return " or ".join(names) + limit.removesuffix(" - at ")


def _element(place: _Place, index: int, item: Any) -> _Place:
    if isinstance(item, dict):
        return (*place, index)
    return (*place[:-1], f"{place[-1]}[{index}]")


def _section(place: _Place) -> str:
    """A table's name as in the file, `[a.b] `; for an array of tables, `[[a.b]] 2 `."""
    text, names = "", []
    for step in place:
        if isinstance(step, int):
            text, names = f"{text}[[{'.'.join(names)}]] {step + 1} ", []
        else:
            names.append(step)
    return text + (f"[{'.'.join(names)}] " if names else "")


def _key(place: _Place) -> str:
    """A key's name after that of its section."""
    if not place or isinstance(place[-1], int):
        return _section(place).rstrip() or "the file"
    return f"{_section(place[:-1])}{place[-1]}"
