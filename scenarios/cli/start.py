"""Where the process begins: from its first import to its last moment, a signal is one line."""

import sys

from surefoot.scenarios.cli.signals import catch_signals, hand_over_lost, ignore_signals


def entry_point() -> None:
    """The command line of the process: imports take a second, in which nothing is to be undone."""
    catch_signals()
    sys.unraisablehook = hand_over_lost
    from surefoot.scenarios.cli.main import main

    try:
        main()
    finally:
        ignore_signals()
