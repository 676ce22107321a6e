"""Limits on the size and contents of input files, checked before memory is allocated.

The defaults are far beyond what a robot's walk needs, and small enough to refuse a hostile file in
seconds. SUREFOOT_LIMITS changes them: `SUREFOOT_LIMITS="memory=32e9,rows=1e9"`.
"""

import json
import math
import os
import re
import stat
from contextlib import suppress
from dataclasses import asdict, dataclass, fields
from functools import lru_cache
from pathlib import Path
from typing import Any

from surefoot.sim.common.errors import SurefootError

VARIABLE = "SUREFOOT_LIMITS"
SMALL = 256e6
"""Bytes in memory that are allowed for packed data of any size."""
_POINTER, _LONGEST_POINTER = b"version https://git-lfs.github.com/spec/", 1024
"""Beginning and largest size of a file that stands for one in Git LFS (its specification)."""
_DOTTED = re.compile(r"(?<![\w-])(?:[\w-]++[ \t]*+\.[ \t]*+){65}")


@dataclass(frozen=True)
class Limits:
    """Upper limits for inputs, each with an example of what it admits."""

    text: float = 4e6
    """Bytes of a TOML, JSON or XML file; the largest bundled ones have 0.1 MB."""
    terrain: float = 100e6
    """Bytes of a file of heights, or of a mesh, for the ground."""
    recording: float = 64e9
    """Bytes of a log, CSV file or bag: a day at 1 kHz as text."""
    memory: float = 8e9
    """Bytes of a table in memory as float64: three hours of 90 columns at 1 kHz."""
    unpacked: float = 100.0
    """Ratio of bytes in memory to the size of a packed file, beyond 256 MB. Zeros are packed a
    thousandfold, sensor readings only several times.
    """
    piece: float = 1e9
    """Bytes of a row group, or of a message of a bag, which is decoded at once; surefoot writes row
    groups of 32 768 rows, some 25 MB.
    """
    rows: float = 4e8
    """Rows of a log: four days at 1 kHz."""
    columns: float = 4096
    """Columns of a log or CSV file; a humanoid's log has some 400."""
    magnitude: float = 1e12
    """Magnitude of a reading, in SI units; sums of larger squares lose all precision."""
    items: float = 1e5
    """Entries of an array in a file, segments of a course, columns of short row groups of a log."""
    bodies: float = 1e4
    """Bodies, shapes, joints and sites of a model; pieces of ground."""
    arena: float = 1e9
    """Bytes that a model may request from MuJoCo."""
    walk: float = 86400.0
    """Duration of one simulated walk [s]."""
    walks: float = 1e5
    """Walks of one command."""
    cells: float = 1e7
    """Points of a height field or a texture."""
    pixels: float = 1e8
    """Pixels of a model's pictures, in total: some eight bytes each while they are unpacked."""
    workers: float = 1024
    """Threads or processes of one command."""


def limits() -> Limits:
    """The current limits. Raises SurefootError if SUREFOOT_LIMITS cannot be parsed."""
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
    """Raise SurefootError if an amount exceeds the limit of that name.

    what: start of the message, with file and key: "map.toml: [a] rows".
    """
    assert name in {f.name for f in fields(Limits)}
    most = getattr(limits(), name)
    if not amount <= most:
        raise SurefootError(f"{what}: {amount:.4g} is more than {most:.4g} ({VARIABLE}: {name})")


def admitted(path: str | Path, limit: str = "text", what: str = "") -> Path:
    """Check that a path is a regular file within a size limit, following links; returns the path.

    Raises SurefootError, in one line that starts with `what` and the path, for a missing file, a
    folder, a pipe, a device, a pointer of Git LFS, or a file that is too large.
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
    if found.st_size < _LONGEST_POINTER:
        with suppress(OSError), open(path, "rb") as stream:
            if stream.read(len(_POINTER)) == _POINTER:
                raise SurefootError(f"{name}: is a Git LFS pointer; git lfs pull fetches the file")
    return Path(path)


def bounded_text(path: str | Path, what: str = "") -> str:
    """Read a UTF-8 text file of limited size. Raises SurefootError as `admitted` does."""
    name = f"{what} {path}".lstrip()
    try:
        return admitted(path, "text", what).read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise SurefootError(f"{name}: not a text file ({error.reason})") from None
    except OSError as error:
        raise SurefootError(f"{name}: {error.strerror or error}") from None


def bounded_json(path: str | Path, what: str = "") -> Any:
    """Read a JSON file of limited size and depth.

    Raises SurefootError, in one line that starts with `what` and the path.
    """
    return parse_json(bounded_text(path, what), f"{what} {path}: ".lstrip())


def parse_json(text: str | bytes, prefix: str = "") -> Any:
    """Parse a JSON text. Raises SurefootError, with a prefix, if it is invalid, too long or nested
    too deeply.
    """
    check_limit("text", len(text), f"{prefix}JSON: bytes")
    try:
        return json.loads(text)
    except RecursionError:
        raise SurefootError(f"{prefix}JSON that is nested too deeply") from None
    except ValueError as error:
        reason = " ".join(str(error).split())
        raise SurefootError(f"{prefix}not JSON, truncated? ({reason})") from None


def check_unpacked(packed: float, size: float, what: str, at_once: bool = True) -> None:
    """Raise SurefootError if packed data would take too much memory, relative to their size and, if
    they are read at once, in total.

    Args:
        packed: bytes of the file.
        size: bytes in memory.
        what: start of the message, with the file: "log.npz: bytes of arrays".
        at_once: whether the file is read at once.
    """
    if at_once:
        check_limit("memory", size, what)
    if size > SMALL + limits().unpacked * packed:
        check_limit("unpacked", size / max(packed, 1), f"{what}, times its size")


def check_toml_keys(text: str) -> None:
    """Raise SurefootError for keys of more than 64 dots, whose parsing takes quadratic time."""
    if _DOTTED.search(text):
        raise SurefootError("a key has more than 64 dots")


_MAGIC = b"PAR1"
"""First bytes of a Parquet file."""


def check_first_bytes(path: Path) -> None:
    """Raise SurefootError for a recording that has still to be imported, and for a Parquet file
    that is damaged in its first bytes.
    """
    with path.open("rb") as stream:
        if stream.read(len(_MAGIC)) == _MAGIC:
            return
    if path.suffix == ".parquet":
        raise SurefootError(f"{path}: not a whole Parquet file, damaged in its first bytes")
    raise SurefootError(
        f"{path}: not a log, which is a Parquet file; `surefoot import` makes one of a recording, "
        "`surefoot simulate` of a scenario"
    )
