"""The command line: `surefoot COMMAND`. Each command is a dataclass whose fields are its
options.
"""

import os
import sys
from collections.abc import Sequence
from contextlib import redirect_stderr
from dataclasses import fields
from io import StringIO
from itertools import takewhile
from typing import Annotated, Any, Union

import tyro
from tyro.conf import FlagCreatePairsOff, OmitArgPrefixes, subcommand

import surefoot
from surefoot.models.observer.settings import INSTALL_TORCH
from surefoot.scenarios.cli import data, estimate, study
from surefoot.scenarios.cli.runs import guarded
from surefoot.sim.common.errors import SurefootError, did_you_mean
from surefoot.sim.common.plugins import exits_raised, naming_plugins, with_plugins
from surefoot.sim.common.terminal import one_line, plain_terminals, printing_plainly

COMMANDS: dict[str, type] = {
    "demo": study.Demo,
    "simulate": data.Simulate,
    "train": estimate.Train,
    "calibrate": estimate.Calibrate,
    "estimate": estimate.Estimate,
    "compare": estimate.Compare,
    "score": estimate.Score,
    "noise": estimate.NoiseCommand,
    "experiment": study.ExperimentCommand,
    "suite": study.Suite,
    "trace": study.TraceCommand,
    "loop": study.LoopCommand,
    "realism": study.Realism,
    "plan": study.PlanCommand,
    "import": data.Import,
    "info": data.Info,
    "export": data.Export,
    "align": data.Align,
    "view": data.View,
    "robots": data.Robots,
    "new": data.New,
    "tune": study.Tune,
}


ABOUT = """A testbed for legged state estimation from proprioception alone. Begin with `surefoot
demo`, which runs the whole chain in a few minutes. `surefoot COMMAND --help` lists the options of a
command.

--version prints the version. --plugin FILE.py, given with any command and as often as needed, adds
the estimators, effects, channels, architectures, calibrators and gaits of your own that the file
lists in PLUGINS. The file is executed as Python code."""


def _parsed(arguments: Sequence[str]) -> tuple[str, Any]:
    """Parse the command and its name; exits, like tyro, after --help or, with one line, an error.
    Without arguments, help is printed.

    If the command's name comes first, only its parser is built: that is faster, and suggestions for
    a mistyped option are from this command.
    """
    first, *rest = arguments = list(arguments) or ["--help"]
    if first == "--version":
        print(f"surefoot {surefoot.__version__}")
        sys.exit()
    for option in arguments:
        if option.startswith("-") and not option.isprintable():
            raise SurefootError(f"{option}: an option with control characters")
    if first in COMMANDS:
        return first, _command(COMMANDS[first], f"surefoot {first}", rest)
    if not first.startswith("-"):
        hint = did_you_mean(first, COMMANDS) or ";"
        line = one_line(f"surefoot: no command '{first}'{hint} see `surefoot --help`")
        print(line, file=sys.stderr)
        sys.exit(2)
    choices = tuple(Annotated[c, subcommand(n, prefix_name=False)] for n, c in COMMANDS.items())
    command = _command(Union[choices], "surefoot", arguments, ABOUT)  # noqa: UP007
    return next(n for n, kind in COMMANDS.items() if type(command) is kind), command


def _command(kind: Any, prog: str, arguments: Sequence[str], about: str | None = None) -> Any:
    """Read a command's options; what tyro says of an error in a box becomes one line."""
    config, errors = (FlagCreatePairsOff, OmitArgPrefixes), StringIO()
    try:
        with redirect_stderr(errors):
            return tyro.cli(kind, prog=prog, description=about, args=arguments, config=config)
    except SystemExit as end:
        if end.code == 2:
            lines = [line.strip(" │╭╮╰╯|") for line in errors.getvalue().splitlines()]
            said = [line for line in lines if line.strip("─-")][1:]  # below the title
            about_help = ("Argument helptext", "Available subcommands", "For full helptext")
            message = " ".join(takewhile(lambda line: not line.startswith(about_help), said))
            missing, unknown, options = message.partition("Unrecognized options: ")
            if missing and unknown:  # what is missing may be what was mistyped
                known = [f"--{one.name.replace('_', '-')}" for one in fields(kind)]
                message = f"{unknown}{options}{did_you_mean(options.split()[0], known)}"
            message = message.rstrip(".") + ";" * (not message.endswith("?"))
            print(f"surefoot: {message} see `{prog} --help`", file=sys.stderr)
        raise


def main(arguments: Sequence[str] | None = None) -> None:
    """Run one command.

    Bad input is one line on stderr and exit code 1, bad options exit code 2.
    """
    name = ""
    plain_terminals()
    try:
        given = sys.argv[1:] if arguments is None else arguments
        name, command = _parsed(with_plugins(given))
        with printing_plainly(), naming_plugins(), exits_raised(), guarded(name, command):
            command.run()
        sys.stdout.flush()
    except SurefootError as error:
        sys.exit(f"surefoot: {one_line(error)}")
    except BrokenPipeError:
        # The reader of the output is gone; Python would report that once more on exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    except ModuleNotFoundError as error:
        if error.name != "torch":
            raise
        sys.exit(f"surefoot: {name}: {INSTALL_TORCH}")
    except MemoryError:
        sys.exit(f"surefoot: {name}: not enough memory")
    except OSError as error:
        # Files that cannot be written are named where they are; what is left is what was printed.
        at = error.filename or f"{name}: standard output"
        sys.exit(f"surefoot: {one_line(at)}: {error.strerror or error}")
