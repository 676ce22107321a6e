"""A file of a recording, of any kind, as a table: the kind follows from its name."""

from collections.abc import Collection
from pathlib import Path
from typing import Any

from surefoot.sim.common.errors import parsed_as
from surefoot.sim.common.limits import admitted
from surefoot.sim.importing.readers.array_file import read_hdf5, read_mat, read_npz, read_parquet
from surefoot.sim.importing.readers.bag import is_bag, read_bag
from surefoot.sim.importing.readers.json_file import read_json
from surefoot.sim.importing.readers.table import RecordedTable, with_stamps
from surefoot.sim.importing.readers.text import layout_of, read_text
from surefoot.sim.importing.sections import Source

_READERS = {
    **dict.fromkeys((".json", ".jsonl", ".ndjson"), read_json),
    **dict.fromkeys((".npz", ".npy"), read_npz),
    **dict.fromkeys((".h5", ".hdf5"), read_hdf5),
    ".mat": read_mat,
    ".parquet": read_parquet,
}
"""Reader by suffix; any other file, if it is no bag, is read as text."""


def read_file(path: Path, source: Source, columns: Collection[str] | None = None) -> RecordedTable:
    """Read the table of a file. Raises SurefootError.

    Args:
        path: of the file, or of a bag's folder.
        source: its layout, for a text.
        columns: those that are needed of a bag, which takes long to read; all by default.
    """
    if is_bag(path):
        return read_bag(path, columns)
    admitted(path, "recording")
    reader = _READERS.get(path.suffix.lower())
    remedy = "; save arrays of numbers anew, by np.savez" if reader is read_npz else ""
    what = f"{path.suffix} file" if reader else "table of text"
    with parsed_as(f"a readable {what}", path, remedy):
        return with_stamps(reader(path) if reader else read_text(path, source))


def detected_layout(path: Path) -> dict[str, Any]:
    """Keys of a map's [source] for a text where the defaults do not fit; none for other files."""
    if is_bag(path) or path.suffix.lower() in _READERS:
        return {}
    admitted(path, "recording")
    return layout_of(path)
