"""What is packed in a bag is bounded while it is unpacked, and no pipe of its folder is opened."""

import bz2
import os
import sqlite3
import struct

import lz4.frame
import pytest
from backports import zstd

from surefoot.sim.common import limits
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.limits import unpacked
from surefoot.sim.importing.bag import bag_fields

ZEROS = bytes(4_000_000)
MCAP = b"\x89MCAP0\r\n"
METADATA = """rosbag2_bagfile_information:
  version: 5
  storage_identifier: sqlite3
  duration: {{nanoseconds: 1}}
  starting_time: {{nanoseconds_since_epoch: 0}}
  message_count: 1
  topics_with_message_count:
    - topic_metadata: {{name: /a, type: std_msgs/msg/Float64, serialization_format: cdr,
                        offered_qos_profiles: ""}}
      message_count: 1
  compression_format: zstd
  compression_mode: {mode}
  relative_file_paths: [{file}]
"""


@pytest.fixture(autouse=True)
def little(monkeypatch):
    monkeypatch.setattr(limits, "SMALL", 1e6)


@pytest.mark.parametrize(
    ("pack", "unpacker"),
    [
        (bz2.compress, bz2.BZ2Decompressor),
        (lz4.frame.compress, lz4.frame.LZ4FrameDecompressor),
        (zstd.compress, zstd.ZstdDecompressor),
    ],
)
def test_zeros_are_refused_and_readings_are_unpacked(pack, unpacker):
    readings = os.urandom(3_000_000)
    assert unpacked(unpacker(), pack(readings), "a") == readings
    with pytest.raises(SurefootError, match="times its size"):
        unpacked(unpacker(), pack(ZEROS), "a")


def _record(kind: int, content: bytes) -> bytes:
    return bytes([kind]) + struct.pack("<Q", len(content)) + content


def mcap(compression: str, packed: bytes) -> bytes:
    """An MCAP file without an index, of one chunk."""
    about = struct.pack("<QQQI", 0, 1, len(ZEROS), 0)
    about += struct.pack("<I", len(compression)) + compression.encode()
    chunk = _record(6, about + struct.pack("<Q", len(packed)) + packed)
    header = _record(1, struct.pack("<I", 4) + b"ros2" + struct.pack("<I", 0))
    return MCAP + header + chunk + _record(2, bytes(20)) + MCAP


def database(path, data=b"", view=False):
    connection = sqlite3.connect(path)
    connection.execute(
        "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, "
        "serialization_format TEXT, offered_qos_profiles TEXT)"
    )
    connection.execute("CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id, timestamp, data)")
    connection.execute("INSERT INTO topics VALUES(1, '/a', 'std_msgs/msg/Float64', 'cdr', '')")
    connection.execute("INSERT INTO messages VALUES(1, 1, 1, ?)", (data,))
    if view:
        rows = "WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM c)"
        connection.execute("CREATE TABLE schema(schema_version)")
        connection.execute("INSERT INTO schema VALUES(4)")
        connection.execute(
            f"CREATE VIEW message_definitions AS {rows} SELECT x AS id, '' AS topic_type, "
            "'ros2msg' AS encoding, '' AS encoded_message_definition, "
            "'' AS type_description_hash FROM c"
        )
    connection.commit()
    connection.close()


def folder_of(path, mode, file="w.db3"):
    path.mkdir()
    (path / "metadata.yaml").write_text(METADATA.format(mode=mode, file=file))


@pytest.mark.parametrize("compression", ["lz4", "zstd"])
def test_a_chunk_of_zeros(tmp_path, compression):
    pack = {"lz4": lz4.frame.compress, "zstd": zstd.compress}[compression]
    (tmp_path / "r.mcap").write_bytes(mcap(compression, pack(ZEROS)))
    with pytest.raises(SurefootError, match=r"r\.mcap.*times its size"):
        bag_fields(tmp_path / "r.mcap")


def test_a_message_of_zeros(tmp_path):
    folder_of(tmp_path / "bag", "message")
    database(tmp_path / "bag" / "w.db3", zstd.compress(ZEROS))
    with pytest.raises(SurefootError, match=r"bag.*times its size"):
        bag_fields(tmp_path / "bag")


@pytest.mark.parametrize("file", ["w.db3.zstd", "w.db3"])
def test_a_file_of_zeros(tmp_path, file):
    folder_of(tmp_path / "bag", "file", file)
    (tmp_path / "bag" / file).write_bytes(zstd.compress(ZEROS))
    with pytest.raises(SurefootError, match=r"bag.*times its size"):
        bag_fields(tmp_path / "bag")


def test_a_view_of_rows_without_end(tmp_path):
    database(tmp_path / "r.db3", view=True)
    with pytest.raises(SurefootError, match=r"r\.db3"):
        bag_fields(tmp_path / "r.db3")


def test_a_pipe_in_the_folder_of_a_bag(tmp_path):
    folder_of(tmp_path / "bag", "none", "w")
    os.mkfifo(tmp_path / "bag" / "w")
    with pytest.raises(SurefootError, match="regular"):
        bag_fields(tmp_path / "bag")


def test_metadata_of_a_megabyte(tmp_path):
    folder_of(tmp_path / "bag", "none")
    with (tmp_path / "bag" / "metadata.yaml").open("a") as stream:
        stream.write("#" * 1_000_000)
    with pytest.raises(SurefootError, match=r"metadata\.yaml"):
        bag_fields(tmp_path / "bag")
