"""Columns of a ROS bag: ROS 1, ROS 2 or MCAP.

A column is named `topic:path`: `/imu/data:angular_velocity.x`, `/joint_states:position[FL_hip]` (at
the index of `FL_hip` in the message's `name`; a number is an index from 0),
`/imu/data:header.stamp`, or `/imu/data:received` for the time of reception by the recorder. The
transforms of `/tf` are topics by their frames: `/tf[world->base]:transform.translation.x`.
"""

import re
from array import array
from collections import defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence, Set
from contextlib import contextmanager
from dataclasses import MISSING, fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from surefoot.sim.common.errors import SurefootError, parsed_as
from surefoot.sim.common.limits import admitted, bounded_text, check_limit, check_unpacked
from surefoot.sim.importing.readers.table import RecordedTable, topic_of

RECEIVED = "received"
UNREADABLE = "NaN, text, empty or too long"
"""Why a column of a recording cannot be used."""
_MOST_PLACES = 64
"""Largest array in a message whose elements may be columns; longer ones are images or scans."""
_READING = 16.0
"""Bytes in memory of a reading, while its column grows."""
_REPAIRS = {
    ".bag": "rosbag reindex",
    ".mcap": "mcap recover",
    ".db3": "ros2 bag reindex, or sqlite3 with .recover",
}
"""By the ending of a bag."""
_NO_URI = {*"#?%"}
_PART_OF_BAG = re.compile(r"_\d+$")
_PART = re.compile(r"(\w+)(?:\[([^\]]+)\])?$")
_FRAME = re.compile(r"\[.*->.*\]$")
"""End of the topic of a transform: `[frame->child frame]`."""


def read_bag(path: Path, columns: Collection[str] | None = None) -> RecordedTable:
    """Read columns of a bag: by default every number, by the first message of each topic.

    Stamps are those of the messages' headers or, without a header, the times of reception; they,
    and columns of times, are seconds since the start of the bag. Raises SurefootError for a file
    that is no bag, and a missing topic or field.
    """
    if columns is None:
        stamps, cells = _read(path, None, _columns)
        used, skipped = _useful(stamps, cells)
        return RecordedTable(path, used, "message", skipped=skipped, stamps=stamps)
    wanted: dict[str, list[str]] = defaultdict(list)
    for column in sorted(columns):
        wanted[topic_of(column)].append(column)
    published = {topic.partition("[")[0] for topic in wanted}
    stamps, cells = _read(path, published, lambda topic, _: wanted.get(topic, ()))
    for topic in wanted:
        if not len(stamps.get(topic, ())):
            frames = ", ".join(one for one in stamps if one not in published)
            there = f" (there are {frames})" if frames else ""
            raise SurefootError(f"{path}: topic {topic!r} has no messages{there}")
    return RecordedTable(path, cells, "message", stamps=stamps)


def _columns(topic: str, message: Any) -> list[str]:
    """The columns of a topic that are numbers."""
    return [f"{topic}:{field}" for field in _fields(message)]


def _useful(
    stamps: Mapping[str, np.ndarray], cells: Mapping[str, np.ndarray]
) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Columns by name, and topics and frames without a use, with the reason."""
    skipped: dict[str, str] = {}
    for topic in stamps:
        columns = [column for column in cells if topic_of(column) == topic]
        moved = [np.ptp(cells[column]) for column in columns if ".translation." in column]
        if _FRAME.search(topic) and not any(moved):
            skipped[topic] = "does not move in its frame"
        elif all(column.endswith(":header.stamp") for column in columns):
            skipped[topic] = "empty, or only lists: write what you need to a topic of its own"
    framed = {topic.partition("[")[0] for topic in stamps if _FRAME.search(topic)}
    used = {column: x for column, x in cells.items() if topic_of(column) not in skipped}
    return used, {topic: why for topic, why in skipped.items() if topic not in framed}


@contextmanager
def _opened(path: Path) -> Iterator[AnyReader]:
    files = _storage(path) if path.is_dir() else [path]
    for one in _files(path):
        admitted(one, "recording")
    described = _is_described(path) or not files
    if not described and len({_PART_OF_BAG.sub("", one.stem) for one in files}) > 1:
        names = ", ".join(one.name for one in files)
        raise SurefootError(f"{path}: has several bags, name one of them: {names}")
    if _NO_URI & {*str(path)} and any(one.suffix == ".db3" for one in files):
        raise SurefootError(f"{path}: rename it, rosbags opens no database with # ? % in its path")
    with (
        parsed_as("a readable bag", path, _remedy(files)),
        AnyReader(
            [path] if described else files, default_typestore=get_typestore(Stores.ROS2_HUMBLE)
        ) as bag,
    ):
        check_limit("columns", len(bag.connections), f"{path}: connections")
        yield bag


def is_bag(path: Path) -> bool:
    """Whether a path is a ROS 1, ROS 2 or MCAP bag, by its name; or the folder of one, with or
    without its metadata.
    """
    if path.suffix.lower() in _REPAIRS or (path / "metadata.yaml").is_file():
        return True
    return path.is_dir() and bool(_storage(path)) and not any(path.glob("*.csv"))


def _is_described(path: Path) -> bool:
    """Whether a folder has metadata that name its files; those of a killed recorder are empty."""
    about = path / "metadata.yaml"
    if about.is_file():  # YAML takes rosbags five times as long as TOML
        check_limit("text", 5.0 * about.stat().st_size, f"{about}: five times its bytes")
    return about.is_file() and "relative_file_paths" in bounded_text(about)


def _files(path: Path) -> list[Path]:
    """The file of a bag, or all in its folder, any of which its metadata may name."""
    return [one for one in path.iterdir() if not one.is_dir()] if path.is_dir() else [path]


def _storage(path: Path) -> list[Path]:
    """The files of messages in the folder of a ROS 2 bag."""
    return sorted(one for one in path.iterdir() if one.suffix.lower() in (".mcap", ".db3"))


def _remedy(files: list[Path]) -> str:
    """What may help if these files are damaged, as those of a recorder that was killed."""
    tools = {_REPAIRS.get(one.suffix.lower(), "") for one in files} - {""}
    return f"; if the recorder was killed, try {' or '.join(sorted(tools))}" if tools else ""


def _fields(message: Any, place: str = "") -> Iterator[str]:
    names = [str(one) for one in getattr(message, "name", None) or ()]
    for field in fields(message):
        value, path = getattr(message, field.name), f"{place}{field.name}"
        if "covariance" in field.name or field.default is not MISSING:
            continue  # constants have a default
        if _nanoseconds(value) is not None or isinstance(value, int | float | np.number):
            yield path
        elif isinstance(value, np.ndarray) and value.ndim == 1 and len(value) <= _MOST_PLACES:
            places = names if len(names) == len(value) else range(len(value))
            yield from (f"{path}[{one}]" for one in places)
        elif is_dataclass(value):
            yield from _fields(value, f"{path}.")
        elif isinstance(value, list) and len(value) <= _MOST_PLACES:
            # Of motors or feet; stamped elements are another body in each message.
            for k, one in enumerate(value):
                if is_dataclass(one) and not hasattr(one, "header"):
                    yield from _fields(one, f"{path}[{k}].")


def _messages(topic: str, message: Any) -> Iterator[tuple[str, Any]]:
    """A message with its topic; the transforms in it, with topics `topic[frame->child]`."""
    yield topic, message
    for one in getattr(message, "transforms", ()):
        if hasattr(one, "child_frame_id"):
            yield f"{topic}[{one.header.frame_id}->{one.child_frame_id}]", one


def _read(
    path: Path, topics: Set[str] | None, columns_of: Callable[[str, Any], Sequence[str]]
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Stamps (N,) [s] of the messages of each topic, and values (N,) of each column.

    Args:
        path: of the bag.
        topics: that are read; all for None.
        columns_of: the columns of a topic, from its name and its first message.
    """
    getters: dict[str, dict[str, Callable[[Any, int, int], float]]] = {}
    values: dict[str, array] = defaultdict(lambda: array("d"))
    with _opened(path) as bag:
        taken, size = 0.0, sum(one.stat().st_size for one in _files(path))
        for topic in topics or ():
            if topic not in bag.topics:
                known = ", ".join(sorted(bag.topics)) or "none"
                raise SurefootError(f"{path}: no topic {topic!r} (there are {known})")
        begin = bag.start_time
        chosen = [c for c in bag.connections if topics is None or c.topic in topics]
        for connection, received, raw in bag.messages(chosen):
            check_limit("piece", len(raw), f"{path}: bytes of a message of {connection.topic}")
            taken += len(raw)
            message = bag.deserialize(raw, connection.msgtype)
            for topic, part in _messages(connection.topic, message):
                if topic not in getters:
                    getters[topic] = {c: _getter(c, path) for c in columns_of(topic, part)}
                    count = sum(1 + len(one) for one in getters.values())
                    check_limit("columns", count, f"{path}: topics, frames and fields")
                stamp = _nanoseconds(getattr(getattr(part, "header", None), "stamp", None))
                # Relative to the start of the bag in integer nanoseconds: an epoch in float64
                # resolves 0.2 us.
                values[topic].append(1e-9 * ((received if stamp is None else stamp) - begin))
                for column, get in getters[topic].items():
                    values[column].append(get(part, received, begin))
                taken += _READING * (1 + len(getters[topic]))
            check_unpacked(size, taken, f"{path}: bytes of its messages", at_once=False)
    silent = {connection.topic: np.zeros(0) for connection in chosen}
    stamps = silent | {topic: np.array(values[topic]) for topic in getters}
    return stamps, {c: np.array(values[c]) for topic in getters for c in getters[topic]}


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
