"""Functions of the library that the mujoco package has loaded, for compiled loops."""

import ctypes
from collections.abc import Callable
from pathlib import Path

import mujoco
from llvmlite import binding
from numba import types
from numba.core import config

_C_TYPES = {types.intc: ctypes.c_int, types.uintp: ctypes.c_void_p}


def mujoco_library() -> ctypes.CDLL:
    """The shared library that the mujoco package has loaded."""
    folder = Path(mujoco.__file__).parent
    return ctypes.CDLL(str(next(f for g in ("libmujoco*", "mujoco.dll") for f in folder.glob(g))))


def mujoco_function(name: str, *arguments: types.Type) -> Callable[..., None]:
    """A function of MuJoCo's library on a model and its data, callable from kernels.

    Args:
        name: of the function, which returns nothing.
        arguments: types of those that follow the addresses of model and data.
    """
    function = getattr(mujoco_library(), name)
    if config.DISABLE_JIT:
        accepted = (ctypes.c_void_p, ctypes.c_void_p, *(_C_TYPES[one] for one in arguments))
        function.argtypes, function.restype = accepted, None
        return function
    binding.add_symbol(name, ctypes.cast(function, ctypes.c_void_p).value)
    # Compiled code refers to the function by its name, so that it can be cached.
    return types.ExternalFunction(name, types.void(types.uintp, types.uintp, *arguments))
