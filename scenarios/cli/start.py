"""Entry point of the process, which handles signals from the first import to the end."""

import gc
import importlib
import os
import re
import sys
import warnings

from surefoot.scenarios.cli.signals import catch_signals, ignore_signals
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.plugins import with_plugins
from surefoot.sim.common.terminal import one_line

THREADS = "0*[1-9][0-9]{0,5}", "a whole number above zero"
NUMBERS = {
    "OMP_NUM_THREADS": THREADS,
    "NUMBA_NUM_THREADS": THREADS,
    "SOURCE_DATE_EPOCH": ("[0-9]{1,11}", "a whole number of seconds"),
}
"""Environment variable -> pattern and words of its values, which are checked here, since libraries
would raise a traceback.
"""

BACKENDS = {"MPLBACKEND": "matplotlib", "MUJOCO_GL": "mujoco"}
"""Environment variable of a graphics backend -> module whose import fails for an unknown one."""


def entry_point() -> None:
    """Run the command line; environment variables and plug-ins are checked first."""
    catch_signals()
    # Imports and compiled kernels leave half a million objects, which the default thresholds of the
    # garbage collector scan again and again; cycles are rare.
    gc.set_threshold(10_000, 50, 100)
    # Of libraries, such as a mean of nothing: what matters to a user, a command says itself.
    if not sys.warnoptions:
        warnings.simplefilter("ignore")
        os.environ["PYTHONWARNINGS"] = "ignore"  # in parallel processes too
    # No window is opened. Otherwise MuJoCo looks for a windowing library in another process, whose
    # traceback would appear on the terminal after a signal.
    os.environ.setdefault("MUJOCO_GL", "disable")
    # For small matrices more threads only wait, for an eighth of a trace's CPU time.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        _check_environment()
        arguments = with_plugins(sys.argv[1:])
        # Imported after the plug-ins, since importing the commands fixes the choices of options.
        from surefoot.scenarios.cli.main import main

        main(arguments)
    except SurefootError as error:
        sys.exit(f"surefoot: {one_line(error)}")
    finally:
        ignore_signals()


def _check_environment() -> None:
    """Raise SurefootError for an invalid number in the environment, or for a backend that its
    library does not know; the library is imported only where the user has chosen one. An empty
    number is unset.
    """
    for name, (pattern, what) in NUMBERS.items():
        text = os.environ.get(name, "").strip()
        if not text:
            os.environ.pop(name, None)
        elif not re.fullmatch(pattern, text):
            raise SurefootError(f"{name} must be {what}, is '{text}'")
    for name, library in BACKENDS.items():
        if (text := os.environ.get(name)) not in (None, "", "disable"):
            try:
                importlib.import_module(library)
            except Exception as error:
                raise SurefootError(f"{name}='{text}': {library} has no such backend") from error
