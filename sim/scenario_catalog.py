"""Files of scenarios, by name or path."""

from pathlib import Path

from surefoot.sim.common.files import bundled, named_file


def bundled_scenarios() -> dict[str, Path]:
    """Names and files of the bundled scenarios, such as "demo/walk"."""
    files = bundled("surefoot.scenarios", "courses").glob("*/*.toml")
    return {f"{file.parent.name}/{file.stem}": file for file in sorted(files)}


def scenario_file(name_or_path: str | Path, folder: Path = Path()) -> Path:
    """The file of a scenario: a path, relative to `folder`, or the name of a bundled one.

    Raises SurefootError, listing the names, if it is neither.
    """
    return named_file("scenario", folder / name_or_path, str(name_or_path), bundled_scenarios())
