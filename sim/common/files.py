"""Atomic writing of files and folders; every output of surefoot is written by these functions.

What a command writes is listed in a manifest, `.surefoot.jsonl`, in the folder that it writes to.
`--force` replaces only unchanged files that the manifest lists for the same command. The inputs of
a command are never overwritten.
"""

import hashlib
import json
import math
import os
import shutil
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field, fields, is_dataclass
from glob import escape
from importlib.resources import files
from pathlib import Path
from threading import RLock
from typing import Any

from platformdirs import user_cache_path

from surefoot.sim.common.errors import SurefootError, did_you_mean, shortened
from surefoot.sim.common.limits import bounded_json

MANIFEST = ".surefoot.jsonl"
_NO_LINK = getattr(os, "O_NOFOLLOW", 0)


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
        return  # whoever writes to it finds that it cannot be used
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


def named_file(what: str, path: Path, name: str, known: Mapping[str, Path]) -> Path:
    """The file at a path or, where there is none, the known one of a name, with or without its
    suffix `.toml`.

    Raises SurefootError, listing the names, for neither. `what` it is, for the message.
    """
    found = path if is_file(path) else known.get(name.removesuffix(".toml"))
    if found is None:
        hint = did_you_mean(name, known)
        raise SurefootError(f"{what} {path}: No such file; bundled are {', '.join(known)}{hint}")
    return found


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
    check_plain(path.parent / MANIFEST)
    if path.is_dir():
        raise SurefootError(f"{path}: is a folder, not a file to write")
    if path.exists() and not force:
        raise SurefootError(f"{path}: exists already; give {force_option()} to overwrite it")
    if path.exists() and _run is not None:
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
        raise SurefootError(f"{shortened(str(path))}: {reason}") from None
    return found.st_dev, found.st_ino


def _check_place(path: Path) -> None:
    """Raise SurefootError if a path does not exist and nothing can be written there."""
    if path.is_symlink():
        raise SurefootError(f"{path}: is a link to nothing")
    for parent in path.absolute().parents:
        if parent.is_dir():
            if not os.access(parent, os.W_OK | os.X_OK):
                raise SurefootError(f"{shortened(str(path))}: {parent} is not writable")
            return
        if parent.exists():
            raise SurefootError(f"{shortened(str(path))}: {parent} is a file, not a folder")


def open_plain(path: Path) -> int:
    """Descriptor of a regular file of ours, such as a manifest or a lock, to read and append to;
    created if there is none.

    Raises SurefootError for a link, a pipe, a folder or a device, so that nothing outside the
    folder is written and no reader is waited for. Raises OSError if it cannot be created.
    """
    check_plain(path)
    return os.open(path, os.O_RDWR | os.O_APPEND | os.O_CREAT | _NO_LINK, 0o666)


def check_plain(path: Path, folder: Path | None = None) -> None:
    """Raise SurefootError if a path exists and is not itself a regular file, or is in `folder` only
    by a link.
    """
    if os.path.lexists(path) and not _is_plain(path):
        raise SurefootError(f"{path}: is a link or no regular file; move it away")
    if folder and not Path(os.path.realpath(path)).is_relative_to(os.path.realpath(folder)):
        raise SurefootError(f"{path}: is outside of {folder}, by a link; move that away")


def _is_plain(path: Path) -> bool:
    return path.is_file() and not path.is_symlink()


def json_lines(path: Path) -> Iterator[Any]:
    """The entries of a file to which `append_lines` writes, without those that a kill cut short;
    none if there is no such file, or it is a link, a pipe or no text.
    """
    try:
        text = path.read_text(encoding="utf-8") if _is_plain(path) else ""
    except (OSError, UnicodeDecodeError):
        return
    for line in text.splitlines():
        with suppress(ValueError, RecursionError):
            yield json.loads(line)


def append_lines(path: Path, entries: Iterable[Mapping[str, Any]]) -> None:
    """Append entries to a file, a line of JSON each; a line that was cut short is ended first.

    Raises SurefootError as `open_plain` does.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with os.fdopen(open_plain(path), "r+b") as stream:
        size = stream.seek(0, os.SEEK_END)
        stream.seek(max(size - 1, 0))
        torn = stream.read() not in (b"", b"\n")
        lines = "".join(f"{json.dumps(entry)}\n" for entry in entries)
        stream.write(("\n" * torn + lines).encode())


def manifest_entries(folder: Path) -> dict[str, dict[str, str]]:
    """Entries of a folder's manifest: file, relative to the folder -> digest of each content ->
    command.
    """
    found: dict[str, dict[str, str]] = {}
    for entry in json_lines(folder / MANIFEST):
        with suppress(KeyError, TypeError):
            found.setdefault(entry["file"], {})[entry["sha256"]] = entry["command"]
    return found


def _entries_of(path: Path) -> dict[str, str]:
    """Digest -> command of the contents written at a path, from the manifests of all folders above
    it.
    """
    whole = Path(os.path.abspath(path))
    found: dict[str, str] = {}
    for folder in whole.parents:
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


def as_made(path: Path, digest: str | None = None) -> bool:
    """Whether an earlier run made a file, and it is unchanged since. A changed one is reported on
    stderr and removed, so that it is made again.

    Args:
        path: of the file.
        digest: its SHA-256 when it was made; None for what manifests list, if anything.
    """
    if not os.path.lexists(path):
        return False
    made = _entries_of(path) if digest is None else (digest,)
    if not made:
        check_plain(path)
        return True
    if _is_plain(path) and file_digest(path) in made:
        return True
    try:
        path.unlink()
    except OSError as error:
        raise SurefootError(f"{path}: {error.strerror}; move it away") from None
    say_made_again(path)
    return False


def say_made_again(path: Path) -> None:
    """Report on stderr that a file of an earlier run is not used."""
    print(f"note: {path}: changed since it was made, made again", file=sys.stderr)


def kept_json(path: Path) -> dict[str, Any] | None:
    """Table in a JSON file of an earlier run; None if there is none or, with a note on stderr, if
    it is none. Raises SurefootError for a link or a pipe.
    """
    check_plain(path)
    if not path.exists():
        return None
    with suppress(SurefootError):
        found = bounded_json(path)
        if isinstance(found, dict):
            return found
    return say_made_again(path)


def file_digest(path: str | Path) -> str:
    """SHA-256 of a file's content, as hexadecimal digits."""
    with Path(path).open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def json_digest(values: Any) -> str:
    """SHA-256 of plain JSON."""
    text = json.dumps(values, sort_keys=True, default=float)
    return hashlib.sha256(text.encode()).hexdigest()


def plain_json(value: Any) -> Any:
    """A value as plain JSON: numbers that are not finite as null, arrays as lists, dataclasses as
    their fields, files as names.
    """
    if is_dataclass(value) and not isinstance(value, type):
        value = {field.name: getattr(value, field.name) for field in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): plain_json(one) for key, one in value.items()}
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [plain_json(one) for one in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if isinstance(value, str | int | None) else str(value)


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
            _remove(path)
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
    with kept_file(path) as temporary:
        yield temporary
        _list(path.parent, path.parent, {path.name: temporary})
    _note_written(path)


def write_whole(path: str | Path, text: str, force: bool = False) -> None:
    """Write a text with `whole_file`, in UTF-8. Raises SurefootError as that does."""
    with whole_file(path, force) as temporary:
        temporary.write_text(text, encoding="utf-8")


@contextmanager
def kept_file(path: Path) -> Iterator[Path]:
    """Like `whole_file`, for caches and states to resume from: replaces an older file, and is not
    listed.
    """
    with _staged(path) as temporary:
        yield temporary
        with temporary.open("rb+") as stream:
            os.fsync(stream.fileno())
        os.replace(temporary, path)


@contextmanager
def _staged(path: Path) -> Iterator[Path]:
    """A temporary path beside `path`, where nothing is left."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with folder_of(path), unfinished(temporary):
            yield temporary
    except OSError as error:
        reason = " ".join(str(error.strerror or error).split())
        # A file that has a name of its own, such as one of a cache, is not this output.
        other = error.filename if isinstance(error.filename, str) else None
        at = path if other is None or _is_temporary(Path(other)) else Path(other)
        raise SurefootError(f"{shortened(str(at))}: cannot be written ({reason})") from error


@contextmanager
def folder_of(path: Path) -> Iterator[None]:
    """Create the parent folders of a path; new ones that remain empty are removed again.

    Raises OSError if one cannot be created.
    """
    with ExitStack() as stack:
        for folder in reversed([folder for folder in path.parents if not folder.exists()]):
            stack.enter_context(unfinished(folder, _remove_empty))
        path.parent.mkdir(parents=True, exist_ok=True)
        yield


_unfinished: list[tuple[Path, Callable[[Path], None]]] = []
"""Temporary paths, locks and new folders of this process, and how each is removed."""
_beginning = RLock()


@contextmanager
def unfinished(path: Path, remove: Callable[[Path], None] | None = None) -> Iterator[None]:
    """Context at whose end a path is removed, also if a signal ends the process within it."""
    entry = path, remove or _remove
    with _beginning:
        _unfinished.append(entry)
    try:
        yield
    finally:
        entry[1](path)
        _unfinished.remove(entry)


def remove_unfinished() -> None:
    """Remove what the contexts of `unfinished` would, before the process ends without leaving them;
    no thread can enter another from now on.
    """
    _beginning.acquire()
    for path, remove in reversed(_unfinished):
        remove(path)


@contextmanager
def whole_folder(out: str | Path, force: bool = False) -> Iterator[Path]:
    """Yield a temporary folder beside `out`; on success its contents are moved to `out`. With
    `force` they replace everything that the same command wrote there.

    On failure `out` is left as it was. Raises SurefootError if a file of `out` is in the way.
    """
    out = Path(os.path.realpath(out))
    clear_debris(out.parent.glob(f".{escape(out.name)}.*.tmp"))
    with _staged(out) as staging:
        staging.mkdir()
        yield staging
        _publish(staging, out, force)
    _note_written(out)


def _note_written(path: Path) -> None:
    if _run is not None and not _is_temporary(path):
        _run.written.append(Path(os.path.realpath(path)))


def _publish(staging: Path, out: Path, force: bool) -> None:
    files = sorted(path for path in staging.rglob("*") if path.is_file())
    made = {path.relative_to(staging).as_posix(): path for path in files}
    for name in made:
        check_plain(out / name, out)
        refuse_overwrite(out / name, force)
    stale = [
        name
        for name, digests in (_own_files(out) if force else {}).items()
        if name not in made and _is_plain(out / name) and file_digest(out / name) in digests
    ]
    fresh = not out.exists() or not any(out.iterdir())
    # Files are listed before they are renamed, so that an interruption leaves no unlisted one.
    _list(staging if fresh else out, out, made)
    if fresh:
        os.rename(staging, out)
        return
    for name in stale:
        (out / name).unlink(missing_ok=True)
    for name, path in sorted(made.items(), key=lambda item: item[0] == "report.html"):
        (out / name).parent.mkdir(parents=True, exist_ok=True)
        os.replace(path, out / name)


def refuse_full(out: Path, force: bool) -> None:
    """Raise SurefootError if `out` is a file, or a folder that is not empty.

    With `force` the folder may have outputs of the same command, and files of other names.
    """
    refuse_input(out)
    if out.exists() and not out.is_dir():
        raise SurefootError(f"-o {out}: is a file, not a folder")
    check_plain(out / MANIFEST)
    if not out.exists() or all(path.name == MANIFEST for path in out.iterdir()):
        return
    if not force:
        raise SurefootError(
            f"-o {out}: is not empty; give {force_option()} to overwrite what is in it"
        )
    made = _own_files(out)
    if _run is not None and not made:
        raise SurefootError(
            f"-o {out}: --force replaces what surefoot {_run.command} made, and it made nothing "
            "here; give another folder"
        )
    for name in made:
        if (out / name).exists():
            refuse_overwrite(out / name, force)


def _own_files(folder: Path) -> dict[str, dict[str, str]]:
    """The `manifest_entries` of files that the running command made."""
    command = None if _run is None else _run.command
    return {name: e for name, e in manifest_entries(folder).items() if command in e.values()}


def _list(into: Path, out: Path, made: Mapping[str, Path]) -> None:
    """List files in a manifest, as outputs of the command that is running.

    A file that a program writes over a command's output remains listed as that command's.

    Args:
        into: folder of the manifest.
        out: folder where the files will be.
        made: name of each in `out` -> file with its content.
    """
    entries = []
    for name, content in made.items():
        maker = _run.command if _run is not None else _last_maker(out / name)
        if maker and not _is_temporary(out / name):
            entries.append({"file": name, "sha256": file_digest(content), "command": maker})
    if entries:
        append_lines(into / MANIFEST, entries)


def _last_maker(path: Path) -> str | None:
    return next(reversed(_entries_of(path).values()), None) if path.exists() else None


def _is_temporary(path: Path) -> bool:
    """Whether a path is temporary, or inside a temporary folder."""
    return any(part.startswith(".") and part.endswith(".tmp") for part in path.parts)


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
        return
    with suppress(OSError):  # a name that is too long, a folder that is no longer there
        path.unlink(missing_ok=True)


def _remove_empty(folder: Path) -> None:
    with suppress(OSError):
        folder.rmdir()
