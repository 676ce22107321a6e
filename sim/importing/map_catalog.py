"""Location of an import map's file, by name or path."""

from pathlib import Path

from surefoot.sim.common.files import bundled, named_file


def bundled_maps() -> dict[str, Path]:
    """Name -> file of the bundled maps, such as "go1_square"."""
    files = bundled("surefoot.sim.importing", "maps").glob("*.toml")
    return {file.stem: file for file in sorted(files)}


def map_file(name_or_path: str | Path) -> Path:
    """The file of a map: a path, or the name of a bundled one, with or without its suffix.

    Raises SurefootError, listing the names, where it is neither.
    """
    return named_file("import map", Path(name_or_path), str(name_or_path), bundled_maps())
