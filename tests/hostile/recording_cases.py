"""Recordings in other formats that are broken or ask for too much: one line a case, `what` it is, the
file, what is written into it (text, bytes, or a function that writes it), and a word that the error
must have."""

import io
import json
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import scipy.io
from recorded import SENSORS, as_named

NAMES = ("t", *SENSORS)
MAP = as_named(NAMES)
BAG_MAP = "[columns]\n" + "".join(f'{name} = "/imu:{name}"\n' for name in NAMES)
BAGS = (".mcap", ".bag", ".db3", "")
"""Endings of bags, none of a folder."""
ROWS = 50
COLUMNS: dict[str, Any] = {name: np.full(ROWS, 0.1) for name in NAMES} | {
    "t": 0.01 * np.arange(ROWS)
}
RECORDS = [{name: float(x[k]) for name, x in COLUMNS.items()} for k in range(ROWS)]
JSON = json.dumps(RECORDS)
HEADER = ",".join(NAMES) + "\n"
LINES = "".join(",".join(str(row[name]) for name in NAMES) + "\n" for row in RECORDS)
MCAP = b"\x89MCAP0\r\n"
MAT = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<H", 0x0100) + b"IM"
BLOCK = bytes(1 << 24)
DOUBLE, MATRIX, COMPRESSED = 9, 14, 15
"""Types of elements (MAT-File Format, MathWorks)."""


def packed(**other) -> Callable[[Path], None]:
    """A .npz of the columns, some of them others."""
    return lambda path: np.savez_compressed(path, **(COLUMNS | other))


def npy_header(count: int) -> bytes:
    stream = io.BytesIO()
    about = {"descr": "<f8", "fortran_order": False, "shape": (count,)}
    np.lib.format.write_array_header_1_0(stream, about)
    return stream.getvalue()


def zeros_npz(path: Path) -> None:
    """A gigabyte of zeros in a megabyte."""
    np.savez(path, **COLUMNS)
    with (
        zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as file,
        file.open("more.npy", "w", force_zip64=True) as member,
    ):
        member.write(npy_header(64 * len(BLOCK) // 8))
        for _ in range(64):
            member.write(BLOCK)


def lying_npz(path: Path) -> None:
    """An array that says that it has a trillion numbers."""
    np.savez(path, **COLUMNS)
    with zipfile.ZipFile(path, "a") as file:
        file.writestr("more.npy", npy_header(10**12))


def zeros_mat(path: Path) -> None:
    """A gigabyte of zeros in a megabyte."""
    count = 64 * len(BLOCK) // 8
    element = struct.pack("<IIII", 6, 8, 6, 0)  # a matrix of doubles ...
    element += struct.pack("<IIii", 5, 8, count, 1)  # ... of these dimensions ...
    element += struct.pack("<II", 1, 1) + b"t".ljust(8)  # ... and this name
    element += struct.pack("<II", DOUBLE, 8 * count)
    packer = zlib.compressobj()
    parts = [packer.compress(struct.pack("<II", MATRIX, len(element) + 8 * count) + element)]
    parts += [packer.compress(BLOCK) for _ in range(64)] + [packer.flush()]
    content = b"".join(parts)
    path.write_bytes(MAT + struct.pack("<II", COMPRESSED, len(content)) + content)


def matrices(path: Path) -> None:
    scipy.io.savemat(path, COLUMNS, do_compression=True)


def hdf5(change: Callable[[h5py.File], object], without: str = "") -> Callable[[Path], None]:
    def write(path: Path) -> None:
        with h5py.File(path, "w") as file:
            for name, values in COLUMNS.items():
                if name != without:
                    file[name] = values
            change(file)

    return write


def deep_groups(file: h5py.File) -> None:
    group: h5py.Group = file
    for _ in range(3000):
        group = group.create_group("g")
    group["accel_z"] = COLUMNS["accel_z"]


def table(**other) -> Callable[[Path], None]:
    """A Parquet table of the columns, some of them others."""
    return lambda path: pq.write_table(pa.table(COLUMNS | other), path)


def zeros(path: Path, groups: int = 20, rows: int = 1_000_000, about: dict | None = None) -> None:
    """Row groups of forty columns in a file of a few megabytes."""
    column = pa.array(np.zeros(rows))
    group = pa.table(dict.fromkeys((*NAMES, *(f"x_{k}" for k in range(33))), column))
    group = group.replace_schema_metadata(about)
    with pq.ParquetWriter(path, group.schema, compression="zstd") as writer:
        for _ in range(groups):
            writer.write_table(group, row_group_size=rows)


def bag_folder(about: str) -> Callable[[Path], None]:
    """A folder with the metadata of a ROS 2 bag."""

    def write(path: Path) -> None:
        path.mkdir()
        (path / "metadata.yaml").write_text(about)

    return write


def replaced(value: str) -> str:
    """The records as JSON, one reading replaced."""
    return JSON.replace("0.1", value, 1)


# fmt: off

RECORDING = [
    ("an integer of 400 digits", "r.json", replaced("9" * 400), "too large"),
    ("an integer of 5000 digits", "r.json", replaced("9" * 5000), "r.json"),
    ("no number", "r.json", replaced("NaN"), "NaN"),
    ("a number of 1e400", "r.json", replaced("1e400"), "infinite"),
    ("a number of 1e300", "r.json", replaced("1e300"), "1e+300"),
    ("null", "r.json", replaced("null"), "empty"),
    ("a list for a number", "r.json", replaced("[1, 2]"), "number"),
    ("half a surrogate", "r.json", replaced('"\\ud800"'), "number"),
    ("lists in lists", "r.json", "[" * 200_000, "JSON"),
    ("records in records", "r.json", '{"a":' * 50_000 + "1" + "}" * 50_000, "JSON"),
    ("one number", "r.json", "3", "no records"),
    ("nothing", "r.json", "", "JSON"),
    ("empty records", "r.json", "[{}, {}]", "no records"),
    ("bytes", "r.json", bytes(range(256)) * 20, "JSON"),
    ("a line without an end", "r.jsonl", '{"t": 1}\n{"t":', "JSON"),
    ("lists of two lengths", "r.json", json.dumps({n: x.tolist() for n, x in COLUMNS.items()} | {"accel_z": [1.0]}), "rows"),
    ("records backwards", "r.json", json.dumps(RECORDS[::-1]), "t"),
    ("words", "r.npz", packed(accel_z=np.array(["fast"] * ROWS)), "number"),
    ("a single number", "r.npz", packed(accel_z=np.float64(9.8)), "accel_z"),
    ("a cube", "r.npz", packed(accel_z=np.zeros((ROWS, 2, 2))), "accel_z"),
    ("no numbers", "r.npz", packed(accel_z=np.full(ROWS, np.nan)), "NaN"),
    ("a gigabyte of zeros", "r.npz", zeros_npz, "times its size"),
    ("a trillion numbers that are not there", "r.npz", lying_npz, "r.npz"),
    ("a header of brackets", "r.npy", b"\x93NUMPY\x01\x00\xff\xff" + b"(" * 65535, "r.npy"),
    ("a header of code", "r.npy", b"\x93NUMPY\x01\x00v\x00" + b"{'descr': __import__('os').system('touch x')}".ljust(117) + b"\n", "r.npy"),
    ("a text", "r.npz", "hello", "r.npz"),
    ("seven gigabytes that were never written", "r.h5", hdf5(lambda f: f.create_dataset("x", (900_000_000,), "f8", chunks=(65536,))), "times its size"),
    ("eight terabytes that were never written", "r.h5", hdf5(lambda f: f.create_dataset("x", (10**12,), "f8", chunks=(65536,))), "memory"),
    ("readings of the system", "r.h5", hdf5(lambda f: f.create_dataset("accel_z", (ROWS,), "f8", external=[("/etc/hostname", 0, 8 * ROWS)]), "accel_z"), "another file"),
    ("a link to another file", "r.h5", hdf5(lambda f: f.__setitem__("accel_z", h5py.ExternalLink("/etc/passwd", "/x")), "accel_z"), "missing"),
    ("a link to itself", "r.h5", hdf5(lambda f: f.__setitem__("accel_z", h5py.SoftLink("/accel_z")), "accel_z"), "missing"),
    ("groups in groups", "r.h5", hdf5(deep_groups, "accel_z"), "missing"),
    ("a column of nothing", "r.h5", hdf5(lambda f: f.__setitem__("accel_z", h5py.Empty("f8")), "accel_z"), "missing"),
    ("a gigabyte of zeros", "r.mat", zeros_mat, "times its size"),
    ("a matrix of 2^60", "r.mat", struct.pack("<iiiii", 0, 2**30, 2**30, 0, 2) + b"t\0", "r.mat"),
    ("a header alone", "r.mat", MAT, "missing"),
    ("noise", "r.mat", MAT + np.random.default_rng(0).bytes(5000), "r.mat"),
    ("twenty million rows of forty columns", "r.parquet", zeros, "times its size"),
    ("a column of lists", "r.parquet", table(accel_z=[[1.0]] * ROWS), "number"),
    ("a column of nothing", "r.parquet", table(accel_z=pa.nulls(ROWS)), "empty"),
    ("a text", "r.parquet", "PAR1 hello PAR1", "r.parquet"),
    ("two million commas", "r.csv", HEADER + LINES + "," * 2_000_000, "line"),
    ("a header of four million cells", "r.csv", "," * 4_000_000 + "\n" + LINES, "header"),
    ("a header of fifty megabytes", "r.csv", "t" * 50_000_000 + HEADER + LINES, "field"),
    ("time that ends at 1e308", "r.csv", HEADER + LINES + "1e308" + ",0.1" * 6 + "\n", "1e"),
    ("noise", "r.mcap", MCAP + np.random.default_rng(0).bytes(4000) + MCAP, "r.mcap"),
    ("noise", "r.bag", b"#ROSBAG V2.0\n" + b"\xff" * 4000, "r.bag"),
    ("a header of two gigabytes", "r.bag", b"#ROSBAG V2.0\n" + struct.pack("<I", 2**31) + bytes(4000), "r.bag"),
    ("a text", "r.db3", "hello", "r.db3"),
    ("metadata that run", "walked", bag_folder("!!python/object/apply:os.system ['touch x']\n"), "walked"),
    ("metadata in metadata", "walked", bag_folder("[" * 20_000), "walked"),
    ("metadata that laugh", "walked", bag_folder("a: &a [" + "x," * 50 + "]\n" + "".join(f"{chr(98 + i)}: &{chr(98 + i)} [" + f"*{chr(97 + i)}," * 50 + "]\n" for i in range(8))), "walked"),
]
