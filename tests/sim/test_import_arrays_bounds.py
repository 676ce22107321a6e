"""What a file of arrays declares is bounded before it is read."""

import io
import zipfile

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import scipy.io
from refusals import refused

from surefoot.sim.common import limits
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.importing.readers.array_file import read_hdf5, read_mat, read_npz, read_parquet

MANY = 21


def hdf5(fill):
    def write(path):
        with h5py.File(path, "w", libver="latest") as file:
            fill(file)

    return write


def many_datasets(file):
    for k in range(MANY):
        file.create_dataset(f"c{k}", shape=(3,), dtype="f8")


def many_names_of_one(file):
    file["t"] = np.arange(3.0)
    for k in range(MANY):
        file[f"c{k}"] = file["t"]


def many_references(file):
    for k in range(MANY):
        file.create_dataset(f"#refs#/{k}", shape=(3,), dtype="f8")


def huge_strings(file):
    file.create_dataset("s", shape=(1, 6), dtype="u4").attrs["MATLAB_class"] = np.bytes_("string")
    words = file.create_dataset("#refs#/a", shape=(10**10,), dtype="u8", chunks=(10**6,))
    words.attrs["MATLAB_class"] = np.bytes_("uint64")


def strings_elsewhere(file):
    where = [("/etc/passwd", 0, 64)]
    file.create_dataset("#refs#/a", shape=(8,), dtype="u8", external=where)


def many_members(path):
    with zipfile.ZipFile(path, "w") as file:
        for k in range(MANY):
            file.writestr(f"c{k}.npy", b"")


def nothing_a_billion_times(path):
    """Elements of no size: a file of 200 bytes whose rows took minutes."""
    head = io.BytesIO()
    about = {"descr": "|V0", "fortran_order": False, "shape": (10**12,)}
    np.lib.format.write_array_header_1_0(head, about)
    path.write_bytes(head.getvalue() + bytes(100))


def many_variables(path):
    scipy.io.savemat(path, {f"c{k}": np.arange(3.0) for k in range(MANY)})


@pytest.mark.parametrize(
    ("name", "write", "read", "word"),
    [
        ("r.h5", hdf5(many_datasets), read_hdf5, "columns"),
        ("r.h5", hdf5(many_names_of_one), read_hdf5, "columns"),
        ("r.mat", hdf5(many_references), read_mat, "columns"),
        ("r.mat", hdf5(huge_strings), read_mat, "memory"),
        ("r.mat", hdf5(strings_elsewhere), read_mat, "another file"),
        ("r.npz", many_members, read_npz, "columns"),
        ("r.npy", nothing_a_billion_times, read_npz, "memory"),
        ("r.mat", many_variables, read_mat, "columns"),
    ],
)
def test_a_file_that_declares_too_much_is_refused(tmp_path, name, write, read, word, monkeypatch):
    monkeypatch.setenv("SUREFOOT_LIMITS", "columns=20")
    write(tmp_path / name)
    assert name in refused(word, read, tmp_path / name)


def parquet(**columns):
    return lambda path: pq.write_table(pa.table(columns), path, compression="zstd")


def lists(kind: pa.DataType, values: pa.Array, each: int) -> pa.Array:
    offsets = np.arange(0, len(values) + 1, each, dtype=np.int32)
    return pa.ListArray.from_arrays(offsets, values, type=pa.list_(kind))


ZEROS = pa.array(np.zeros(400_000))
SWOLLEN = {
    "nothing in many columns": parquet(**{f"c{k}": pa.nulls(5000) for k in range(100)}),
    "rows of one value": parquet(t=ZEROS),
    "long lists": parquet(q=lists(pa.float64(), ZEROS, 4000)),
    "short lists": parquet(q=lists(pa.float64(), ZEROS[:60_000], 1)),
    "lists in lists": parquet(
        q=lists(pa.list_(pa.float64()), lists(pa.float64(), ZEROS[:60_000], 1), 100)
    ),
    "lists in a record": parquet(
        q=pa.StructArray.from_arrays([lists(pa.float64(), ZEROS, 4000)], ["a"])
    ),
    "numbers of a thousand bytes": parquet(q=pa.array([bytes(1000)] * 4000, pa.binary(1000))),
    "a chunk of which a tenth is used": hdf5(
        lambda file: file.create_dataset("t", (10,), "f8", maxshape=(None,), chunks=(10**6,))
    ),
}


@pytest.mark.parametrize("write", SWOLLEN.values(), ids=SWOLLEN)
def test_what_is_packed_is_bounded_by_what_the_file_declares(tmp_path, monkeypatch, write):
    monkeypatch.setattr(limits, "SMALL", 1e6)
    monkeypatch.setenv("SUREFOOT_LIMITS", "unpacked=1")
    path = tmp_path / "r.parquet"
    write(path)
    with pytest.raises(SurefootError, match=r"r\.parquet: bytes of arrays, times its size"):
        (read_hdf5 if h5py.is_hdf5(path) else read_parquet)(path)


def test_many_short_row_groups_are_refused(tmp_path, monkeypatch):
    monkeypatch.setenv("SUREFOOT_LIMITS", "items=20")
    pq.write_table(pa.table({"t": np.arange(30.0)}), tmp_path / "r.parquet", row_group_size=1)
    refused("parts of columns", read_parquet, tmp_path / "r.parquet")


def test_a_text_of_parquet_is_unpacked_once(tmp_path):
    """A gigabyte, if each of the cells had its own."""
    note = pa.DictionaryArray.from_arrays(np.zeros(50_000, np.int32), ["x" * 20_000])
    parquet(t=np.arange(50_000.0), note=note)(tmp_path / "r.parquet")
    cells = read_parquet(tmp_path / "r.parquet").cells
    assert cells["note"][0] is cells["note"][-1]
    assert cells["note"][0] == "x" * 20_000
    np.testing.assert_array_equal(cells["t"], np.arange(50_000.0))


def test_lists_of_texts_are_left_out_of_parquet(tmp_path):
    rows = {
        "words": [["a", "b"], ["c"]],
        "q": [[0.1, 0.2], [0.3, 0.4]],
        "grid": [[[1.0], [2.0]], [[3.0], [4.0]]],
        "note": ["a", None],
    }
    pq.write_table(pa.table(rows), tmp_path / "r.parquet")
    table = read_parquet(tmp_path / "r.parquet")
    cells = table.cells
    assert {*cells} == {"q", "grid", "note"}
    assert [*table.skipped] == ["words.list.element"]
    assert [one.tolist() for one in cells["q"]] == rows["q"]
    assert cells["grid"][1][0].tolist() == [3.0]
    assert cells["note"][0] == "a"
    assert cells["note"][1] is None or np.isnan(cells["note"][1])
