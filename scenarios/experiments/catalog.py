"""Location of an experiment's file, by name or path."""

from pathlib import Path

from surefoot.sim.common.files import bundled, named_file

SUITES_FOLDER = bundled("surefoot.scenarios.experiments", "suites")
SUITES = {name: SUITES_FOLDER / f"{name}.toml" for name in ("spot", "vision60")}


def experiment_file(name_or_path: str | Path) -> Path:
    """The file of an experiment: a path, or the name of a bundled suite.

    Raises SurefootError, listing the names, where it is neither.
    """
    return named_file("experiment", Path(name_or_path), str(name_or_path), SUITES)
