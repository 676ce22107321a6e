"""Guards around every command: inputs are never overwritten, no two runs write to one output, and
an interruption ends in one line.
"""

import os
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import fields
from glob import escape
from pathlib import Path
from typing import Any

from surefoot.scenarios.cli.named import refuse_unnamed
from surefoot.scenarios.cli.signals import say_if_interrupted
from surefoot.sim.common import files
from surefoot.sim.common.errors import LARGEST_WHOLE, SurefootError
from surefoot.sim.common.limits import check_limit

try:
    import fcntl
except ImportError:  # where it is missing, two runs into one folder are not told apart
    fcntl = None

OUTPUTS_OF_ONE_RUN = ("out", "report")
"""Options for outputs that only one run at a time may write."""
SHARED_OUTPUTS = ("page", "data", "cache")
"""Options for outputs that runs may share. Every other path is an input."""
FOLDER_OPTIONS = ("data", "cache")
"""Options that must not name a file."""
BOUNDED = {"workers": "workers", "walks": "walks", "budget": "items"}
"""Options that are counts -> name of their limit."""
GOES_ON = {"simulate", "train", "calibrate", "experiment", "suite", "loop", "tune"}
"""Commands that continue after an interruption when run again."""
SPACE = 4_000_000
"""Free space that a command needs to start [bytes], for reports and figures."""


@contextmanager
def guarded(name: str, command: Any) -> Iterator[None]:
    """Context in which the command has exclusive use of its output and cannot overwrite its inputs.

    Raises SurefootError if an input is missing, an output is an input or is being written by
    another run, the disk is full, or others can write to the cache.
    """
    given = {f.name: getattr(command, f.name) for f in fields(command)}
    exclusive = [given[name] for name in OUTPUTS_OF_ONE_RUN if given.get(name) is not None]
    shared = [given[name] for name in SHARED_OUTPUTS if given.get(name) is not None]
    outputs = OUTPUTS_OF_ONE_RUN + SHARED_OUTPUTS
    read = {name: value for name, value in given.items() if name not in outputs}
    inputs = [path for value in read.values() for path in _paths(value)]
    for option, value in given.items():
        if isinstance(value, int) and abs(value) > LARGEST_WHOLE:
            raise SurefootError(f"--{option}: must not be beyond 2^53")
    for path in (*inputs, *exclusive, *shared):
        whole = os.path.abspath(path)  # Python holds other bytes than UTF-8 as half characters
        if whole.encode(errors="ignore").decode() != whole:
            raise SurefootError(f"{whole}: the path is not UTF-8; rename it")
    refuse_unnamed(read)
    files.cache_folder()
    for option, limit in BOUNDED.items():
        if isinstance(given.get(option), int):
            check_limit(limit, given[option], f"--{option}")
    with ExitStack() as stack:
        run = stack.enter_context(files.command_run(name, inputs))
        for path in (*exclusive, *shared):
            files.refuse_input(path)
        for option in FOLDER_OPTIONS:
            if given.get(option) and Path(given[option]).is_file():
                raise SurefootError(f"--{option} {given[option]}: is a file, not a folder")
        if given.get("page"):
            from surefoot.scenarios.reporting.pages import check_page

            check_page(given["page"], exclusive)
        for path in exclusive:
            stack.enter_context(_alone(path))
        say_if_interrupted(lambda: how_to_go_on(name, run.written, exclusive))
        yield


def _paths(value: Any) -> list[Path]:
    """The files and folders in an option's value."""
    several = value if isinstance(value, tuple) else (value,)
    return [Path(one) for one in several if isinstance(one, str | Path) and files.is_there(one)]


@contextmanager
def _alone(out: Path) -> Iterator[None]:
    """Context in which no other run can write to `out`; removes folders created for it that stay
    empty.
    """
    out = Path(os.path.realpath(out))
    with ExitStack() as stack:
        try:
            stack.enter_context(files.folder_of(out))
            files.check_space(out.parent, SPACE)
            files.clear_debris(out.parent.glob(f".{escape(out.name)}.*.tmp"))
            if fcntl:
                stack.enter_context(_locked(out.with_name(f".{out.name}.lock"), out))
        except OSError as error:
            raise SurefootError(f"-o {str(out)[:120]}: {error.strerror or error}") from error
        yield


@contextmanager
def _locked(lock: Path, out: Path) -> Iterator[None]:
    assert fcntl
    while True:
        stream = os.fdopen(files.open_plain(lock), "ab")
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            stream.close()
            raise SurefootError(f"-o {out}: another run is writing there; wait for it") from None
        # The previous run may have removed the file between opening and locking it.
        if lock.exists() and os.path.samestat(os.fstat(stream.fileno()), lock.stat()):
            break
        stream.close()
    with stream, files.unfinished(lock):
        yield


def how_to_go_on(name: str, written: Sequence[Path], exclusive: Sequence[Path]) -> str:
    """Message of an interrupted command.

    Args:
        name: of the command.
        written: paths that it has finished.
        exclusive: its outputs. A command that can continue writes parts of them first, which do not
            count.
    """
    if name in GOES_ON:
        whole = [Path(os.path.realpath(path)) for path in exclusive]
        written = [path for path in written if path in whole]
    if written:
        done = ", ".join(map(str, written))
        return f"interrupted; {done} was already written, --force replaces it"
    if name in GOES_ON:
        return "interrupted; the same command continues from what is finished"
    return "interrupted; nothing was written, the same command starts again"
