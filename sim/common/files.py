"""Files that are either whole or not there: every writer of the product goes through here."""

import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from importlib.resources import files
from pathlib import Path

from platformdirs import user_cache_path

from surefoot.sim.common.errors import SurefootError


def cache_folder() -> Path:
    """Where compiled kernels and long studies keep their files: $SUREFOOT_CACHE, or else the
    user's cache folder."""
    chosen = os.environ.get("SUREFOOT_CACHE")
    return Path(chosen) if chosen else user_cache_path("surefoot", appauthor=False)


def bundled(package: str, name: str) -> Path:
    """A file or folder that comes with a package of surefoot."""
    return Path(str(files(package) / name))


def measured_folder() -> Path:
    """Where recordings of real robots lie: $SUREFOOT_MEASURED, or else `shared/measured` beside
    the checkout; it need not exist."""
    chosen = os.environ.get("SUREFOOT_MEASURED")
    checkout = Path(str(files("surefoot"))).resolve().parent
    return Path(chosen) if chosen else checkout.parent / "shared" / "measured"


def refuse_overwrite(path: str | Path, force: bool) -> None:
    """Raises SurefootError where `path` exists, unless `force`: called before long work starts."""
    if Path(path).exists() and not force:
        raise SurefootError(f"{path}: exists already; give --force (force=True) to overwrite it")


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
