"""`kernel` compiles a function with numba and caches the machine code in the user's cache folder.

numba's own cache only checks a kernel's own file. If a kernel calls one from another file, and that
file changes, numba silently runs the old code. Here the name of the cache folder is a digest of the
kernel's module and of all modules that it imports. `mujoco_function` makes a function of MuJoCo
callable from kernels.
"""

import ctypes
import gc
import shutil
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from llvmlite import binding
from numba import njit, types
from numba.core import config, event
from numba.core.caching import CompileResultCacheImpl, FunctionCache, UserProvidedCacheLocator

from surefoot.sim.common.files import cache_folder
from surefoot.sim.common.sources import sources_digest

KERNEL_LIFETIME = 30 * 86400.0
"""Time after which unused machine code is deleted [s]."""

COMPILE_TIME = 75.0
"""Upper limit of the time to compile a walk and the filters `leg` and `imu` on one core [s]; it was
measured at 57 s, for a walk alone at 22 s.
"""

RARE_COLLECTION = (100_000, 50, 100)
"""Thresholds of Python's garbage collector while kernels are compiled. numba makes millions of
objects and hardly any garbage: with the usual thresholds, collecting took an eighth of the time.
"""

QUIET_TIME = 3.0
"""Compilation time after which the notice is also printed to a file or pipe [s]."""

_USED = "used"
"""File in a folder of machine code that was touched when the code was last used."""
_swept: set[Path] = set()
_compiled: set[Any] = set()


def kernel(function: Any = None, **options: Any) -> Any:
    """Compile a function: `numba.njit` with a cache that notices changes in imported modules.

    Args:
        function: the decorated function, if the decorator is used without parentheses.
        options: of `numba.njit`, such as nogil and error_model. A function with inline="always" is
            compiled as a part of its callers. For the gait, where each function is called from one
            place, that saves a seventh of the time to compile a walk; a function with many callers
            would be compiled many times.
    """
    if function is None:
        return lambda f: kernel(f, **options)
    compiler: Any = njit
    # No kernel is called through a pointer of C, so the wrapper for that is left out.
    made = compiler(no_cfunc_wrapper=True, **options)(function)
    if not config.DISABLE_JIT:
        made._cache = _Cache(function)
    return made


class _Locator(UserProvidedCacheLocator):
    """The cache folder, whether or not it can be written to; numba would use the package's.

    Its name stands for the contents of the sources, so that checkouts and installations of the same
    code share it; neither their path nor their time matters.
    """

    def __init__(self, function: Any, _file: str):
        self._cache_path, self._lineno = str(_folder(function)), function.__code__.co_firstlineno

    @classmethod
    def from_function(cls, py_func: Any, py_file: str) -> "_Locator":
        return cls(py_func, py_file)

    def get_source_stamp(self) -> bytes:
        return b""


class _Implementation(CompileResultCacheImpl):
    _locator_classes = [_Locator]  # noqa: RUF012


class _Cache(FunctionCache):
    """numba's cache, which keeps nothing where the folder is full or cannot be written to."""

    _impl_class = _Implementation

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        with suppress(OSError):
            return super().load_overload(sig, target_context)

    def save_overload(self, sig: Any, data: Any) -> None:
        with suppress(OSError):
            super().save_overload(sig, data)


OWN_1, OWN_2 = types.float64[::1], types.float64[:, ::1]
"""Types of a kernel's own arrays, one- and two-dimensional, contiguous."""
GIVEN_1, GIVEN_2 = (
    types.Array(types.float64, n, "C", readonly=True, aligned=False) for n in (1, 2)
)
"""Types of a caller's contiguous arrays, which may be read-only."""


def compiled(function: Any, signature: Any) -> Any:
    """A kernel, compiled for one signature when first asked for; it raises TypeError on other
    arguments.
    """
    if function not in _compiled:
        if not config.DISABLE_JIT and not function.signatures:
            function.compile(signature)
            function.disable_compile()
        _compiled.add(function)
    return function


def lacks_code(module: str) -> bool:
    """Whether the cache has no machine code of an imported module's kernels, but can keep it."""
    with suppress(OSError):
        folder = _folder_of(module, getattr(sys.modules.get(module), "__file__", None))
        return (folder / _USED).exists() and not any(folder.glob("*.nbi"))
    return False


def _folder_of(module: str, file: str | None) -> Path:
    return cache_folder() / "kernels" / sources_digest(module, file)[:16]


def _folder(function: Callable) -> Path:
    """Folder for the machine code of a function's module."""
    module = sys.modules.get(function.__module__)
    file = getattr(module, "__file__", None) or function.__code__.co_filename
    folder = _folder_of(function.__module__, file)
    with suppress(OSError):
        _sweep(folder.parent, folder)
    return folder


def _sweep(root: Path, folder: Path) -> None:
    """Note that a folder is used, and delete those that have not been for KERNEL_LIFETIME."""
    if folder in _swept:
        return
    _swept.add(folder)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / _USED).touch()
    if root in _swept:
        return
    _swept.add(root)
    for stamp in root.glob(f"*/{_USED}"):
        with suppress(OSError):
            if time.time() - stamp.stat().st_mtime > KERNEL_LIFETIME:
                shutil.rmtree(stamp.parent, ignore_errors=True)


class _Compilation(event.Listener):
    """Collects garbage rarely while kernels are compiled, and prints a line the first time: on a
    terminal at once, elsewhere if it takes longer than QUIET_TIME.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic):
        self._clock = clock
        self.said = False
        self._depth, self._began, self._usual = 0, 0.0, gc.get_threshold()

    def on_start(self, event: event.Event) -> None:
        # A kernel's compilation contains those of the functions that it calls.
        if self._depth == 0:
            self._began, self._usual = self._clock(), gc.get_threshold()
            if gc.isenabled():
                gc.set_threshold(*RARE_COLLECTION)
        self._depth += 1
        is_long = self._clock() - self._began > QUIET_TIME
        if not self.said and (is_long or sys.stderr.isatty()):
            print(f"compiling once, up to {COMPILE_TIME:.0f} s", file=sys.stderr, flush=True)
            self.said = True

    def on_end(self, event: event.Event) -> None:
        self._depth -= 1
        if self._depth == 0:
            gc.set_threshold(*self._usual)


_compilation = _Compilation()
event.register("numba:compile", _compilation)


def compile_quietly() -> None:
    """Print no notice in this process, which compiles beside one that does."""
    _compilation.said = True


_C_TYPES = {types.intc: ctypes.c_int, types.uintp: ctypes.c_void_p}


def mujoco_function(name: str, *arguments: types.Type) -> Callable[..., None]:
    """A function of MuJoCo's library on a model and its data, callable from kernels.

    Args:
        name: of the function, which returns nothing.
        arguments: types of those that follow the addresses of model and data.
    """
    import mujoco  # which not every kernel needs

    folder = Path(mujoco.__file__).parent
    file = next(file for form in ("libmujoco*", "mujoco.dll") for file in folder.glob(form))
    function = getattr(ctypes.CDLL(str(file)), name)  # the library that the package has loaded
    if config.DISABLE_JIT:
        accepted = (ctypes.c_void_p, ctypes.c_void_p, *(_C_TYPES[one] for one in arguments))
        function.argtypes, function.restype = accepted, None
        return function
    binding.add_symbol(name, ctypes.cast(function, ctypes.c_void_p).value)
    # Compiled code refers to the function by its name, so that it can be cached.
    return types.ExternalFunction(name, types.void(types.uintp, types.uintp, *arguments))
