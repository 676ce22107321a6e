"""What a recording declares, packs and holds is bounded before and while it is read."""

import io
import os
import sqlite3
import struct
import zipfile

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import scipy.io
from backports import zstd
from refusals import refusal, refused

from surefoot.sim.common import limits
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.importing.readers.array_file import read_hdf5, read_mat, read_npz, read_parquet
from surefoot.sim.importing.readers.bag import read_bag

MANY = 21


def hdf5(fill):
    def write(path):
        with h5py.File(path, "w", libver="latest") as file:
            fill(file)

    return write


def many_datasets(file):
    for k in range(MANY):
        file.create_dataset(f"c{k}", shape=(3,), dtype="f8")


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


SWOLLEN = {
    "rows of one value": parquet(t=np.zeros(400_000)),
    "short lists": parquet(q=[[0.0]] * 60_000),
    "numbers of a thousand bytes": parquet(q=pa.array([bytes(1000)] * 4000, pa.binary(1000))),
    "a chunk of which a tenth is used": hdf5(
        lambda file: file.create_dataset("t", (10,), "f8", maxshape=(None,), chunks=(10**6,))
    ),
}


@pytest.mark.parametrize("write", SWOLLEN.values(), ids=SWOLLEN)
def test_what_is_packed_is_bounded_by_what_the_file_declares(tmp_path, monkeypatch, write):
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
    q, grid = [[0.1, 0.2], [0.3, 0.4]], [[[1.0], [2.0]], [[3.0], [4.0]]]
    parquet(words=[["a", "b"], ["c"]], q=q, grid=grid)(tmp_path / "r.parquet")
    table = read_parquet(tmp_path / "r.parquet")
    assert {*table.cells} == {"q", "grid"}
    assert [*table.skipped] == ["words.list.element"]
    assert [one.tolist() for one in table.cells["q"]] == q
    assert table.cells["grid"][1][0].tolist() == [3.0]


MCAP = b"\x89MCAP0\r\n"


@pytest.fixture(autouse=True)
def little(monkeypatch):
    monkeypatch.setattr(limits, "SMALL", 1e6)


def _record(kind: int, content: bytes) -> bytes:
    return bytes([kind]) + struct.pack("<Q", len(content)) + content


def _text(text: str) -> bytes:
    return struct.pack("<I", len(text)) + text.encode()


def _definition(text: str, number: int = 1) -> bytes:
    about = struct.pack("<H", number) + _text("a/msg/A") + _text("ros2msg")
    return _record(3, about + _text(text))


def _channel(number: int = 1) -> bytes:
    about = struct.pack("<HH", number, 1) + _text(f"/a{number}") + _text("cdr")
    return _record(4, about + struct.pack("<I", 0))


def _message(time: int, content: bytes) -> bytes:
    return _record(5, struct.pack("<HIQQ", 1, 0, time, time) + b"\0\1\0\0" + content)


def _chunk(content: bytes, compression: str = "") -> bytes:
    packed = zstd.compress(content) if compression else content
    about = struct.pack("<QQQI", 0, 1000, len(content), 0) + _text(compression)
    return _record(6, about + struct.pack("<Q", len(packed)) + packed)


def records(*parts: bytes, summary: bytes = b"") -> bytes:
    """An MCAP file of these records."""
    body = MCAP + _record(1, _text("ros2") + struct.pack("<I", 0)) + b"".join(parts)
    at = len(body) if summary else 0
    return body + summary + _record(2, struct.pack("<QQI", at, 0, 0)) + MCAP


def circle() -> bytes:
    """A chunk that the index has three hundred times."""
    content = b"".join(_message(k, bytes(8)) for k in range(1000))
    head, chunk = _definition("float64 x\n") + _channel(), _chunk(content)
    at = len(records()) - 37 + len(head)
    index = struct.pack("<QQQQI", 0, 1000, at, len(chunk), 10) + struct.pack("<HQ", 1, at)
    index += struct.pack("<Q", 31) + _text("") + struct.pack("<QQ", len(content), len(content))
    return records(head, chunk, summary=head + _record(8, index) * 300)


def one_type(text: str, content: bytes = bytes(8)) -> bytes:
    return records(_definition(text), _channel(), _message(1, content))


FIELDS = "".join(f"bool x{k}\n" for k in range(60))
TOPICS = [_channel(number) for number in range(100)]
HOSTILE = [
    # what it is, the file, a word of the error
    ("a message of 20 kB", one_type("uint8[] x\n", _text("0" * 20_000)), "/a1"),
    ("fields", one_type(FIELDS, bytes(60)), "fields"),
    ("a hundred topics", records(_definition("bool x\n"), *TOPICS), "connections"),
    ("a chunk three hundred times", circle(), "times its size"),
    ("a type that has itself", one_type("a/A x\n"), "readable"),
    ("a billion numbers", one_type("float64[1000000000] x\n"), "readable"),
]


@pytest.mark.parametrize(
    ("content", "word"), [one[1:] for one in HOSTILE], ids=[one[0] for one in HOSTILE]
)
def test_what_a_bag_holds_is_bounded(tmp_path, monkeypatch, content, word):
    monkeypatch.setenv(limits.VARIABLE, "columns=50,piece=10000")
    (tmp_path / "r.mcap").write_bytes(content)
    caught = refusal(read_bag, tmp_path / "r.mcap")
    assert word in caught
    assert "r.mcap" in caught


def test_messages_that_are_packed_far_smaller_are_refused_in_total(tmp_path, monkeypatch):
    chunk = _chunk(_message(1, bytes(8)) * 40_000, "zstd")
    (tmp_path / "r.mcap").write_bytes(records(_definition("float64 x\n"), _channel(), chunk))
    monkeypatch.setenv(limits.VARIABLE, "unpacked=1000")
    assert len(read_bag(tmp_path / "r.mcap").cells["/a1:x"]) == 40_000
    monkeypatch.setenv(limits.VARIABLE, "unpacked=20")
    refused(r"r\.mcap.*times its size", read_bag, tmp_path / "r.mcap")


def test_a_file_that_is_too_large_is_not_opened(tmp_path, monkeypatch):
    monkeypatch.setenv(limits.VARIABLE, "recording=1000")
    (tmp_path / "r.mcap").write_bytes(circle())
    refused(r"r\.mcap: bytes.*recording", read_bag, tmp_path / "r.mcap")


def folder_of(path):
    path.mkdir()
    (path / "metadata.yaml").write_text("relative_file_paths: [w]\n")


def test_a_pipe_in_the_folder_of_a_bag(tmp_path):
    folder_of(tmp_path / "bag")
    os.mkfifo(tmp_path / "bag" / "w")
    refused("regular", read_bag, tmp_path / "bag")


def test_metadata_of_a_megabyte(tmp_path):
    folder_of(tmp_path / "bag")
    with (tmp_path / "bag" / "metadata.yaml").open("a") as stream:
        stream.write("#" * 1_000_000)
    refused(r"metadata\.yaml", read_bag, tmp_path / "bag")


def test_definitions_that_share_types_and_have_comments_are_read(tmp_path):
    """Constants are no columns."""
    text = "# what it is\n" * 500 + "uint8 ON=1\nfloat64 x # [m]\n"
    parts = [_channel(k) for k in range(1, 40)]
    (tmp_path / "r.mcap").write_bytes(records(_definition(text), *parts, _message(1, bytes(8))))
    assert list(read_bag(tmp_path / "r.mcap").cells) == ["/a1:x"]


def test_a_database_whose_path_no_address_can_have(tmp_path):
    (tmp_path / "run #1").mkdir()
    sqlite3.connect(tmp_path / "run #1" / "r.db3").close()
    refused("rename", read_bag, tmp_path / "run #1" / "r.db3")
