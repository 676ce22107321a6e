"""Where the process begins: from its first import to its last moment, a signal is one line."""

import sys
from collections.abc import Sequence

from surefoot.scenarios.cli.signals import catch_signals, hand_over_lost, ignore_signals
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.plugins import load_plugin


def entry_point() -> None:
    """The command line of the process: imports take a second, in which nothing is to be undone."""
    catch_signals()
    sys.unraisablehook = hand_over_lost
    try:
        arguments = with_plugins(sys.argv[1:])
        # Only now: the choices of options are made when their commands are imported.
        from surefoot.scenarios.cli.main import main

        main(arguments)
    finally:
        ignore_signals()


def with_plugins(arguments: Sequence[str]) -> list[str]:
    """The arguments without `--plugin FILE`, whose files are loaded; ends where one cannot be."""
    others, rest = [], iter(arguments)
    for one in rest:
        if one != "--plugin" and not one.startswith("--plugin="):
            others.append(one)
            continue
        try:
            load_plugin(one.partition("=")[2] or next(rest, ""))
        except SurefootError as error:
            sys.exit(f"surefoot: {error}")
    return others
