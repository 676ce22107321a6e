"""A study as a command: `python -m studies.NAME`."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import tyro

from surefoot.extend import SurefootError
from surefoot.scenarios.cli.signals import Interrupted, interruptions, unwrapped

OutputFolder = Annotated[Path, tyro.conf.arg(aliases=["-o"])]


def run_study(study: Any, arguments: Sequence[str] | None = None) -> None:
    """Run the study, a dataclass with a method `run`, with these options or the command line's.

    Bad input is one line on stderr and exit code 1, bad options exit code 2, an interruption 128
    plus the signal's number, as of surefoot's own commands. Finished rows are stored, so the same
    command continues.
    """
    options = tyro.cli(study, args=arguments, config=(tyro.conf.FlagCreatePairsOff,))
    try:
        with interruptions(), unwrapped():
            options.run()
    except SurefootError as error:
        sys.exit(f"surefoot: {error}")
    except Interrupted as stop:
        print("\nsurefoot: interrupted; run the same command to continue", file=sys.stderr)
        sys.exit(128 + stop.number)
