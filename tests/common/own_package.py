"""Run surefoot with a package of a user's own on the path: a folder below tests/packages."""

import os
import subprocess
import sys
from pathlib import Path

COMMON = Path(__file__).resolve().parent
PACKAGES = COMMON.parent / "packages"


def run_with(package: str, *arguments: str, cwd: Path | None = None) -> subprocess.CompletedProcess:
    """`python ARGUMENTS` where tests/packages/PACKAGE, a module and its .dist-info, is found.

    In a process of its own, and not installed: no other test sees it.
    """
    folders = [str(PACKAGES / package), str(COMMON), *filter(None, [os.environ.get("PYTHONPATH")])]
    return subprocess.run(
        [sys.executable, *arguments],
        env=os.environ | {"PYTHONPATH": os.pathsep.join(folders)},
        cwd=cwd,
        capture_output=True,
        text=True,
        timeout=300,
    )
