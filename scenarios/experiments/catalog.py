"""Location of an experiment's file, by name or path."""

from pathlib import Path

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.files import bundled, is_file

SUITES_FOLDER = bundled("surefoot.scenarios.experiments", "suites")
SUITES = ("spot", "vision60")


def experiment_file(name_or_path: str | Path) -> Path:
    """The file of an experiment: a path, or the name of a bundled suite.

    Raises SurefootError, listing the names, where it is neither.
    """
    if str(name_or_path) in SUITES:
        return SUITES_FOLDER / f"{name_or_path}.toml"
    path = Path(name_or_path)
    if not is_file(path):
        raise SurefootError(f"experiment {path}: no such file; bundled are {', '.join(SUITES)}")
    return path
