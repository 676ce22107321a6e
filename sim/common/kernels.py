"""`kernel` compiles a function with numba and caches the machine code in the user's cache folder.

numba's own cache only checks a kernel's own file. If a kernel calls one from another file, and that
file changes, numba silently runs the old code. Here the name of the cache folder is a digest of the
kernel's module and of all modules that it imports.
"""

import shutil
import sys
import time
from collections.abc import Callable
from pathlib import Path
from threading import Lock
from typing import Any

from numba import njit
from numba.core import config, event

from surefoot.sim.common.files import cache_folder
from surefoot.sim.common.sources import sources_digest

KERNEL_LIFETIME = 30 * 86400.0
"""Time after which unused machine code is deleted [s]."""

COMPILE_TIME = 75.0
"""Measured time to compile a walk and the filters `leg` and `imu` on one core at 3 GHz [s]; a walk
alone takes 28 s.
"""

_lock = Lock()
_swept: set[Path] = set()


def kernel(function: Any = None, *, signature: str | None = None, **options: Any) -> Any:
    """Compile a function: `numba.njit` with a cache that notices changes in imported modules.

    Args:
        function: the decorated function, if the decorator is used without parentheses.
        signature: of the arguments, to compile immediately instead of at the first call.
        options: of `numba.njit`, such as nogil and error_model.
    """
    if function is None:
        return lambda f: kernel(f, signature=signature, **options)
    compiler: Any = njit
    arguments = (signature,) if signature else ()
    with _lock:
        kept = config.CACHE_DIR
        # numba decides where a kernel's code lies when it is decorated.
        config.CACHE_DIR = str(_folder(function))
        try:
            return compiler(*arguments, cache=True, **options)(function)
        finally:
            config.CACHE_DIR = kept


def _folder(function: Callable) -> Path:
    """Folder for the machine code of a function's module."""
    module = sys.modules.get(function.__module__)
    file = getattr(module, "__file__", None) or function.__code__.co_filename
    root = cache_folder() / "kernels"
    folder = root / sources_digest(function.__module__, file)[:16]
    if folder not in _swept:
        _swept.add(folder)
        _touch(folder)
        _sweep(root)
    return folder


def _touch(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "used").touch()
    except OSError:
        return  # nothing can be kept there: numba falls back to another place, or says so


def _sweep(root: Path) -> None:
    if root in _swept:
        return
    _swept.add(root)
    for stamp in root.glob("*/used"):
        try:
            if time.time() - stamp.stat().st_mtime > KERNEL_LIFETIME:
                shutil.rmtree(stamp.parent, ignore_errors=True)
        except OSError:
            continue


class _CompilationNotice(event.Listener):
    """Prints a line on a terminal while kernels are compiled for the first time."""

    def __init__(self):
        self._said = False

    def on_start(self, event: event.Event) -> None:
        if not self._said and sys.stderr.isatty():
            print(f"compiling once, up to {COMPILE_TIME:.0f} s", file=sys.stderr, flush=True)
        self._said = True

    def on_end(self, event: event.Event) -> None:
        return


event.register("numba:compile", _CompilationNotice())
