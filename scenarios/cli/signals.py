"""Terminating signals: one line says what was written, unfinished files are removed, and the
process ends with the signal's exit code.

Nothing is raised, since an exception can be lost: in a destructor, in what compiled code calls.
"""

import os
import signal
import sys
from collections.abc import Callable
from contextlib import suppress
from os import _exit
from types import FrameType

from surefoot.sim.common.files import remove_unfinished
from surefoot.sim.common.terminal import one_line

ENDING = [getattr(signal, n) for n in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, n)]

_line: Callable[[], str] = lambda: "interrupted before it began"  # noqa: E731


def catch_signals() -> None:
    """End the process on terminating signals.

    Ignored signals remain ignored, as requested by nohup and `command &` in a script.
    """
    for number in ENDING:
        if signal.getsignal(number) not in (signal.SIG_IGN, None):
            signal.signal(number, _end)


def ignore_signals() -> None:
    """Ignore signals at the end of the process: Python restores default handlers before it has
    ended, and a signal would replace the exit code of a finished command.
    """
    for number in ENDING:
        signal.signal(number, signal.SIG_IGN)


def say_if_interrupted(line: Callable[[], str]) -> None:
    """Set the line that is printed when a signal ends the process."""
    global _line
    _line = line


def _end(number: int, _frame: FrameType | None) -> None:
    ignore_signals()
    with suppress(Exception):  # closed streams, and one that is being written to
        sys.stdout.flush()
    with suppress(Exception):
        line = f"{chr(10) * os.isatty(2)}surefoot: {one_line(_line())}\n"
        os.write(2, line.encode(errors="replace"))
    remove_unfinished()
    _exit(128 + number)
