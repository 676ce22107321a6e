"""A ROS bag (ROS 1, ROS 2, MCAP) becomes a Log, as an import map says (`sim.importing.map`).

A column is named `topic:path`: `/imu/data:angular_velocity.x`, `/joint_states:position[FL_hip]`
(the place is that of `FL_hip` in the message's `name`; a number counts from 0),
`/imu/data:header.stamp`, or `/imu/data:received` for the time at which the recorder got it.
"""

import re
from collections import defaultdict
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.typesys import Stores, get_typestore

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.importing.assemble import RawRecording, check_rising, unit_quaternions
from surefoot.sim.importing.map import ImportMap, MapColumn
from surefoot.sim.importing.reference import Columns, poses_of
from surefoot.sim.log import Log

RECEIVED = "received"
_PART = re.compile(r"(\w+)(?:\[([^\]]+)\])?$")
Stamped = tuple[np.ndarray, np.ndarray]
"""Stamps [s since the bag began] and values, both (N,)."""


def import_bag(path: str | Path, map_path: str | Path) -> Log:
    """The log of a ROS bag: a ROS 1 file, a ROS 2 folder, or an MCAP file.

    The topic of the map's `t` is the log's clock. Readings of other topics are interpolated to it,
    contacts hold their last value, and rows before or after any topic are cut. Raises
    SurefootError (LogError) in one line with file and column.
    """
    return read_bag_recording(path, map_path).log()


def read_bag_recording(path: str | Path, map_path: str | Path) -> RawRecording:
    """What `import_bag` makes a log of, with all poses. Raises as it does."""
    rules, path = ImportMap.read(map_path), Path(path)
    for given, section in (
        (rules.file, "[source] file"),
        (rules.rate, "[source] rate"),
        (rules.reference and rules.reference.file, "[reference] file"),
    ):
        if given is not None:
            raise SurefootError(f"{rules.path}: {section} does not go with a bag")
    columns = [*rules.columns.values()]
    reference = rules.reference.columns if rules.reference else {}
    seen = read_bag(path, sorted({c.theirs for c in (*columns, *reference.values())}))
    main = _on_clock(seen, rules.columns, path)
    truth = None
    if reference:
        table = _of_one_topic(seen, reference, path)
        unit_quaternions(path, table)
        truth = poses_of(table)
    return RawRecording(main, truth, rules, path)


def _on_clock(seen: dict[str, Stamped], columns: dict[str, MapColumn], path: Path) -> Columns:
    """Columns of several topics at the times of the topic that has `t`."""
    clock = columns["t"]
    t = clock.read(seen[clock.theirs][1])
    check_rising(t, path, clock.theirs, "message", 1)
    main = topic_of(clock.theirs)
    begin, end = t[0], t[-1]
    for name, column in columns.items():
        stamps = seen[column.theirs][0]
        if topic_of(column.theirs) == main:
            continue
        if name.startswith("ref_q_"):
            raise SurefootError(f"{path}: {name} is of another topic than t: give a [reference]")
        check_rising(stamps, path, column.theirs, "message", 1)
        begin, end = max(begin, stamps[0]), min(end, stamps[-1])
    inside = (t >= begin) & (t <= end)
    if not inside.any():
        raise SurefootError(f"{path}: the topics of the map do not overlap in time")
    table = {}
    for name, column in columns.items():
        stamps, values = seen[column.theirs]
        if topic_of(column.theirs) == main:
            table[name] = column.read(values[inside])
        elif name.startswith(("contact_", "ref_ok")):
            table[name] = column.read(values[np.searchsorted(stamps, t[inside], "right") - 1])
        else:
            table[name] = column.read(np.interp(t[inside], stamps, values))
    return table


def _of_one_topic(seen: dict[str, Stamped], columns: dict[str, MapColumn], path: Path) -> Columns:
    topics = {topic_of(column.theirs) for column in columns.values()}
    if len(topics) > 1:
        raise SurefootError(f"{path}: [reference.columns] are of {' and '.join(sorted(topics))}")
    table = {name: column.read(seen[column.theirs][1]) for name, column in columns.items()}
    check_rising(table["t"], path, columns["t"].theirs, "message", 1)
    return table


def read_bag(path: str | Path, columns: Sequence[str]) -> dict[str, Stamped]:
    """Stamps [s since the bag began] and values of each named column, both (N,) float64.

    A column's stamps are its messages' header stamps, or where a message has none the times at
    which they were received; a column of times holds seconds since the bag began. Raises
    SurefootError for a file that is no bag, a topic or field that is not there, and a value that
    is not a finite number.
    """
    path = Path(path)
    wanted: dict[str, list[str]] = defaultdict(list)
    for column in columns:
        wanted[topic_of(column)].append(column)
    if not path.exists():
        raise SurefootError(f"{path}: no such file")
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as bag:
            return _read(bag, path, wanted)
    except SurefootError:
        raise
    except (AnyReaderError, OSError) as error:
        raise SurefootError(f"{path}: {' '.join(str(error).split())}") from None
    except Exception as error:  # the parsers of broken bags raise whatever they stumble on
        raise SurefootError(f"{path}: not a readable bag ({type(error).__name__})") from error


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
        # From the bag's beginning, in whole nanoseconds: an epoch in float64 keeps 0.2 us.
        stamps[topic].append(1e-9 * ((received if stamp is None else stamp) - begin))
        for column in wanted[topic]:
            values[column].append(getters[column](message, received, begin))
    for topic, found in stamps.items():
        if not found:
            raise SurefootError(f"{path}: topic {topic!r} has no messages")
    return {
        column: (np.array(stamps[topic_of(column)]), _finite(np.array(found), column, path))
        for column, found in values.items()
    }


def _getter(column: str, path: Path) -> Callable[[Any, int, int], float]:
    field = column.partition(":")[2]
    parts = [_PART.match(part) for part in field.split(".")]
    if not all(parts):
        raise SurefootError(f"{path}: column {column!r}: cannot read the path {field!r}")
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
                raise SurefootError(f"{path}: column {column!r}: the messages have no such field")
        stamp = _nanoseconds(value)
        if stamp is not None:
            return 1e-9 * (stamp - begin)
        try:
            return float(value)
        except (TypeError, ValueError):
            raise SurefootError(f"{path}: column {column!r}: is not a number") from None

    return get


def _item(parent: Any, values: Any, index: str) -> Any:
    """The value at a number, or at the place that the message's `name` gives the index."""
    names = getattr(parent, "name", None)
    if index.isdigit():
        place = int(index)
    elif names is not None and index in list(names):
        place = list(names).index(index)
    else:
        return None
    return values[place] if place < len(values) else None


def _nanoseconds(stamp: Any) -> int | None:
    """A ROS time in ns, or None for what is no time."""
    if not hasattr(stamp, "sec") or not hasattr(stamp, "nanosec"):
        return None
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def _finite(values: np.ndarray, column: str, path: Path) -> np.ndarray:
    bad = np.flatnonzero(~np.isfinite(values))
    if bad.size:
        raise SurefootError(f"{path}: column {column!r}, message {bad[0] + 1}: not finite")
    return values
