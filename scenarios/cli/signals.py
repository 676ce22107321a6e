"""Signals that end a process: one line and the signal's exit code, whenever they come.

Before a command begins there is nothing to undo, and the process ends at once. Within one they are
raised as Interrupted. After it, what it did stands, and they change nothing.
"""

import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

ENDING = [getattr(signal, n) for n in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, n)]
AGAIN = 1.0
"""s: a signal that comes later than this after the first one ends the process at once. Sooner it is
the same one, which `timeout` and some terminals send twice."""

_phase = "before"
_first: float | None = None


class Interrupted(KeyboardInterrupt):
    """A signal to end, from the keyboard or from another process.

    written: outputs that were there already, and whole, when it came.
    """

    def __init__(self, number: int):
        super().__init__()
        self.number = number
        self.written: list[str] = []


def _end(number: int, _frame: FrameType | None) -> None:
    global _first
    if _phase == "before":
        os.write(2, b"surefoot: interrupted before it began\n")
        os._exit(128 + number)
    if _phase == "within" and _first is None:
        _first = time.monotonic()
        raise Interrupted(number)
    if _phase == "within" and _first is not None and time.monotonic() - _first > AGAIN:
        os._exit(128 + number)


def catch_signals() -> dict[int, object]:
    """Take over the signals that end; returns who had them.

    Those that are ignored stay so: nohup and `command &` in a script ask for that.
    """
    taken = [n for n in ENDING if signal.getsignal(n) not in (signal.SIG_IGN, None)]
    return {number: signal.signal(number, _end) for number in taken}


@contextmanager
def interruptions() -> Iterator[None]:
    """While it lasts, signals that end raise Interrupted."""
    global _phase, _first
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = catch_signals()
    _phase, _first = "within", None
    try:
        yield
    finally:
        _phase = "after"
        for number, handler in before.items():
            signal.signal(number, handler)  # pyright: ignore[reportArgumentType]


@contextmanager
def unwrapped() -> Iterator[None]:
    """While it lasts, an Interrupted that a library turned into an error of its own is raised.

    Signals are taken between two instructions of Python, also in what compiled code calls (numba
    reads a kernel from its cache so): there it becomes the cause of a SystemError.
    """
    try:
        yield
    except Exception as error:
        cause: BaseException | None = error
        while cause is not None and not isinstance(cause, Interrupted):
            cause = cause.__cause__ or cause.__context__
        if cause is None:
            raise
        raise cause from None


def ignore_signals() -> None:
    """For the process's last moments: Python puts default handlers back before it has ended, and a
    signal would take the exit code from a command that is done."""
    for number in ENDING:
        signal.signal(number, signal.SIG_IGN)


def hand_over_lost(unraisable: "sys.UnraisableHookArgs") -> None:
    """As `sys.unraisablehook`: an Interrupted that came where nothing can be raised, such as in a
    destructor, comes again a moment later; all else is reported as ever."""
    global _first
    lost = unraisable.exc_value
    if not isinstance(lost, Interrupted):
        sys.__unraisablehook__(unraisable)
        return
    _first = None
    threading.Timer(0.02, os.kill, (os.getpid(), lost.number)).start()
