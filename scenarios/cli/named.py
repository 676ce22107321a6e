"""Check names and files in a command's options before slow imports."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from surefoot.scenarios.estimate.estimators import check_filter
from surefoot.sim.common.errors import SurefootError, check_known
from surefoot.sim.common.files import is_file, is_there
from surefoot.sim.common.limits import admitted, check_first_bytes
from surefoot.sim.effects.catalogue import known_effects
from surefoot.sim.importing.map_catalog import map_file
from surefoot.sim.robot.catalog import machine_file, robot_file
from surefoot.sim.scenario_catalog import scenario_file

MOST_NAMED = 8
"""Largest number of logs that are named of a folder."""


def refuse_unnamed(given: Mapping[str, Any]) -> None:
    """Raise SurefootError for a missing file or an unknown name.

    given: name -> value of a command's options that it reads.
    """
    logs: list[Path] = []
    for option, value in given.items():
        if value == () and option in _NEEDED and not given.get("walks"):
            raise SurefootError(_NEEDED[option])
        for one in value if isinstance(value, tuple) else (value,):
            if isinstance(one, Path):
                file_there(one)
                if option in _LOGS and one.is_dir():
                    inside = sorted(log.name for log in one.glob("*.parquet"))
                    first = ", ".join(inside[:MOST_NAMED]) + ", ..." * (len(inside) > MOST_NAMED)
                    raise SurefootError(
                        f"{one}: is a folder where a log is expected; give one of its logs "
                        f"({first or 'no log is in it'})"
                    )
                if option in _LOGS and is_file(one):
                    logs.append(one)
            elif isinstance(one, str) and one and option in _LOOKED_UP:
                _LOOKED_UP[option](one)
    for log in logs:
        check_first_bytes(admitted(log, "recording"))


def file_there(path: str | Path) -> None:
    """Raise SurefootError where there is neither a file nor a folder."""
    if not is_there(path):
        raise SurefootError(f"{path}: no such file")


def _log_or_scenario(name: str) -> None:
    if Path(name).suffix != ".parquet":
        scenario_file(name)
        return
    file_there(name)
    check_first_bytes(admitted(Path(name), "recording"))


def _known_effect(name: str) -> None:
    check_known("effect", name, known_effects())


_NEEDED = {
    "logs": "give at least one log",
    "effects": "name at least one effect",
    "files": "give the recording's file",
}
"""List that must not be empty -> what is missing."""
_LOGS = {"log", "logs", "holdout", "on"}
"""Options that are logs."""
_LOOKED_UP = {
    "filter": check_filter,
    "filters": check_filter,
    "robot": machine_file,
    "walker": robot_file,
    "scenarios": scenario_file,
    "sources": _log_or_scenario,
    "map": map_file,
    "effects": _known_effect,
}
"""Option that is a name, or for some a file -> function that raises SurefootError if it is unknown.
"""
