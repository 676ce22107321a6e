"""Files that are either whole or not there: every writer of the product goes through here."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from sim.errors import SurefootError


def refuse_overwrite(path: str | Path, force: bool) -> None:
    """Raises SurefootError where `path` exists, unless `force`: called before long work starts."""
    if Path(path).exists() and not force:
        raise SurefootError(f"{path}: exists already; give --force (force=True) to overwrite it")


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
