"""A study as a command: `python -m studies.NAME`."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import tyro

from surefoot.extend import SurefootError
from surefoot.scenarios.cli.signals import catch_signals, say_if_interrupted

OutputFolder = Annotated[Path, tyro.conf.arg(aliases=["-o"])]


def run_study(study: Any, arguments: Sequence[str] | None = None) -> None:
    """Run the study, a dataclass with a method `run`, with these options or the command line's.

    Bad input is one line on stderr and exit code 1, bad options exit code 2. On the command line a
    signal ends the study as it ends a command; finished rows are stored, so the study continues
    when it is run again.
    """
    if arguments is None:
        catch_signals()
        say_if_interrupted(lambda: "interrupted; run the same command to continue")
    options = tyro.cli(study, args=arguments, config=(tyro.conf.FlagCreatePairsOff,))
    try:
        options.run()
    except SurefootError as error:
        sys.exit(f"surefoot: {error}")
