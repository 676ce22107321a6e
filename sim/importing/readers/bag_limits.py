"""Limits on what rosbags does with a bag: it unpacks and compiles whatever the bag has.

A bag may take 256 MB and a hundred times its size: its chunks, messages, index, definitions and
columns together, each weighed by the memory or time that it takes.
"""

import bz2
import os
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import apsw
import lz4.frame
from rosbags.highlevel import AnyReader, anyreader
from rosbags.interfaces import Nodetype
from rosbags.rosbag1 import reader as ros1
from rosbags.rosbag2 import reader as ros2
from rosbags.rosbag2 import storage_mcap as mcap
from rosbags.rosbag2.reader import zstd  # pyright: ignore[reportPrivateImportUsage]
from rosbags.serde.utils import SIZEMAP
from rosbags.typesys import get_types_from_idl, get_types_from_msg

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.limits import SMALL, check_limit, check_unpacked, unpacked

Adds = Callable[[float], None]
"""Adds bytes to what a bag takes; raises SurefootError if that is too much."""
_INDEX, _COPIES, _MESSAGE, _ELEMENT = 8, 2, 100, 200
"""Bytes in memory for a byte of an index and of a chunk; for a message besides its content, and for
an element of a list of messages or texts.
"""
_DEFINITION, _COMPILED = 1000, 8000
"""Bytes that take as long to read as a byte of a definition, and as compiling a value's readers."""
_WITHOUT_FIELD = re.compile(r"^[ \t]*(?:#.*)?\n", re.MULTILINE)
_TEXTS = re.compile(r'"(?:\\.|[^"\\])*"|//.*')
_COSTLY = re.compile(r"<<|\([^)]*\(")
"""In IDL, a shift, whose result has any size, and nested brackets, which take exponential time."""
_COMPUTED = (
    "SELECT count(*) FROM pragma_table_list AS l, pragma_table_xinfo(l.name) AS x "
    "WHERE l.schema = 'main' AND (l.type = 'virtual' OR x.hidden > 1)"
)
_Shape = tuple[float, float, float]
"""Number of values of a type, those of an array of numbers one; its least bytes; and the most
elements that a byte of its lists may be.
"""


@contextmanager
def within_limits(size: float, name: str) -> Iterator[Adds]:
    """Context in which rosbags opens and reads a bag of so many bytes within the limits."""
    total = 0.0

    def add(more: float) -> None:
        nonlocal total
        total += more
        check_unpacked(size, total, f"{name}: bytes of its messages", at_once=False)

    def bounded(unpacker: Callable[[], Any] | None) -> Callable[..., bytes]:
        def unpack(packed: bytes, *_: object) -> bytes:
            what = "bytes of a chunk or message"
            found = unpacked(unpacker(), packed, what) if unpacker else packed
            add(_COPIES * len(found))
            return found

        return unpack

    def parser(parse: Callable[..., dict[str, Any]]) -> Callable[..., dict[str, Any]]:
        @cache  # topics share their types
        def parsed(text: str, *named: str) -> dict[str, Any]:
            add(_DEFINITION * len(_WITHOUT_FIELD.sub("", text)))
            if not named and _COSTLY.search(_TEXTS.sub("", text)):
                raise SurefootError("an IDL definition has shifts or nested brackets")
            found = parse(text, *named)
            for of, parts in found.items():
                check_limit("columns", sum(map(len, parts)), f"fields of {of}")
            return found

        return parsed

    def index(reader: Any, pos: int, indexes: Any) -> None:
        begin = reader.bio.tell()
        read_index(reader, pos, indexes)
        add(_INDEX * (reader.bio.tell() - begin))

    read_index = ros1.Reader.read_index_data
    unpackers = {
        **dict.fromkeys(("", "none"), bounded(None)),
        "bz2": bounded(bz2.BZ2Decompressor),
        "lz4": bounded(lz4.frame.LZ4FrameDecompressor),
        "zstd": bounded(zstd.ZstdDecompressor),
    }
    of_files = SimpleNamespace(decompress=unpackers["zstd"], open=_PackedFile)
    with (
        patch.dict(ros1.decompressors, unpackers),
        patch.dict(mcap.DECOMPRESSORS, unpackers),
        patch.object(ros2, "zstd", of_files),
        patch.object(ros1.Reader, "read_index_data", index),
        patch.object(apsw, "connection_hooks", [*apsw.connection_hooks, _bound_database]),
        patch.object(anyreader, "get_types_from_msg", parser(get_types_from_msg)),
        patch.object(anyreader, "get_types_from_idl", parser(get_types_from_idl)),
    ):
        yield add


class _PackedFile(zstd.ZstdFile):
    def read(self, size: int | None = -1) -> bytes:
        found = super().read(size)
        check_unpacked(os.fstat(self.fileno()).st_size, self.tell(), "bytes of a file", False)
        return found


def _bound_database(database: apsw.Connection) -> None:
    """Bound the values and topics of a database, and refuse what is computed when it is read."""
    database.limit(apsw.SQLITE_LIMIT_LENGTH, int(SMALL))
    database.config(apsw.SQLITE_DBCONFIG_ENABLE_VIEW, 0)  # which may have rows without end
    if database.execute(_COMPUTED).get:
        raise SurefootError("has computed columns or tables, as no recorder writes them")
    for table in ("topics", "message_definitions"):
        if database.table_exists("main", table):
            rows = database.execute(f"SELECT count(*) FROM {table}").get
            check_limit("columns", rows, f"{table} of the bag")


def decoder(bag: AnyReader, add: Adds) -> Callable[[bytes, str], Any]:
    """The bag's function from the bytes and type of a message to the message, within limits."""
    types = bag.typestore.fielddefs

    @cache
    def of_type(name: str) -> _Shape:
        parts = [shape(*one) for _, one in types[name][1]] or [(1.0, 0.0, 0.0)]
        values, sizes, densities = zip(*parts, strict=True)
        return sum(values), sum(sizes), max(densities)

    def shape(kind: Nodetype, about: Any) -> _Shape:
        if kind == Nodetype.BASE:
            return 1.0, SIZEMAP.get(about[0], 4), 0.0
        if kind == Nodetype.NAME:
            return of_type(about)
        (inner, what), length = about
        values, size, density = shape(inner, what)
        numbers = inner == Nodetype.BASE and what[0] != "string"
        if kind == Nodetype.ARRAY:
            return 1.0 if numbers else max(1.0, length * values), length * size, density
        return 1.0, 4.0, 0.0 if numbers else max(density, values / max(size, 1e-9))

    @cache
    def compiled(name: str) -> float:
        values, _, density = of_type(name)
        check_limit("columns", values, f"values of a {name}")
        add(_COMPILED * values)
        return density

    def decode(raw: bytes, name: str) -> Any:
        size = _ELEMENT * compiled(name) * len(raw)
        check_unpacked(len(raw), size, f"bytes of a {name} in memory")
        add(len(raw) + _MESSAGE)
        return bag.deserialize(raw, name)

    return decode
