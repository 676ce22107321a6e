"""Entry point of the process, in which a signal is one line from the first import to the end."""

import gc
import importlib
import os
import re
import sys

from surefoot.scenarios.cli.signals import catch_signals, hand_over_lost, ignore_signals
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.plugins import with_plugins

THREADS = ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS")
"""Variables whose errors the libraries that read them report by a traceback."""

BACKENDS = {"MPLBACKEND": "matplotlib", "MUJOCO_GL": "mujoco"}
"""Variables that name a way to draw -> module that fails to be imported if it has no such one."""


COLLECTION = (10_000, 50, 100)
"""Thresholds of Python's garbage collector. The imports and the compiled kernels leave half a
million objects, which the usual thresholds go through again and again; cycles are rare.
"""


def entry_point() -> None:
    """The command line; during the imports, which take a second, there is nothing to undo."""
    catch_signals()
    gc.set_threshold(*COLLECTION)
    # No window is opened: MuJoCo would look for a library of them in a process of its own, whose
    # traceback a signal would leave on the terminal.
    os.environ.setdefault("MUJOCO_GL", "disable")
    # The matrices are small: with more threads numpy only waits, an eighth of a trace's CPU time.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    sys.unraisablehook = hand_over_lost
    try:
        try:
            _check_threads()
            _check_date()
            _check_backends()
            arguments = with_plugins(sys.argv[1:])
            # Only now, for the choices of options are determined when their commands are imported.
            from surefoot.scenarios.cli.main import main
        except SurefootError as error:
            sys.exit(f"surefoot: {error}")
        main(arguments)
    finally:
        ignore_signals()


def _check_threads() -> None:
    """Raise SurefootError for a number of threads in the environment that is none; an empty one is
    as if it were not set.
    """
    for name in THREADS:
        text = os.environ.get(name, "").strip()
        if text and not re.fullmatch("0*[1-9][0-9]{0,5}", text):
            raise SurefootError(f"{name} must be a whole number above zero, is '{text}'")


def _check_date() -> None:
    """Raise SurefootError for a SOURCE_DATE_EPOCH that is no number of seconds; an empty one is as
    if it were not set.
    """
    text = os.environ.get("SOURCE_DATE_EPOCH")
    if text is None:
        return
    if not text.strip():
        del os.environ["SOURCE_DATE_EPOCH"]
    elif not re.fullmatch("[0-9]{1,11}", text.strip()):
        raise SurefootError(f"SOURCE_DATE_EPOCH must be a whole number of seconds, is '{text}'")


def _check_backends() -> None:
    """Raise SurefootError for a backend that its library does not know; the library is imported
    only where the user has chosen one.
    """
    for name, library in BACKENDS.items():
        text = os.environ.get(name)
        if not text or text == "disable":
            continue
        try:
            importlib.import_module(library)
        except Exception as error:
            raise SurefootError(f"{name}='{text}': {library} has no such backend") from error
