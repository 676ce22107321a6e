"""Files that are either whole or not there: every writer of the product goes through here."""

import os
import tomllib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from sim.errors import SurefootError


def refuse_overwrite(path: str | Path, force: bool) -> None:
    """Raises SurefootError where `path` exists, unless `force`: called before long work starts."""
    if Path(path).exists() and not force:
        raise SurefootError(f"{path}: exists already; give --force (force=True) to overwrite it")


def read_toml(path: Path, what: str = "") -> dict[str, Any]:
    """The tables of a TOML file. Raises SurefootError, one line that starts with `what`, path."""
    name = f"{what} {path}".lstrip()
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise SurefootError(f"{name}: {error.strerror or error}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise SurefootError(f"{name}: not valid TOML: {error}") from None


def clear_debris(paths: Iterable[Path]) -> None:
    """Remove those `.tmp` of `whole_file` whose writer was killed; what a live one writes stays."""
    for path in paths:
        number = path.stem.rpartition(".")[2]
        if path.suffix != ".tmp" or not number.isdigit():
            continue
        try:
            os.kill(int(number), 0)
        except ProcessLookupError:
            path.unlink(missing_ok=True)
        except OSError:
            continue


@contextmanager
def whole_file(path: str | Path, force: bool = False) -> Iterator[Path]:
    """Yield a temporary path beside `path`; on success it is synced and takes its place at once.

    A reader never sees half a file, and a killed writer leaves at most a hidden `.tmp` behind.
    Raises SurefootError where `path` exists and `force` is not given, or cannot be written.
    """
    path = Path(path)
    if path.is_dir():
        raise SurefootError(f"{path}: is a folder, not a file to write")
    refuse_overwrite(path, force)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        with temporary.open("rb+") as stream:
            os.fsync(stream.fileno())
        os.replace(temporary, path)
    except OSError as error:
        raise SurefootError(f"{path}: cannot be written ({error.strerror or error})") from error
    finally:
        temporary.unlink(missing_ok=True)
