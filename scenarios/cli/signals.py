"""Terminating signals: the process prints one line and ends with the signal's exit code.

Before a command starts the process ends immediately. During a command signals are raised as
Interrupted. After it they are ignored, since its results are complete.
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
"""Time after the first signal from which a second one ends the process immediately [s]. An earlier
one is a repetition, as sent by `timeout` and some terminals.
"""

_phase = "before"
_first: float | None = None


class Interrupted(KeyboardInterrupt):
    """A terminating signal, from the keyboard or another process.

    written: outputs that were already complete when it came.
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
    """Install handlers for terminating signals; returns the previous ones.

    Ignored signals remain ignored, as requested by nohup and `command &` in a script.
    """
    taken = [n for n in ENDING if signal.getsignal(n) not in (signal.SIG_IGN, None)]
    return {number: signal.signal(number, _end) for number in taken}


@contextmanager
def interruptions() -> Iterator[None]:
    """Context in which terminating signals raise Interrupted."""
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
    """Context in which an Interrupted that a library converted to another exception is raised
    itself.

    Signals are handled between two instructions of Python, also in code called from compiled code
    (numba reads a kernel from its cache this way), where it becomes the cause of a SystemError.
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
    """Ignore signals at the end of the process: Python restores default handlers before it has
    ended, and a signal would replace the exit code of a finished command.
    """
    for number in ENDING:
        signal.signal(number, signal.SIG_IGN)


def hand_over_lost(unraisable: "sys.UnraisableHookArgs") -> None:
    """A `sys.unraisablehook` that sends an Interrupted again if it came where nothing can be
    raised, such as in a destructor; all else is reported as usual.
    """
    global _first
    lost = unraisable.exc_value
    if not isinstance(lost, Interrupted):
        sys.__unraisablehook__(unraisable)
        return
    _first = None
    threading.Timer(0.02, os.kill, (os.getpid(), lost.number)).start()
