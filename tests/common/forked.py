"""Commands run in forked children of this process, warmed by its imports, under limits of their
own: a case takes milliseconds, and one that eats memory or time ends alone."""

import os
import resource
import shutil
import sys
import warnings
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

MEMORY = 1_000_000_000
"""bytes that a command may take beyond what this process has."""
SECONDS = 10
"""s of processor time."""


@dataclass(frozen=True)
class Outcome:
    """How a command ended: exit code (negative: by that signal), what it printed, seconds of
    processor time, and the files that it left, made or changed."""

    code: int
    out: str
    err: str
    seconds: float
    changed: tuple[str, ...]

    @property
    def refused(self) -> bool:
        """Whether it ended with exactly one line, after warnings and notes on a log, and
        changed nothing.
        """
        said = ("warning: ", "note: ")
        lines = [line for line in self.err.splitlines() if not line.startswith(said)]
        one = len(lines) == 1 and lines[0].startswith("surefoot: ")
        return one and self.code in (1, 2) and not self.changed

    @property
    def traceback(self) -> bool:
        """Whether a user would see Python's insides."""
        return "Traceback (most recent call last)" in self.err

    def __str__(self) -> str:
        text = f"exit {self.code} in {self.seconds:.1f} s; changed: {', '.join(self.changed)}"
        return f"{text}\n{self.out[-500:]}\n{self.err[-2000:]}"


def run_forked(
    command: list[str], folder: Path, memory: int = MEMORY, longest: int | None = None
) -> Outcome:
    """The command of the command line, run in `folder`.

    longest: bytes of the longest file that it can write, as on a disk that is full by then.
    """
    from surefoot.scenarios.cli.main import main

    before = contents(folder)
    pipes = [os.pipe(), os.pipe()]
    sys.stdout.flush()
    sys.stderr.flush()
    code = 99
    child = os.fork()
    if child == 0:
        try:
            os.chdir(folder)
            for number, (_, end) in enumerate(pipes, start=1):
                os.dup2(end, number)
            sys.stdout, sys.stderr = os.fdopen(1, "w"), os.fdopen(2, "w")
            # As the process's entry point does, which a fork does not pass.
            warnings.simplefilter("ignore")
            _limit(memory)
            if longest is not None:
                resource.setrlimit(resource.RLIMIT_FSIZE, (longest, longest))
            code = _code(main, command)
            sys.stdout.flush()
            sys.stderr.flush()
        finally:
            os._exit(code)
    for _, end in pipes:
        os.close(end)
    with ThreadPoolExecutor(2) as pool:
        out, err = pool.map(_read_all, (end for end, _ in pipes))
    _, status, used = os.wait4(child, 0)
    after = contents(folder)
    changed = sorted(n for n in before.keys() | after.keys() if before.get(n) != after.get(n))
    return Outcome(
        os.waitstatus_to_exitcode(status), out, err, used.ru_utime + used.ru_stime, tuple(changed)
    )


def _read_all(end: int) -> str:
    with os.fdopen(end, errors="replace") as stream:
        return stream.read()


def contents(folder: Path) -> dict[str, bytes | str]:
    """Files of a folder and what is in them, links and folders by what they are."""
    found: dict[str, bytes | str] = {}
    for path in sorted(folder.rglob("*")):
        name = str(path.relative_to(folder))
        if path.is_symlink():
            found[name] = f"link to {os.readlink(path)}"
        elif path.is_file():
            found[name] = path.read_bytes() if path.stat().st_size < 1e8 else "large"
        elif path.is_dir():
            found[name] = "folder"
    return found


def copied(folder: Path, to: Path) -> Path:
    """A fresh copy of a folder: links stay links, files of two names have two, pipes are pipes."""
    shutil.rmtree(to, ignore_errors=True)
    names: dict[int, Path] = {}
    for path in sorted(folder.rglob("*"), key=lambda path: len(path.parts)):
        target = to / path.relative_to(folder)
        target.parent.mkdir(parents=True, exist_ok=True)
        if path.is_symlink():
            target.symlink_to(os.readlink(path))
        elif path.is_fifo():
            os.mkfifo(target)
        elif path.is_dir():
            target.mkdir(exist_ok=True)
        elif path.stat().st_ino in names:
            os.link(names[path.stat().st_ino], target)
        else:
            names[path.stat().st_ino] = Path(shutil.copyfile(path, target))
    return to


def _limit(memory: int) -> None:
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * resource.getpagesize() + memory
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS + 1))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _code(main, command: list[str]) -> int:
    import traceback

    try:
        main(command)
    except SystemExit as end:
        if isinstance(end.code, str):
            print(end.code, file=sys.stderr)
            return 1
        return end.code or 0
    except BaseException:
        traceback.print_exc()
        return 98
    return 0
