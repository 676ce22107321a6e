"""Where the process begins: from its first import on, an interruption is one line."""

import os
import signal
import sys
from types import FrameType


def _leave(number: int, _frame: FrameType | None) -> None:
    print("surefoot: interrupted before it began", file=sys.stderr, flush=True)
    os._exit(128 + number)


def entry_point() -> None:
    """The command line of the process: imports take a second, in which nothing is to be undone."""
    for name in ("SIGINT", "SIGTERM"):
        signal.signal(getattr(signal, name), _leave)
    from surefoot.scenarios.cli.main import main

    main()
