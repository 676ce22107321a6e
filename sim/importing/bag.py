"""A ROS bag becomes a Log, as an import map says (`sim.importing.map`,
`sim.importing.bag_table`)."""

from pathlib import Path

import numpy as np

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.importing.bag_table import Stamped, read_bag, topic_of
from surefoot.sim.importing.importer import Table, check_rising, checked_log, unit_quaternions
from surefoot.sim.importing.map import Column, ImportMap
from surefoot.sim.log import Log


def import_bag(path: str | Path, map_path: str | Path) -> Log:
    """The log of a ROS bag: a ROS 1 file, a ROS 2 folder, or an MCAP file.

    The topic of the map's `t` is the log's clock. Readings of other topics are interpolated to it,
    contacts hold their last value, and rows before or after any topic are cut. Raises
    SurefootError (LogError) in one line with file and column.
    """
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
        truth = _of_one_topic(seen, reference, path)
        unit_quaternions(path, truth)
    return checked_log(main, truth, rules, path)


def _on_clock(seen: dict[str, Stamped], columns: dict[str, Column], path: Path) -> Table:
    """Columns of several topics at the times of the topic that has `t`."""
    clock = columns["t"]
    t = clock.scale * seen[clock.theirs][1]
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
            table[name] = column.scale * values[inside]
        elif name.startswith(("contact_", "ref_ok")):
            table[name] = column.scale * values[np.searchsorted(stamps, t[inside], "right") - 1]
        else:
            table[name] = column.scale * np.interp(t[inside], stamps, values)
    return table


def _of_one_topic(seen: dict[str, Stamped], columns: dict[str, Column], path: Path) -> Table:
    topics = {topic_of(column.theirs) for column in columns.values()}
    if len(topics) > 1:
        raise SurefootError(f"{path}: [reference.columns] are of {' and '.join(sorted(topics))}")
    table = {name: column.scale * seen[column.theirs][1] for name, column in columns.items()}
    check_rising(table["t"], path, columns["t"].theirs, "message", 1)
    return table
