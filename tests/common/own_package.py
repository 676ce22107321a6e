"""Run surefoot with a package of a user's own on the path: a folder below tests/packages."""

import os
from pathlib import Path

from processes import python

COMMON = Path(__file__).resolve().parent
PACKAGES = COMMON.parent / "packages"
WALK = """
name = "walk"
robot = "spot_class"
[[segment]]
duration = 2.0
forward = 0.5
"""


def run_with(package: str, *arguments: str, cwd: Path | None = None):
    """`python ARGUMENTS` where tests/packages/PACKAGE, a module and its .dist-info, is found.

    In a process of its own, and not installed: no other test sees it.
    """
    folders = [str(PACKAGES / package), str(COMMON), *filter(None, [os.environ.get("PYTHONPATH")])]
    return python(*arguments, cwd=cwd, env={"PYTHONPATH": os.pathsep.join(folders)})


def lines_of_script(package: str, script: str, observer: str, folder: Path) -> list[str]:
    """What a script prints beside an experiment file, `grid.toml`, with that line in [observer].

    Args:
        package: of the user, whose names the experiment may use.
        script: its text.
        observer: a line of the experiment's [observer].
        folder: to run it in.
    """
    (folder / "grid.toml").write_text(f'scenarios = ["walk.toml"]\n[observer]\n{observer}\n')
    (folder / "walk.toml").write_text(WALK)
    file = folder / "use.py"
    file.write_text(script)
    done = run_with(package, str(file), cwd=folder)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()
