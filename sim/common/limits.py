"""How much a file that comes in may ask for: checked before anything is allocated.

The defaults are far beyond what any walk of a robot needs, and small enough that a hostile file is
refused in seconds. SUREFOOT_LIMITS raises or lowers them: `SUREFOOT_LIMITS="memory=32e9,rows=1e9"`.
"""

import json
import math
import os
import re
import stat
from dataclasses import asdict, dataclass, fields
from functools import lru_cache
from pathlib import Path
from typing import Any

from surefoot.sim.common.errors import SurefootError

VARIABLE = "SUREFOOT_LIMITS"
_SMALL = 256e6
"""bytes in memory that a packed file may have whatever its size."""
_DOTTED = re.compile(r"(?<![\w-])(?:[\w-]++[ \t]*+\.[ \t]*+){65}")


@dataclass(frozen=True)
class Limits:
    """The largest amounts that an input may ask for, each with what it is meant to admit."""

    text: float = 4e6
    """bytes of a TOML, JSON or XML file; the largest of the house's own have 0.1 MB."""
    terrain: float = 100e6
    """bytes of a file of heights, or of a mesh, that is walked on."""
    recording: float = 64e9
    """bytes of a log, CSV file or bag: a day at 1 kHz as text."""
    memory: float = 8e9
    """bytes of a table in memory as float64: three hours of 90 columns at 1 kHz."""
    unpacked: float = 100.0
    """times the size of a packed file that it may have in memory, beyond 256 MB: zeros are packed a
    thousandfold, sensors' readings by some times."""
    piece: float = 1e9
    """bytes of a row group, which is decoded at once; ours have 32 768 rows, some 25 MB."""
    rows: float = 4e8
    """rows of a log: four days at 1 kHz."""
    columns: float = 4096
    """columns of a log or CSV file; a humanoid's log has some 400."""
    magnitude: float = 1e12
    """of any reading, in SI units: beyond it squares lose what they are added to."""
    items: float = 1e5
    """entries of an array in a file, segments of a course, row groups of a log."""
    bodies: float = 1e4
    """bodies, shapes, joints and sites of a model; pieces of ground."""
    arena: float = 1e9
    """bytes that a model may ask MuJoCo for."""
    walk: float = 86400.0
    """s of one simulated walk."""
    walks: float = 1e5
    """walks of one command."""
    cells: float = 1e7
    """points of a height field or a texture."""
    workers: float = 1024
    """threads or processes of one command."""


def limits() -> Limits:
    """The limits in force. Raises SurefootError where SUREFOOT_LIMITS cannot be read."""
    return _limits(os.environ.get(VARIABLE, ""))


@lru_cache(maxsize=4)
def _limits(text: str) -> Limits:
    found: dict[str, float] = asdict(Limits())
    for part in filter(None, (part.strip() for part in text.split(","))):
        name, _, value = (half.strip() for half in part.partition("="))
        if name not in found:
            raise SurefootError(f"{VARIABLE}: unknown '{name}'; known: {', '.join(found)}")
        try:
            found[name] = float(value)
        except ValueError:
            found[name] = math.nan
        if not 0 < found[name] < math.inf:
            raise SurefootError(f"{VARIABLE}: {name} must be a positive number, is '{value}'")
    return Limits(**found)


def check_limit(name: str, amount: float, what: str) -> None:
    """Raise SurefootError where an amount is beyond the limit of that name.

    what: begins the message, with file and key: "map.toml: [a] rows".
    """
    assert name in {f.name for f in fields(Limits)}
    most = getattr(limits(), name)
    if not amount <= most:
        raise SurefootError(f"{what}: {amount:.4g} is more than {most:.4g} ({VARIABLE}: {name})")


def admitted(path: str | Path, limit: str = "text", what: str = "") -> Path:
    """The path of a regular file no larger than a limit, links followed.

    Raises SurefootError, one line that starts with `what` and the path, for one that is not there,
    a folder, a pipe or a device, and one that is too large.
    """
    name = f"{what} {path}".lstrip()
    try:
        found = os.stat(path)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise SurefootError(f"{name}: {reason}") from None
    if not stat.S_ISREG(found.st_mode):
        folder = stat.S_ISDIR(found.st_mode)
        raise SurefootError(f"{name}: {'is a folder' if folder else 'is not a regular file'}")
    check_limit(limit, found.st_size, f"{name}: bytes")
    return Path(path)


def bounded_text(path: str | Path, what: str = "") -> str:
    """The text of a UTF-8 file of bounded size. Raises SurefootError as `admitted` does."""
    name = f"{what} {path}".lstrip()
    try:
        return admitted(path, "text", what).read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise SurefootError(f"{name}: not a text file ({error.reason})") from None
    except OSError as error:
        raise SurefootError(f"{name}: {error.strerror or error}") from None


def bounded_json(path: str | Path, what: str = "") -> Any:
    """What a JSON file of bounded size and depth holds.

    Raises SurefootError, one line that starts with `what` and the path.
    """
    try:
        return parse_json(bounded_text(path, what))
    except _NotJson as error:
        raise SurefootError(f"{what} {path}: {error}".lstrip()) from None


def parse_json(text: str | bytes) -> Any:
    """What a JSON text holds. Raises SurefootError for one that is none, too long or too deep."""
    check_limit("text", len(text), "JSON: bytes")
    try:
        return json.loads(text)
    except RecursionError:
        raise _NotJson("JSON that is nested too deeply") from None
    except ValueError as error:
        raise _NotJson(f"not JSON, truncated? ({' '.join(str(error).split())})") from None


def check_unpacked(path: Path, size: float, what: str, at_once: bool = True) -> None:
    """Raise SurefootError where a packed file would have too many bytes in memory: for its own
    size, and where all of it is read at once, by themselves.

    Args:
        path: of the file.
        size: bytes in memory.
        what: begins the message, with the file: "log.npz: bytes of arrays".
        at_once: whether all of it is read at once.
    """
    if at_once:
        check_limit("memory", size, what)
    if size > most_unpacked(path):
        check_limit("unpacked", size / max(path.stat().st_size, 1), f"{what}, times its size")


def most_unpacked(path: Path) -> float:
    """Bytes in memory that a packed file may have at most, for its own size."""
    return _SMALL + limits().unpacked * path.stat().st_size


class _NotJson(SurefootError):
    pass


def check_toml_keys(text: str) -> None:
    """Raise SurefootError for keys of more than 64 dots, whose parsing takes the square of it."""
    if _DOTTED.search(text):
        raise SurefootError("a key has more than 64 dots")
