"""What is no recording, or not a whole one: one line says what it is, and what to do."""

import gzip
import io
import os
import pickle
import shutil
from pathlib import Path

import numpy as np
import pytest
from backports import zstd
from bags import EPOCH, IMU, write_bag
from recorded import imported
from refusals import refusal, refused
from written import written

from surefoot.models.observer.observer import Observer
from surefoot.sim.common import limits
from surefoot.sim.importing.guessing.guess import guess_map
from surefoot.sim.importing.map import ImportMap
from surefoot.sim.importing.recording import read_recording
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot

POINTER = (
    "version https://git-lfs.github.com/spec/v1\n"
    "oid sha256:0123456789abcdef0123456789abcdef0123456789abcdef0123456789abcdef\nsize 1641284\n"
)
MAP = '[columns]\nt = "/imu:header.stamp"\n' + "".join(
    f'{name}_{axis} = "/imu:{field}.{axis}"\n'
    for name, field in (("gyro", "angular_velocity"), ("accel", "linear_acceleration"))
    for axis in "xyz"
)


TIMES = '[columns]\nt = "t"\n'


def check_refused(folder: Path, name: str, content: str | bytes, words, rules: str) -> None:
    """Check that a draft and an import of a file are both refused with these words."""
    path, rules_path = written(folder / name, content), written(folder / "map.toml", rules)
    for line in (refusal(guess_map, [path]), refusal(read_recording, path, rules_path)):
        assert all(word in line for word in words), line


@pytest.mark.parametrize(
    "name",
    ["a.csv", "a.txt", "a.json", "a.jsonl", "a.npz", "a.npy", "a.mat", "a.h5", "a.parquet", "a.bag",
     "a.mcap", "a.db3"],
)  # fmt: skip
def test_a_pointer_to_a_recording_is_named(tmp_path, name):
    rules = MAP if name[-3:] in ("bag", "cap", "db3") else TIMES
    check_refused(tmp_path, name, POINTER, (name, "Git LFS", "git lfs pull"), rules)


MODEL = """<mujoco><asset><mesh name="m" file="body.stl"/></asset><worldbody><body><freejoint/>
<geom type="mesh" mesh="m"/></body></worldbody></mujoco>"""


@pytest.mark.parametrize(
    ("name", "read"),
    [
        ("body.stl", lambda folder: Robot.load(str(folder / "robot.xml"))),
        ("robot.xml", lambda folder: Robot.load(str(folder / "robot.xml"))),
        ("robot.urdf", lambda folder: Robot.load(str(folder / "robot.urdf"))),
        ("log.parquet", lambda folder: Log.read(folder / "log.parquet")),
        ("a.observer", lambda folder: Observer.load(folder / "a.observer")),
        ("map.toml", lambda folder: ImportMap.read(folder / "map.toml")),
        ("bag/bag_0.mcap", lambda folder: guess_map([folder / "bag"])),
    ],
)
def test_every_reader_names_a_pointer(tmp_path, name, read):
    (tmp_path / "bag").mkdir()
    (tmp_path / "robot.xml").write_text(MODEL)
    (tmp_path / name).write_text(POINTER)
    line = refusal(read, tmp_path)
    assert all(word in line for word in (Path(name).name, "git lfs pull")), line


def objects(value: object) -> bytes:
    stream = io.BytesIO()
    np.save(stream, np.array(value, dtype=object), allow_pickle=True)
    return stream.getvalue()


CSV = "t,gyro_x,gyro_y\n" + "".join(f"{0.01 * k},{k},1\n" for k in range(40))
OTHERS = {
    # name, content, words of the error
    "gzip": ("a.csv.gz", gzip.compress(CSV.encode()), ("compressed", "unpack")),
    "gzip in disguise": ("a.csv", gzip.compress(CSV.encode()), ("compressed", "unpack")),
    "xz": ("a.csv.xz", b"\xfd7zXZ\0" + bytes(500), ("compressed", "unpack")),
    "bzip2": ("a.csv.bz2", b"BZh9" + bytes(500), ("compressed", "unpack")),
    "zstd": ("a.csv.zst", zstd.compress(CSV.encode()), ("compressed", "unpack")),
    "xlsx": ("a.xlsx", b"PK\3\4" + bytes(500), ("spreadsheet", "CSV")),
    "xls": ("a.xls", b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(500), ("spreadsheet", "CSV")),
    "a killed recorder": ("a.bag.active", b"#ROSBAG V2.0\n" + bytes(500), ("rosbag reindex",)),
    "MCAP": ("a.log", b"\x89MCAP0\r\n" + bytes(500), ("name it", ".mcap")),
    "SQLite": ("a.sqlite", b"SQLite format 3\0" + bytes(500), ("name it", ".db3")),
    "HDF5": ("a.dat", b"\x89HDF\r\n\x1a\n" + bytes(500), ("name it", ".h5")),
    "Parquet": ("a.pq", b"PAR1\x15\4" + bytes(500), ("name it", ".parquet")),
    "JSON": ("a.json", b'{"t": [1, 2', ("readable .json file",)),
    "Parquet, cut": ("a.parquet", b"PAR1\x15\4" + bytes(500), ("readable .parquet file",)),
    "objects": ("a.npy", objects({"t": 1}), ("readable .npy file", "Python objects")),
    "pickled": ("a.pkl", pickle.dumps({"t": [1.0]}), ("pickle", "np.savez")),
}


@pytest.mark.parametrize("case", OTHERS)
def test_a_file_of_another_kind_is_named_with_the_next_step(tmp_path, case):
    name, content, words = OTHERS[case]
    check_refused(tmp_path, name, content, (name, *words), TIMES)


EMPTY = {
    "blank lines": ("a.csv", CSV + "\n" * 300_000),
    "blank lines of old": ("a.csv", CSV.replace("\n", "\r\n") + "\r" * 300_000),
    "short lines": ("a.csv", ",".join(f"c{k}" for k in range(99)) + "\n1\n" * 20_000),
    "empty records": ("a.jsonl", '{"t": 1}\n' + "{}\n" * 100_000),
    "empty lists": ("a.json", '{"t": [1, 2], "x": [' + "[]," * 100_000 + "[]]}"),
    "records of one reading": ("a.json", "[" + ",".join(['{"t":1}'] * 50_000) + "]"),
    "records that share no field": (
        "a.json", "[" + ",".join('{"' + f"k{k}" * 40 + '": 1}' for k in range(1000)) + "]"),
}  # fmt: skip


@pytest.mark.parametrize("case", EMPTY)
def test_a_text_that_is_mostly_empty_is_refused_before_it_is_read(tmp_path, monkeypatch, case):
    monkeypatch.setattr(limits, "SMALL", 1e6)
    name, text = EMPTY[case]
    path = written(tmp_path / name, text.encode())
    refused(f"{name}.*times its size", imported, path, TIMES)


def test_cells_of_numbers_are_within_the_limits_of_memory(tmp_path, monkeypatch):
    """A cell is weighed by its time, not as memory."""
    monkeypatch.setenv(limits.VARIABLE, "memory=1000")
    assert len(imported(written(tmp_path / "a.csv", CSV), TIMES + 'x_k = "gyro_x"\n').t) == 40


@pytest.fixture(scope="module")
def bags(tmp_path_factory):
    """An IMU for a second, as each kind of bag."""
    folder = tmp_path_factory.mktemp("bags")
    stamps = [EPOCH + 5_000_000 * k for k in range(200)]
    for kind in ("sqlite3", "mcap", "ros1"):
        write_bag(
            folder / kind, kind,
            lambda m: (("/imu", IMU, ns, m.imu(ns, (0.1, 0, 0), (0, 0, 9.8))) for ns in stamps),
        )  # fmt: skip
    return folder


@pytest.mark.parametrize("kind", ["sqlite3", "mcap"])
@pytest.mark.parametrize("metadata", [None, "", "rosbag2_bagfile_information:\n"])
def test_a_folder_of_a_bag_is_read_without_its_metadata(tmp_path, bags, kind, metadata):
    shutil.copytree(bags / kind, tmp_path / "run")
    (tmp_path / "run" / "metadata.yaml").unlink()
    if metadata is not None:
        (tmp_path / "run" / "metadata.yaml").write_text(metadata)
    assert len(imported(tmp_path / "run", MAP).t) == 200
    assert "/imu:header.stamp" in guess_map([tmp_path / "run"]).text


def test_a_folder_of_several_bags_names_them(tmp_path, bags):
    for name in ("first", "second"):
        shutil.copy(next((bags / "mcap").glob("*.mcap")), tmp_path / f"{name}.mcap")
    line = refusal(guess_map, [tmp_path])
    assert all(word in line for word in ("first.mcap", "second.mcap"))


@pytest.mark.parametrize("kind", ["sqlite3/sqlite3.db3", "mcap/mcap.mcap", "ros1.bag"])
@pytest.mark.parametrize("share", [0.3, 0.9])
def test_a_bag_that_was_cut_is_said_to_be(tmp_path, bags, kind, share):
    path = tmp_path / Path(kind).name
    shutil.copy(bags / kind, path)
    os.truncate(path, int(share * path.stat().st_size))
    line = refusal(guess_map, [path])
    tool = {".db3": "reindex", ".mcap": "mcap recover", ".bag": "rosbag reindex"}[path.suffix]
    assert all(word in line for word in (path.name, tool))
