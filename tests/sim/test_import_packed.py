"""What is packed in a bag is bounded while it is unpacked, and no pipe of its folder is opened."""

import bz2
import os
import sqlite3
import struct

import lz4.frame
import pytest
from backports import zstd
from refusals import refusal, refused

from surefoot.sim.common import limits
from surefoot.sim.common.limits import unpacked
from surefoot.sim.importing.readers.bag import read_bag

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
    refused("times its size", unpacked, unpacker(), pack(ZEROS), "a")


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
    refused(r"r\.mcap.*times its size", read_bag, tmp_path / "r.mcap")


def test_a_message_of_zeros(tmp_path):
    folder_of(tmp_path / "bag", "message")
    database(tmp_path / "bag" / "w.db3", zstd.compress(ZEROS))
    refused(r"bag.*times its size", read_bag, tmp_path / "bag")


@pytest.mark.parametrize("file", ["w.db3.zstd", "w.db3"])
def test_a_file_of_zeros(tmp_path, file):
    folder_of(tmp_path / "bag", "file", file)
    (tmp_path / "bag" / file).write_bytes(zstd.compress(ZEROS))
    refused(r"bag.*times its size", read_bag, tmp_path / "bag")


def test_a_view_of_rows_without_end(tmp_path):
    database(tmp_path / "r.db3", view=True)
    refused(r"r\.db3", read_bag, tmp_path / "r.db3")


def test_a_pipe_in_the_folder_of_a_bag(tmp_path):
    folder_of(tmp_path / "bag", "none", "w")
    os.mkfifo(tmp_path / "bag" / "w")
    refused("regular", read_bag, tmp_path / "bag")


def test_metadata_of_a_megabyte(tmp_path):
    folder_of(tmp_path / "bag", "none")
    with (tmp_path / "bag" / "metadata.yaml").open("a") as stream:
        stream.write("#" * 1_000_000)
    refused(r"metadata\.yaml", read_bag, tmp_path / "bag")


def _text(text: str) -> bytes:
    return struct.pack("<I", len(text)) + text.encode()


def _definition(text: str, kind: str = "ros2msg", number: int = 1) -> bytes:
    return _record(3, struct.pack("<H", number) + _text("a/msg/A") + _text(kind) + _text(text))


def _channel(number: int = 1) -> bytes:
    about = struct.pack("<HH", number, 1) + _text(f"/a{number}") + _text("cdr")
    return _record(4, about + struct.pack("<I", 0))


def _message(time: int, content: bytes) -> bytes:
    return _record(5, struct.pack("<HIQQ", 1, 0, time, time) + b"\0\1\0\0" + content)


def records(*parts: bytes, summary: bytes = b"") -> bytes:
    """An MCAP file of these records."""
    body = MCAP + _record(1, _text("ros2") + struct.pack("<I", 0)) + b"".join(parts)
    at = len(body) if summary else 0
    return body + summary + _record(2, struct.pack("<QQI", at, 0, 0)) + MCAP


def one_type(text: str, content: bytes = bytes(8), kind: str = "ros2msg") -> bytes:
    return records(_definition(text, kind), _channel(), _message(1, content))


def types(*parts: str) -> str:
    return ("=" * 80 + "\n").join(parts)


def doubled(levels: int) -> str:
    """Types of which each has the next twice; the last has no bytes."""
    each = [f"MSG: a/B{k}\na/B{k + 1} x\na/B{k + 1} y\n" for k in range(levels)]
    return types("a/B0 x\n", *each, f"MSG: a/B{levels}\nuint8[0] x\n")


def circle() -> bytes:
    """A chunk that the index has three hundred times."""
    content = b"".join(_message(k, bytes(8)) for k in range(1000))
    head = _definition("float64 x\n") + _channel()
    chunk = struct.pack("<QQQI", 0, 1000, len(content), 0) + _text("")
    chunk = _record(6, chunk + struct.pack("<Q", len(content)) + content)
    at = len(records()) - 37 + len(head)
    index = struct.pack("<QQQQI", 0, 1000, at, len(chunk), 10) + struct.pack("<HQ", 1, at)
    index += struct.pack("<Q", 31) + _text("") + struct.pack("<QQ", len(content), len(content))
    return records(head, chunk, summary=head + _record(8, index) * 300)


LIST = types("a/B[] x\n", "MSG: a/B\nbool x\n")
LISTS = types("a/B[] x\n", "MSG: a/B\na/C[] x\n", "MSG: a/C\nbool[0] x\n")
BRACKETS = "module a { const long X = ((((((1)))))); };"
SHIFT = "module a { const long X = 1 << 40000000000; };"
TOPICS = [_channel(number) for number in range(100)]
HOSTILE = [
    # what it is, the file, a word of the error
    ("a definition of 2 MB", one_type("".join(f"bool x{k}\n" for k in range(20_000))), "messages"),
    ("constants", one_type("".join(f"bool C{k}=1\n" for k in range(60))), "fields"),
    ("types doubled six times", one_type(doubled(6)), "values"),
    ("a type that has itself", one_type("a/A x\n"), "readable"),
    ("a million texts", one_type("string[1000000] x\n"), "values"),
    ("messages", one_type(types("a/B[1000000000] x\n", "MSG: a/B\nbool x\n")), "values"),
    ("a billion numbers", one_type("float64[1000000000] x\n"), "readable"),
    ("elements of a byte", one_type(LIST, struct.pack("<I", 10**6) + bytes(10**6)), "memory"),
    ("lists of nothing", one_type(LISTS, struct.pack("<I", 1000) * 1001), "memory"),
    ("a shift in IDL", one_type(SHIFT, kind="ros2idl"), "IDL"),
    ("brackets in IDL", one_type(BRACKETS, kind="ros2idl"), "IDL"),
    ("a hundred topics", records(_definition("bool x\n"), *TOPICS), "connections"),
    ("a chunk three hundred times", circle(), "times its size"),
]


@pytest.mark.parametrize(
    ("content", "word"), [one[1:] for one in HOSTILE], ids=[one[0] for one in HOSTILE]
)
def test_what_a_bag_multiplies_is_refused_before(tmp_path, monkeypatch, content, word):
    monkeypatch.setenv(limits.VARIABLE, "columns=50")
    (tmp_path / "r.mcap").write_bytes(content)
    caught = refusal(read_bag, tmp_path / "r.mcap")
    assert word in caught
    assert "r.mcap" in caught


@pytest.mark.parametrize(
    ("column", "topics", "word"),
    [("data GENERATED ALWAYS AS (zeroblob(200000000))", 1, "computed"), ("data", 5000, "topics")],
)
def test_a_database_of_too_much(tmp_path, column, topics, word):
    connection = sqlite3.connect(tmp_path / "r.db3")
    connection.execute("CREATE TABLE topics(id, name, type, serialization_format)")
    rows = [(k, f"/a{k}", "std_msgs/msg/Float64", "cdr") for k in range(topics)]
    connection.executemany("INSERT INTO topics VALUES(?, ?, ?, ?)", rows)
    connection.execute(f"CREATE TABLE messages(id, topic_id, timestamp, {column})")
    connection.commit()
    connection.close()
    refused(rf"r\.db3.*{word}", read_bag, tmp_path / "r.db3")


def test_definitions_that_share_types_and_have_comments_are_read(tmp_path):
    """Comments and what topics share count once, and constants are no columns."""
    text = "# what it is\n" * 2000 + "uint8 ON=1\nfloat64 x # [m]\n"
    parts = [_channel(k) for k in range(1, 40)]
    (tmp_path / "r.mcap").write_bytes(records(_definition(text), *parts, _message(1, bytes(8))))
    assert list(read_bag(tmp_path / "r.mcap").cells) == ["/a1:x"]


def test_a_database_whose_path_no_address_can_have(tmp_path):
    (tmp_path / "run #1").mkdir()
    database(tmp_path / "run #1" / "r.db3")
    refused("rename", read_bag, tmp_path / "run #1" / "r.db3")
