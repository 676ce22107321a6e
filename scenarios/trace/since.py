"""Variation between unchanged runs, from the trace that found the declared effects."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from surefoot.models.attribution.noise_floor import RunVariation
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.files import protect
from surefoot.sim.common.limits import bounded_json
from surefoot.sim.effects import Effect


def unchanged_beside(effects_file: Path, declared: Sequence[Effect]) -> RunVariation | None:
    """Variation read from the trace.json beside a file of effects, if that trace found these
    effects and had enough runs; else None.

    Raises SurefootError where the trace.json is damaged.
    """
    file = effects_file.with_name("trace.json")
    if not file.is_file():
        return None
    protect(file)
    said = bounded_json(file, "trace")
    if not isinstance(said, dict) or not _found(said.get("effects"), declared):
        return None
    if "unchanged" not in said:
        return None
    try:
        one = said["unchanged"]
        differ = {(str(x["name"]), str(x["target"])): _size(x["deviation"]) for x in one["differ"]}
        left = {str(name): _size(level) for name, level in one["left"].items()}
        return RunVariation(int(one["runs"]), differ, left)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError):
        raise SurefootError(f"{file}: 'unchanged' is damaged; trace the runs again") from None


def _found(said: Any, declared: Sequence[Effect]) -> bool:
    """Whether a trace's effects are these."""
    if not isinstance(said, list) or not all(isinstance(one, dict) for one in said):
        return False
    found = [(one.get("name"), one.get("target"), one.get("value")) for one in said]
    return found == [(one.name, one.target, one.value) for one in declared]


def _size(value: Any) -> float:
    size = float(value)
    if not 0.0 <= size < float("inf"):
        raise ValueError(size)
    return size
