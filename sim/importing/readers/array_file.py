"""Tables from files of arrays: NumPy, MATLAB, HDF5 and Parquet.

No code in a file is executed, and a file that declares itself larger than a log is not read.
"""

import struct
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path

import h5py
import numpy as np
import pyarrow.parquet as pq
import scipy.io

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.limits import check_limit, check_unpacked
from surefoot.sim.importing.readers.table import RecordedTable

_MAT_HEADER, _MAT_COMPRESSED = 128, 15
"""Size of the header of a MATLAB version 5 file in bytes, and type of a compressed element
(MAT-File Format, MathWorks).
"""
MOST_NAMES, _LONGEST_NAME = 100, 200
"""Largest number of words in a list of joints, and of letters in one of HDF5."""
PARAMETERS = "parameters: not one for each row"
"""Why an array or number of a file is no column."""
_NESTED = 24
"""Further bytes in memory of a value in a list or record of Parquet."""
_DEEPEST = 20
"""Maximum depth of nested groups."""


def read_npz(path: Path) -> RecordedTable:
    """Read the arrays of a .npz, or that of a .npy as `array`. Raises SurefootError."""
    if path.suffix == ".npy":
        found = np.load(path, mmap_mode="r", allow_pickle=False)
        _bounded(path, found.size * max(found.dtype.itemsize, 1))
        return _table(path, {"array": np.array(found)})
    with np.load(path, allow_pickle=False) as file:
        members = file.zip.infolist()
        check_limit("columns", len(members), f"{path}: arrays")
        _bounded(path, sum(one.file_size for one in members))
        return _table(path, {name: file[name] for name in file.files})


def read_mat(path: Path) -> RecordedTable:
    """Read the arrays of a MATLAB file of any version; a field of a struct is `struct.field`."""
    if h5py.is_hdf5(path):
        return read_hdf5(path)
    _bound_inflated(path)
    found = scipy.io.loadmat(path, squeeze_me=True)
    return _table(path, {n: v for n, v in found.items() if not n.startswith("__")})


def read_hdf5(path: Path) -> RecordedTable:
    """Read the datasets of an HDF5 file by their path; MATLAB's are transposed to have rows first.

    Links, groups nested deeper than 20 and MATLAB's objects, such as a timeseries, are ignored.
    Raises SurefootError for a file that declares itself too large, or lies in several files.
    """
    arrays: dict[str, np.ndarray] = {}
    with h5py.File(path, "r") as file:
        every = dict[str, h5py.Dataset]()
        for name, node in _datasets(file, "", {file}):
            if node.is_virtual or node.external:
                raise SurefootError(f"{path}: {name} lies in another file, which is not read")
            every[name] = node
            check_limit("columns", len(every), f"{path}: datasets")
        found = {
            name: node
            for name, node in every.items()
            if node.size and not name.startswith("#") and "MATLAB_object_decode" not in node.attrs
        }
        # A chunk is unpacked as a whole, however little of it the array has.
        held = [(np.prod(np.maximum(d.shape, d.chunks or 0)), d) for d in every.values() if d.shape]
        _bounded(path, sum(float(size) * one.dtype.itemsize for size, one in held))
        for name, node in found.items():
            if node.dtype.kind in "fiubc" or node.dtype.names:
                values = node[()]
                arrays[name] = values.T if "MATLAB_class" in node.attrs else values
            elif h5py.check_string_dtype(node.dtype) and node.ndim == 1 and len(node) <= MOST_NAMES:
                texts = (node.asstr(errors="replace")[k] for k in range(len(node)))
                arrays[name] = np.array([text[:_LONGEST_NAME] for text in texts])
        return _table(path, arrays | _matlab_strings(every))


def read_parquet(path: Path) -> RecordedTable:
    """Read the columns of a Parquet file, but no lists of texts, of which no column can be made.

    A text is unpacked once for all cells that have it. Raises SurefootError.
    """
    about = pq.read_metadata(path)
    check_limit("items", about.num_columns * about.num_row_groups, f"{path}: parts of columns")
    columns = [about.schema.column(k) for k in range(about.num_columns)]
    size = 0.0
    for k, one in enumerate(columns):
        chunks = (about.row_group(group).column(k) for group in range(about.num_row_groups))
        each = 8 + one.length + _NESTED * ("." in one.path)
        size += sum(max(each * chunk.num_values, chunk.total_uncompressed_size) for chunk in chunks)
    _bounded(path, size)
    texts = [one.path for one in columns if one.physical_type == "BYTE_ARRAY"]
    read = [one.path for one in columns if one.path not in texts or not one.max_repetition_level]
    table = pq.ParquetFile(path, read_dictionary=texts).read(read)
    found = {name: table[name].to_pandas() for name in table.column_names}
    # As objects, since cells of categories would each have a text of their own.
    cells = {n: x.astype(object) if x.dtype == "category" else x for n, x in found.items()}
    lists = dict.fromkeys((one for one in texts if one not in read), "a list of texts")
    return RecordedTable(path, {n: x.to_numpy() for n, x in cells.items()}, skipped=lists)


def _datasets(
    group: h5py.Group, path: str, seen: set[h5py.Group]
) -> Iterator[tuple[str, h5py.Dataset]]:
    """Datasets in a group and its subgroups, with their paths; each group is visited once."""
    for name in group:
        if not isinstance(group.get(name, getlink=True), h5py.HardLink):
            continue
        node = group[name]
        if isinstance(node, h5py.Dataset):
            yield f"{path}{name}", node
        elif isinstance(node, h5py.Group) and node not in seen and path.count("/") < _DEEPEST:
            seen.add(node)
            yield from _datasets(node, f"{path}{name}/", seen)


def _matlab_strings(every: Mapping[str, h5py.Dataset]) -> dict[str, np.ndarray]:
    """String arrays among the datasets of a MATLAB 7.3 file.

    They are stored separately, in 64-bit words: version, number of dimensions, dimensions, length
    of each string, and the characters.
    """
    kind = {name: node.attrs.get("MATLAB_class") for name, node in every.items()}
    named = [name for name in every if kind[name] == b"string" and "/" not in name]
    apart = [d for n, d in every.items() if kind[n] == b"uint64" and n.startswith("#refs#/")]
    if len(named) != 1 or len(apart) != 1:
        return {}
    words = apart[0][()].T.ravel()
    count = int(words[2]) * int(words[3]) if len(words) > 3 else 0
    if len(words) < 4 or words[0] != 1 or words[1] != 2 or count > len(words):
        return {}
    lengths = words[4 : 4 + count].astype(int)
    letters = words[4 + count :].tobytes().decode("utf-16-le", errors="replace")
    ends = np.cumsum(lengths)
    return {
        named[0]: np.array([letters[end - n : end] for n, end in zip(lengths, ends, strict=True)])
    }


def _table(path: Path, found: Mapping[str, object]) -> RecordedTable:
    """The table of a file's contents; raises SurefootError where they are of several episodes."""
    cells = _arrays(found)
    wide = {n: v for n, v in cells.items() if v.ndim > 1}
    for name, (episodes, rows, *_) in ((n, v.shape) for n, v in wide.items() if v.ndim == 3):
        shared = all(one.shape[:2] == (episodes, rows) for one in wide.values())
        if shared and (episodes <= rows or len({one.shape[2:] for one in wide.values()}) > 1):
            raise SurefootError(
                f"{path}: {name} is of {min(episodes, rows)} episodes or robots of"
                f" {max(episodes, rows)} rows, and a log is of one: save each to a file of its own"
            )
    check_limit("columns", len(cells), f"{path}: arrays")
    cells, parameters = rows_first(cells)
    return RecordedTable(path, cells, skipped=dict.fromkeys(parameters, PARAMETERS))


def rows_first(arrays: Mapping[str, np.ndarray]) -> tuple[dict[str, np.ndarray], tuple[str, ...]]:
    """Arrays with the axis of their rows first, and the names of those that have no rows.

    Rows are the axis whose length most values share; an array as long as the rows of another are
    wide, such as the gains of joints, has none.
    """
    shared = Counter(n for one in arrays.values() for n in {*one.shape} - {1})
    found: dict[str, np.ndarray] = {}
    for name, one in arrays.items():
        rows = max(range(one.ndim), key=lambda k, shape=one.shape: shape[k] * shared[shape[k]])
        found[name] = np.moveaxis(one, rows, 0)
    longest = dict(sorted((n, len(one)) for one in found.values() for n in one.shape[1:]))
    recorded = {len(one) for one in found.values() if one[0].size > 1}
    parameters = tuple(
        name
        for name, one in found.items()
        if one.dtype.kind != "U"
        and len(one) > 1
        and (longest.get(len(one), 0) > len(one) or len(one) in {*longest} - recorded)
    )
    return {n: one for n, one in found.items() if n not in parameters}, parameters


def _arrays(found: Mapping[str, object]) -> dict[str, np.ndarray]:
    """Arrays of up to three axes of a file's contents; fields of structs under their own names."""
    cells: dict[str, np.ndarray] = {}
    for name, content in found.items():
        if not isinstance(content, np.ndarray | np.generic | float | int):
            continue
        value: np.ndarray = np.asarray(content)
        if value.dtype.names:
            cells |= _arrays({f"{name}.{f}": value[f] for f in value.dtype.names})
        elif value.dtype.kind == "O" and value.ndim == 0:
            cells |= _arrays({name: value.item()})
        elif value.dtype.kind == "M":
            cells |= _arrays({name: value.astype("datetime64[ns]").astype(float) * 1e-9})
        elif value.dtype.kind == "S":
            cells |= _arrays({name: np.char.decode(value, errors="replace")})
        elif value.dtype.kind in "fiubcU" and value.ndim < 4 and value.size:
            # Of the only episode, as gym-quadruped writes it, or the only robot.
            single = [k for k in (0, 1) if value.ndim == 3 and value.shape[k] == 1]
            values = value.take(0, single[0]) if single else value
            cells[name] = values.reshape(1) if values.size == 1 else values
    return cells


def _bound_inflated(path: Path) -> None:
    """Raise SurefootError if a MATLAB version 5 file takes too much memory."""
    _bounded(path, path.stat().st_size)
    content = path.read_bytes()
    order = "<" if content[126:128] == b"IM" else ">"
    at, total = _MAT_HEADER, len(content)
    while at + 8 <= len(content):
        kind, size = struct.unpack_from(f"{order}II", content, at)
        if kind == _MAT_COMPRESSED:
            unpacking, rest = zlib.decompressobj(), content[at + 8 : at + 8 + size]
            while rest:
                total += len(unpacking.decompress(rest, 1 << 20))
                rest = unpacking.unconsumed_tail
                _bounded(path, total)
        at += 8 + size


def _bounded(path: Path, size: float) -> None:
    check_unpacked(path.stat().st_size, size, f"{path}: bytes of arrays")
