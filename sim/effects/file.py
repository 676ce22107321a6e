"""Files of effects: TOML with one [[effect]] of name, target, value and unit each."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.files import whole_file
from surefoot.sim.common.toml import read_toml
from surefoot.sim.effects.catalogue import CATALOGUE, Effect, effect

KEYS = ("name", "target", "value", "unit")


def load_effects(path: str | Path) -> tuple[Effect, ...]:
    """The effects of a file. Raises SurefootError, one line with file, entry and key, if bad."""
    path = Path(path)
    table = read_toml(path, "effects")
    unknown = sorted(set(table) - {"effect"})
    if unknown:
        raise SurefootError(f"effects {path}: unknown key '{unknown[0]}'; known: effect")
    entries = table.get("effect", [])
    if not isinstance(entries, list) or not all(isinstance(e, dict) for e in entries):
        raise SurefootError(f"effects {path}: effects are written as [[effect]] tables")
    effects: list[Effect] = []
    for number, entry in enumerate(entries, 1):
        try:
            one = _effect(entry)
            if any((e.name, e.target) == (one.name, one.target) for e in effects):
                raise SurefootError(f"{one.name} of {one.target} is there twice")
        except SurefootError as error:
            raise SurefootError(f"effects {path}: [[effect]] {number}: {error}") from None
        effects.append(one)
    return tuple(effects)


def save_effects(path: str | Path, effects: Sequence[Effect], force: bool = False) -> None:
    """Write the effects so that `load_effects` gives them back, value for value."""
    with whole_file(path, force) as temporary:
        temporary.write_text(to_toml(effects), encoding="utf-8")


def to_toml(effects: Sequence[Effect]) -> str:
    """The text of an effects file; one without effects says so in a comment."""
    if not effects:
        return "# no effects\n"
    return "\n".join(
        f'[[effect]]\nname = "{e.name}"\ntarget = "{e.target}"\n'
        f'value = {float(e.value)!r}\nunit = "{e.unit}"\n'
        for e in effects
    )


def _effect(entry: dict[str, Any]) -> Effect:
    unknown = sorted(set(entry) - set(KEYS))
    if unknown:
        raise SurefootError(f"unknown key '{unknown[0]}'; known: {', '.join(KEYS)}")
    missing = [key for key in KEYS if key not in entry]
    if missing:
        raise SurefootError(f"needs {missing[0]}")
    value = entry["value"]
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise SurefootError(f"value must be a number, is {value!r}")
    for key in ("name", "target", "unit"):
        if not isinstance(entry[key], str):
            raise SurefootError(f"{key} must be a string, is {entry[key]!r}")
    one = effect(entry["name"], entry["target"], value)
    if entry["unit"] != CATALOGUE[one.name].unit:
        raise SurefootError(f"unit of {one.name} must be '{one.unit}', is '{entry['unit']}'")
    return one
