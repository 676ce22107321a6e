"""Python in a process of its own, and commands in this one."""

import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from surefoot.scenarios.cli.main import main


def python(
    *arguments: object,
    cwd: Path | None = None,
    env: Mapping[str, str] | None = None,
    timeout: float | None = 300.0,
) -> subprocess.CompletedProcess[str]:
    """How `python ARGUMENTS` ended, what it printed included.

    env: variables beside those of this process; timeout in s.
    """
    return subprocess.run(
        [sys.executable, *map(str, arguments)],
        cwd=cwd,
        env={**os.environ, **(env or {})},
        capture_output=True,
        text=True,
        check=False,
        timeout=timeout,
    )


def printed(*arguments: object, **options: Any) -> str:
    """What `python ARGUMENTS` prints, which must end well; options are those of `python`."""
    done = python(*arguments, **options)
    assert done.returncode == 0, done.stderr[-4000:]
    return done.stdout


def ended(line: str) -> str | int | None:
    """Exit code or message of a command, run in this process; None where all is well."""
    try:
        main(line.split())
    except SystemExit as stop:
        return stop.code
    return None
