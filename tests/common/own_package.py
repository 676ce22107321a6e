"""Run surefoot with a package of a user's own on the path: a folder below tests/packages."""

import os
import subprocess
import sys
from pathlib import Path

PACKAGES = Path(__file__).resolve().parents[1] / "packages"


def run_with(package: str, *arguments: str, cwd: Path | None = None) -> subprocess.CompletedProcess:
    """`python ARGUMENTS` where tests/packages/PACKAGE, a module and its .dist-info, is found.

    In a process of its own, and not installed: no other test sees it.
    """
    path = os.pathsep.join([str(PACKAGES / package), *filter(None, [os.environ.get("PYTHONPATH")])])
    return subprocess.run(
        [sys.executable, *arguments],
        env=os.environ | {"PYTHONPATH": path},
        cwd=cwd,
        capture_output=True,
        text=True,
        timeout=300,
    )
