"""Atomic writing of files and folders; every output of surefoot is written by these functions.

What a command writes is listed in a manifest, `.surefoot.jsonl`, in the folder that it writes to.
`--force` replaces only unchanged files that the manifest lists for the same command. The inputs of
a command are never overwritten.
"""

import hashlib
import json
import os
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from glob import escape
from importlib.resources import files
from pathlib import Path
from typing import Any

from platformdirs import user_cache_path

from surefoot.sim.common.errors import SurefootError

MANIFEST = ".surefoot.jsonl"


def cache_folder() -> Path:
    """Folder of compiled kernels and long studies: $SUREFOOT_CACHE, or else the user's cache
    folder.

    Kernels are machine code, so a folder that others can write to raises SurefootError.
    """
    chosen = os.environ.get("SUREFOOT_CACHE")
    folder = Path(chosen) if chosen else user_cache_path("surefoot", appauthor=False)
    private_folder(folder)
    return folder


def private_folder(folder: Path) -> None:
    """Create a cache folder that others can only read.

    Raises SurefootError if another user owns it or can write to it.
    """
    try:
        folder.mkdir(mode=0o755, parents=True, exist_ok=True)
        found = folder.stat()
    except OSError:
        return  # nothing can be kept there, which who wants to says
    if os.name == "posix" and (found.st_mode & 0o022 or found.st_uid not in (0, os.geteuid())):
        raise SurefootError(
            f"{folder}: others can write to this cache, which holds code; chmod go-w it, or name "
            "another by SUREFOOT_CACHE"
        )


def bundled(package: str, name: str) -> Path:
    """A file or folder that comes with a package of surefoot."""
    return Path(str(files(package) / name))


def is_file(path: str | Path) -> bool:
    """Whether a file exists. False for an impossible name, such as one that is too long, for which
    `Path.is_file` raises OSError.
    """
    return os.path.isfile(path)


def is_there(path: str | Path) -> bool:
    """Whether a file or folder exists. False for an impossible name, as in `is_file`."""
    return os.path.exists(path)


def measured_folder() -> Path:
    """Folder of recordings of real robots: $SUREFOOT_MEASURED, or else `shared/measured` beside the
    checkout; it need not exist.
    """
    chosen = os.environ.get("SUREFOOT_MEASURED")
    checkout = Path(str(files("surefoot"))).resolve().parent
    return Path(chosen) if chosen else checkout.parent / "shared" / "measured"


@dataclass
class _Run:
    """The command that is running, its input files and folders, and its finished outputs."""

    command: str
    inputs: dict[tuple[int, int], Path] = field(default_factory=dict)
    written: list[Path] = field(default_factory=list)


_run: _Run | None = None


@contextmanager
def command_run(command: str, inputs: Iterable[Path] = ()) -> Iterator[_Run]:
    """Context in which files are written in the name of `command`, and never over its inputs."""
    global _run
    before, _run = _run, _Run(command)
    try:
        for path in inputs:
            protect(path)
        yield _run
    finally:
        _run = before


def protect(path: str | Path) -> None:
    """Register a file, or a folder with its files, as an input that the running command must not
    overwrite.
    """
    identity = _identity(Path(path))
    if _run is not None and identity is not None:
        _run.inputs[identity] = Path(path)


def refuse_overwrite(path: str | Path, force: bool) -> None:
    """Raise SurefootError if `path` may not be written. Called before long work starts.

    Without `force`, an existing path may not be written. A command may never write over its inputs
    and, with `force`, only over its own unchanged outputs.
    """
    path = Path(path)
    refuse_input(path)
    if path.is_dir():
        raise SurefootError(f"{path}: is a folder, not a file to write")
    if not path.exists():
        return
    if not force:
        raise SurefootError(f"{path}: exists already; give {force_option()} to overwrite it")
    if _run is not None:
        _check_made(path, _run.command)


def force_option() -> str:
    """The option for overwriting, as named on the command line or in Python."""
    return "--force" if _run is not None else "force=True"


def refuse_input(path: Path) -> None:
    """Raise SurefootError if nothing can be written at a path, or it is an input of the running
    command, by whatever name.
    """
    identity = _identity(path)
    if identity is None:
        _check_place(path)
    elif _run is not None and identity in _run.inputs:
        raise SurefootError(f"{path}: is an input of this command ({_run.inputs[identity]})")


def _identity(path: Path) -> tuple[int, int] | None:
    """Device and number of a file, following links; None if there is none."""
    try:
        found = path.stat()
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise SurefootError(f"{_short(path)}: {reason}") from None
    return found.st_dev, found.st_ino


def _short(path: Path) -> str:
    text = str(path)
    return text if len(text) <= 120 else f"{text[:80]}...{text[-20:]}"


def _check_place(path: Path) -> None:
    """Raise SurefootError if a path does not exist and nothing can be written there."""
    if path.is_symlink():
        raise SurefootError(f"{path}: is a link to nothing")
    for parent in path.absolute().parents:
        if parent.is_dir():
            if not os.access(parent, os.W_OK | os.X_OK):
                raise SurefootError(f"{_short(path)}: {parent} is not writable")
            return
        if parent.exists():
            raise SurefootError(f"{_short(path)}: {parent} is a file, not a folder")


def manifest_entries(folder: Path) -> dict[str, dict[str, str]]:
    """Entries of a folder's manifest: file, relative to the folder -> digest of each content ->
    command.
    """
    found: dict[str, dict[str, str]] = {}
    try:
        lines = (folder / MANIFEST).read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError):
        return {}
    for line in lines:
        try:
            entry = json.loads(line)
            found.setdefault(entry["file"], {})[entry["sha256"]] = entry["command"]
        except (ValueError, KeyError, TypeError, RecursionError):  # a line that a kill cut short
            continue
    return found


def _entries_of(path: Path) -> dict[str, str]:
    """Digest -> command of the contents written at a path, from the manifests of all folders above
    it.
    """
    whole = Path(os.path.abspath(path))
    found: dict[str, str] = {}
    for folder in whole.parents:
        if (folder / MANIFEST).is_file():
            found |= manifest_entries(folder).get(whole.relative_to(folder).as_posix(), {})
    return found


def _check_made(path: Path, command: str) -> None:
    made = _entries_of(path)
    if command not in made.values():
        who = f"surefoot {sorted(made.values())[0]}" if made else "no command of surefoot"
        raise SurefootError(f"{path}: not overwritten, {who} made it; move it away")
    if path.is_file() and made.get(file_digest(path)) != command:
        raise SurefootError(f"{path}: not overwritten, was changed since it was made; move it away")


def check_unchanged(path: str | Path) -> None:
    """Raise SurefootError if a file's content is not one that a manifest lists for it."""
    made = _entries_of(Path(path))
    if made and file_digest(path) not in made:
        raise SurefootError(f"{path}: was changed or damaged since it was made")


def file_digest(path: str | Path) -> str:
    """SHA-256 of a file's content, as hexadecimal digits."""
    with Path(path).open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def json_digest(values: Any) -> str:
    """SHA-256 of plain JSON."""
    text = json.dumps(values, sort_keys=True, default=float)
    return hashlib.sha256(text.encode()).hexdigest()


def check_space(path: Path, needed: float) -> None:
    """Raise SurefootError if the disk of a path has less than `needed` bytes free."""
    there = next(folder for folder in (path, *path.absolute().parents) if folder.is_dir())
    free = shutil.disk_usage(there).free
    if free < needed:
        raise SurefootError(
            f"{path}: needs about {needed / 1e6:.0f} MB, its disk has {free / 1e6:.0f} MB free"
        )


def clear_debris(paths: Iterable[Path]) -> None:
    """Remove those of the `.tmp` paths whose process has ended."""
    for path in paths:
        number = path.stem.rpartition(".")[2]
        if path.suffix != ".tmp" or not number.isdigit():
            continue
        try:
            os.kill(int(number), 0)
        except (ProcessLookupError, OverflowError):
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink(missing_ok=True)
        except OSError:
            continue


@contextmanager
def whole_file(path: str | Path, force: bool = False) -> Iterator[Path]:
    """Yield a temporary path beside `path`; on success the file is synced and renamed to `path`.

    A reader never sees a partial file, and a killed process leaves at most a hidden `.tmp`. Raises
    SurefootError as `refuse_overwrite` does, or if the file cannot be written.
    """
    path = Path(path)
    refuse_overwrite(path, force)
    with _replaced(path) as temporary:
        yield temporary
        if not _is_temporary(path):
            _list_replaced(path, temporary)
    _note_written(path)


def _list_replaced(path: Path, temporary: Path) -> None:
    """List a file in the manifest before it is renamed, so that an interruption in between leaves
    no unlisted file.

    A file that a program writes over a command's output remains listed as that command's.
    """
    maker = _run.command if _run is not None else _last_maker(path)
    if maker:
        _list(path.parent, maker, {path.name: file_digest(temporary)})


def _last_maker(path: Path) -> str | None:
    return next(reversed(_entries_of(path).values()), None) if path.exists() else None


@contextmanager
def kept_file(path: Path) -> Iterator[Path]:
    """Like `whole_file`, for caches and states to resume from: replaces an older file, and is not
    listed.
    """
    with _replaced(path) as temporary:
        yield temporary


@contextmanager
def _replaced(path: Path) -> Iterator[Path]:
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with folder_of(path):
            try:
                yield temporary
                with temporary.open("rb+") as stream:
                    os.fsync(stream.fileno())
                os.replace(temporary, path)
            finally:
                _remove(temporary)
    except OSError as error:
        raise SurefootError(f"{_short(path)}: cannot be written ({_reason(error)})") from error


@contextmanager
def folder_of(path: Path) -> Iterator[None]:
    """Create the parent folders of a path; new ones that remain empty are removed again.

    Raises OSError if one cannot be created.
    """
    missing = [folder for folder in path.parents if not folder.exists()]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield
    finally:
        for folder in missing:
            try:
                folder.rmdir()
            except OSError:
                break


@contextmanager
def whole_folder(out: str | Path, force: bool = False) -> Iterator[Path]:
    """Yield a temporary folder beside `out`; on success its contents are moved to `out`. With
    `force` they replace everything that the same command wrote there.

    On failure `out` is left as it was. Raises SurefootError if a file of `out` is in the way.
    """
    out = Path(os.path.realpath(out))
    staging = out.with_name(f".{out.name}.{os.getpid()}.tmp")
    clear_debris(out.parent.glob(f".{escape(out.name)}.*.tmp"))
    try:
        with folder_of(out):
            try:
                staging.mkdir()
                yield staging
                _publish(staging, out, force)
                _note_written(out)
            finally:
                shutil.rmtree(staging, ignore_errors=True)
    except OSError as error:
        raise SurefootError(f"{_short(out)}: cannot be written ({_reason(error)})") from error


def _note_written(path: Path) -> None:
    if _run is not None and not _is_temporary(path):
        _run.written.append(Path(os.path.realpath(path)))


def _publish(staging: Path, out: Path, force: bool) -> None:
    made = {p.relative_to(staging).as_posix(): p for p in staging.rglob("*") if p.is_file()}
    for name in made:
        refuse_overwrite(out / name, force)
    digests = {name: file_digest(path) for name, path in made.items()}
    stale: list[str] = []
    if force and _run is not None:
        before = manifest_entries(out)
        stale = [name for name, e in before.items() if _run.command in e.values()]
        stale = [name for name in stale if name not in made and _as_made(out / name, before[name])]
    fresh = not out.exists() or not any(out.iterdir())
    if _run is not None and not _is_temporary(out):
        _list(staging if fresh else out, _run.command, digests)
    elif not fresh:
        for name in made:
            if maker := _last_maker(out / name):
                _list(out, maker, {name: digests[name]})
    if fresh:
        os.rename(staging, out)
        return
    for name in stale:
        (out / name).unlink(missing_ok=True)
    for name, path in sorted(made.items(), key=lambda item: item[0] in ("report.html",)):
        (out / name).parent.mkdir(parents=True, exist_ok=True)
        os.replace(path, out / name)


def _as_made(path: Path, digests: dict[str, str]) -> bool:
    return path.is_file() and not path.is_symlink() and file_digest(path) in digests


def refuse_full(out: Path, force: bool) -> None:
    """Raise SurefootError if `out` is a file, or a folder that is not empty.

    With `force` the folder may have outputs of the same command, and files of other names.
    """
    if _identity(out) is None:
        _check_place(out)
        return
    if not out.is_dir():
        raise SurefootError(f"-o {out}: is a file, not a folder")
    if not any(path.name != MANIFEST for path in out.iterdir()):
        return
    if not force:
        raise SurefootError(
            f"-o {out}: is not empty; give {force_option()} to overwrite what is in it"
        )
    if _run is None:
        return
    own = [n for n, e in manifest_entries(out).items() if _run.command in e.values()]
    if not own:
        raise SurefootError(
            f"-o {out}: --force replaces what surefoot {_run.command} made, and it made nothing "
            "here; give another folder"
        )
    for name in own:
        if (out / name).exists():
            refuse_overwrite(out / name, force)


def _list(folder: Path, command: str, digests: dict[str, str]) -> None:
    """Append files, given relative to the folder, to its manifest."""
    folder.mkdir(parents=True, exist_ok=True)
    entries = ({"file": n, "sha256": d, "command": command} for n, d in digests.items())
    path = folder / MANIFEST
    torn = path.is_file() and path.stat().st_size and not path.read_bytes().endswith(b"\n")
    with path.open("a", encoding="utf-8") as stream:
        stream.write("\n" * bool(torn) + "".join(f"{json.dumps(entry)}\n" for entry in entries))


def _is_temporary(path: Path) -> bool:
    """Whether a path is temporary, or inside a temporary folder."""
    return any(part.startswith(".") and part.endswith(".tmp") for part in path.parts)


def _remove(path: Path) -> None:
    try:
        path.unlink(missing_ok=True)
    except OSError:
        return  # a name that is too long, a folder that is no longer there


def _reason(error: OSError) -> str:
    return " ".join(str(error.strerror or error).split())
