"""Columns of a ROS bag: ROS 1, ROS 2 or MCAP.

A column is named `topic:path`: `/imu/data:angular_velocity.x`, `/joint_states:position[FL_hip]` (at
the index of `FL_hip` in the message's `name`; a number is an index from 0),
`/imu/data:header.stamp`, or `/imu/data:received` for the time of reception by the recorder.
"""

import bz2
import os
import re
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import apsw
import lz4.frame
import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import reader as ros1
from rosbags.rosbag2 import reader as ros2
from rosbags.rosbag2 import storage_mcap as mcap
from rosbags.rosbag2.reader import zstd  # pyright: ignore[reportPrivateImportUsage]
from rosbags.typesys import Stores, get_typestore

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.files import is_there
from surefoot.sim.common.limits import (
    SMALL,
    admitted,
    bounded_text,
    check_limit,
    check_unpacked,
    unpacked,
)
from surefoot.sim.importing.clock import Stamped
from surefoot.sim.importing.table import parsed_as

RECEIVED = "received"
UNREADABLE = "NaN, text, empty or too long"
"""Why a column of a recording cannot be used."""
_MOST_PLACES = 64
"""Largest array in a message whose elements may be columns; longer ones are images or scans."""
BAGS = (".bag", ".mcap", ".db3")
"""Endings of bags."""
_REPAIRS = {
    ".bag": "rosbag reindex",
    ".mcap": "mcap recover",
    ".db3": "ros2 bag reindex, or sqlite3 with .recover",
}
_PART_OF_BAG = re.compile(r"_\d+$")
_PART = re.compile(r"(\w+)(?:\[([^\]]+)\])?$")


def read_bag(path: str | Path, columns: Sequence[str]) -> dict[str, Stamped]:
    """Stamps [s since the start of the bag] and values of each named column, both (N,) float64.

    The stamps of a column are those of its messages' headers or, without a header, the times of
    reception; a column of times holds seconds since the start of the bag. Raises SurefootError for
    a file that is no bag, and a missing topic or field.
    """
    path = Path(path)
    wanted: dict[str, list[str]] = defaultdict(list)
    for column in columns:
        wanted[topic_of(column)].append(column)
    with _opened(path) as bag:
        return _read(bag, path, wanted)


def _bounded(unpacker: Callable[[], Any]) -> Callable[..., bytes]:
    return lambda packed, *_: unpacked(unpacker(), packed, "bytes of a chunk or message")


class _PackedFile(zstd.ZstdFile):
    def read(self, size: int | None = -1) -> bytes:
        found = super().read(size)
        check_unpacked(os.fstat(self.fileno()).st_size, self.tell(), "bytes of a file", False)
        return found


def _bound_database(database: apsw.Connection) -> None:
    database.limit(apsw.SQLITE_LIMIT_LENGTH, int(SMALL))
    database.config(apsw.SQLITE_DBCONFIG_ENABLE_VIEW, 0)  # which may have rows without end


@contextmanager
def _within_limits() -> Iterator[None]:
    """Context in which rosbags, which unpacks whatever a file has, does so within the limits."""
    lz4_, zstd_ = _bounded(lz4.frame.LZ4FrameDecompressor), _bounded(zstd.ZstdDecompressor)
    hooks = [*apsw.connection_hooks, _bound_database]
    with (
        patch.dict(ros1.decompressors, bz2=_bounded(bz2.BZ2Decompressor), lz4=lz4_),
        patch.dict(mcap.DECOMPRESSORS, lz4=lz4_, zstd=zstd_),
        patch.object(ros2, "zstd", SimpleNamespace(decompress=zstd_, open=_PackedFile)),
        patch.object(apsw, "connection_hooks", hooks),
    ):
        yield


@contextmanager
def _opened(path: Path) -> Iterator[AnyReader]:
    if not is_there(path):
        raise SurefootError(f"{path}: no such file")
    files = _storage(path) if path.is_dir() else [path]
    beside = [one for one in path.iterdir() if not one.is_dir()] if path.is_dir() else files
    for one in beside:  # any of which the metadata may name
        admitted(one, "recording")
    described = _is_described(path) or not files
    if not described and len({_PART_OF_BAG.sub("", one.stem) for one in files}) > 1:
        names = ", ".join(one.name for one in files)
        raise SurefootError(f"{path}: has several bags, name one of them: {names}")
    with (
        parsed_as("a readable bag", path, _remedy(files)),
        _within_limits(),
        AnyReader(
            [path] if described else files, default_typestore=get_typestore(Stores.ROS2_HUMBLE)
        ) as bag,
    ):
        yield bag


def is_bag(path: Path) -> bool:
    """Whether a path is a ROS 1, ROS 2 or MCAP bag, by its name; or the folder of one, with or
    without its metadata.
    """
    if path.suffix.lower() in BAGS or (path / "metadata.yaml").is_file():
        return True
    return path.is_dir() and bool(_storage(path)) and not any(path.glob("*.csv"))


def _is_described(path: Path) -> bool:
    """Whether a folder has metadata that name its files; those of a killed recorder are empty."""
    about = path / "metadata.yaml"
    if about.is_file():  # YAML takes rosbags five times as long as TOML
        check_limit("text", 5.0 * about.stat().st_size, f"{about}: five times its bytes")
    return about.is_file() and "relative_file_paths" in bounded_text(about)


def _storage(path: Path) -> list[Path]:
    """The files of messages in the folder of a ROS 2 bag."""
    return sorted(one for one in path.iterdir() if one.suffix.lower() in (".mcap", ".db3"))


def _remedy(files: list[Path]) -> str:
    """What may help if these files are damaged, as those of a recorder that was killed."""
    tools = {_REPAIRS.get(one.suffix.lower(), "") for one in files} - {""}
    return f"; if the recorder was killed, try {' or '.join(sorted(tools))}" if tools else ""


def bag_fields(path: Path) -> tuple[list[str], dict[str, str]]:
    """Every numeric column of a bag, as named in a map, from the first message of each topic; and
    the topics without any but their stamps, with the reason.
    """
    found: list[str] = []
    skipped: dict[str, str] = {}
    with _opened(path) as bag:
        for connection in bag.connections:
            for _, _, raw in bag.messages(connections=[connection]):
                message = bag.deserialize(raw, connection.msgtype)
                fields = [*_fields(message, "")]
                found += [f"{connection.topic}:{field}" for field in fields]
                if not any(field != "header.stamp" for field in fields):
                    skipped[connection.topic] = (
                        "only lists: write what you need of them to a topic of its own"
                    )
                break
            else:
                skipped[connection.topic] = UNREADABLE
    check_limit("columns", len(found), f"{path}: fields of its messages")
    return list(dict.fromkeys(found)), skipped


def _fields(message: Any, place: str) -> Iterator[str]:
    names = [str(one) for one in getattr(message, "name", None) or ()]
    for field in getattr(message, "__dataclass_fields__", {}):
        value, path = getattr(message, field), f"{place}{field}"
        if field.startswith("__") or "covariance" in field:
            continue
        if _nanoseconds(value) is not None or isinstance(value, int | float | np.number):
            yield path
        elif isinstance(value, np.ndarray) and value.ndim == 1 and len(value) <= _MOST_PLACES:
            places = names if len(names) == len(value) else range(len(value))
            yield from (f"{path}[{one}]" for one in places)
        elif hasattr(value, "__dataclass_fields__"):
            yield from _fields(value, f"{path}.")
        elif isinstance(value, list) and len(value) <= _MOST_PLACES:
            # Of motors or feet; stamped elements, as of /tf, are another body in each message.
            for k, one in enumerate(value):
                if not hasattr(one, "header"):
                    yield from _fields(one, f"{path}[{k}].")


def topic_of(column: str) -> str:
    """The topic in `topic:path`. Raises SurefootError where the column is not of that form."""
    topic, _, field = column.partition(":")
    if not topic or not field:
        raise SurefootError(f"column {column!r}: a bag's columns are written topic:field.path")
    return topic


def _read(bag: AnyReader, path: Path, wanted: dict[str, list[str]]) -> dict[str, Stamped]:
    for topic in wanted:
        if topic not in bag.topics:
            known = ", ".join(sorted(bag.topics)) or "none"
            raise SurefootError(f"{path}: no topic {topic!r} (there are {known})")
    getters = {column: _getter(column, path) for each in wanted.values() for column in each}
    values: dict[str, list[float]] = {column: [] for column in getters}
    stamps: dict[str, list[float]] = {topic: [] for topic in wanted}
    begin = bag.start_time
    chosen = [c for c in bag.connections if c.topic in wanted]
    for connection, received, raw in bag.messages(connections=chosen):
        message = bag.deserialize(raw, connection.msgtype)
        topic = connection.topic
        stamp = _nanoseconds(getattr(getattr(message, "header", None), "stamp", None))
        # Relative to the start of the bag in integer nanoseconds: an epoch in float64 resolves 0.2
        # us.
        stamps[topic].append(1e-9 * ((received if stamp is None else stamp) - begin))
        for column in wanted[topic]:
            values[column].append(getters[column](message, received, begin))
    for topic, found in stamps.items():
        if not found:
            raise SurefootError(f"{path}: topic {topic!r} has no messages")
    return {c: (np.array(stamps[topic_of(c)]), np.array(found)) for c, found in values.items()}


def _getter(column: str, path: Path) -> Callable[[Any, int, int], float]:
    """Function of a message, its time of reception and the bag's start, both [ns], to a value."""
    where, field = f"{path}: column {column!r}", column.partition(":")[2]
    parts = [_PART.match(part) for part in field.split(".")]
    if not all(parts):
        raise SurefootError(f"{where}: cannot read the path {field!r}")
    steps = [(part[1], part[2]) for part in parts if part]

    def get(message: Any, received: int, begin: int) -> float:
        if field == RECEIVED:
            return 1e-9 * (received - begin)
        value = message
        for name, index in steps:
            parent, value = value, getattr(value, name, None)
            if value is not None and index is not None:
                value = _item(parent, value, index)
            if value is None:
                raise SurefootError(f"{where}: the messages have no such field")
        stamp = _nanoseconds(value)
        try:
            return float(value) if stamp is None else 1e-9 * (stamp - begin)
        except (TypeError, ValueError):
            raise SurefootError(f"{where}: is not a number") from None

    return get


def _item(parent: Any, values: Any, index: str) -> Any:
    """The element at an index, or at that of `index` in the message's `name`."""
    names: list[Any] = list(getattr(parent, "name", None) or ())
    if not index.isdigit() and index not in names:
        return None
    place = int(index) if index.isdigit() else names.index(index)
    return values[place] if place < len(values) else None


def _nanoseconds(stamp: Any) -> int | None:
    """A ROS time [ns]; None for anything else."""
    if not hasattr(stamp, "sec") or not hasattr(stamp, "nanosec"):
        return None
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)
