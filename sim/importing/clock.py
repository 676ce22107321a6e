"""Resample streams of several files and topics, each with its own times, to the rows of one log."""

from collections.abc import Mapping

import numpy as np

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.log import LogError
from surefoot.sim.log.schema import joint_prefix

Stamped = tuple[np.ndarray, np.ndarray]
"""Increasing times [s], and values, both (N,)."""
Columns = dict[str, np.ndarray]
LONG_GAP = 0.1
"""Shortest gap that is reported [s]: two steps of a stream at 20 Hz."""
_GAP = 3.0
"""Least length of such a gap in usual intervals."""
_AVERAGING_RATIO = 1.5
"""Ratio to the log's rate from which an IMU is averaged over a row instead of interpolated."""


def is_event(name: str) -> bool:
    """Whether a column holds its value until the next sample: contacts and flags."""
    return name.startswith(("contact_", "ref_ok"))


def on_clock(t: np.ndarray, streams: Mapping[str, Stamped], where: str) -> Columns:
    """Resample streams to the times t (N,) [s], including `t`; times outside any stream are cut.

    Streams with exactly these times are used as they are. Of others, events hold their last value,
    readings are interpolated, and gyro and accel with a higher rate are averaged over the interval
    since the preceding row, which is their definition in a log. Raises SurefootError, starting with
    `where`, where they do not overlap in time.
    """
    begin = max([t[0], *(stamps[0] for stamps, _ in streams.values())])
    end = min([t[-1], *(stamps[-1] for n, (stamps, _) in streams.items() if not is_event(n))])
    inside = (t >= begin) & (t <= end)
    if not inside.any():
        raise SurefootError(f"{where}: the topics and files of the map do not overlap in time")
    table = {"t": t[inside]}
    for name, (stamps, values) in streams.items():
        if len(stamps) == len(t) and np.array_equal(stamps, t):
            table[name] = values[inside]
        elif is_event(name):
            table[name] = values[np.searchsorted(stamps, t[inside], "right") - 1]
        elif name.startswith(("gyro_", "accel_")) and _rate(stamps) > _AVERAGING_RATIO * _rate(t):
            table[name] = means(t[inside], stamps, values)
        else:
            table[name] = np.interp(t[inside], stamps, values)
    return table


def means(t: np.ndarray, stamps: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Mean of readings over (t[k-1], t[k]] for each t (N,); the first interval is as long as the
    second.

    A reading is itself the mean over the interval since the preceding one, like an IMU's.
    """
    total = np.concatenate([[0.0], np.cumsum(values[1:] * np.diff(stamps))])
    edges = np.concatenate([[2.0 * t[0] - t[1] if len(t) > 1 else stamps[0]], t])
    edges = np.clip(edges, stamps[0], stamps[-1])
    span = np.diff(edges)
    at = np.interp(edges, stamps, total)
    single = np.interp(t, stamps, values)
    return np.where(span > 0.0, np.diff(at) / np.where(span > 0.0, span, 1.0), single)


def gap_lines(t: np.ndarray, streams: Mapping[str, Stamped]) -> tuple[str, ...]:
    """Describe gaps over LONG_GAP in streams with times other than the rows t (N,) [s], together
    for each file or topic.
    """
    found: dict[tuple[int, float, float], list[str]] = {}
    for name, (stamps, _) in streams.items():
        step = np.diff(stamps)
        if is_event(name) or not len(step) or np.array_equal(stamps, t):
            continue
        long = step > max(LONG_GAP, _GAP * float(np.median(step)))
        if long.any():
            worst = int(np.argmax(step))
            found.setdefault((int(long.sum()), step[worst], stamps[worst]), []).append(name)
    return tuple(
        f"gaps: {count} over {1e3 * LONG_GAP:.0f} ms in {names[0]}"
        + (f" and {len(names) - 1} more" if len(names) > 1 else "")
        + f", the longest {longest:.2f} s at {at:.2f} s: interpolated"
        for (count, longest, at), names in found.items()
    )


def jitter_line(t: np.ndarray) -> str | None:
    """Describe the jitter of the stamps t (N,) [s]; None where they are even to a hundredth."""
    step = np.diff(t)
    if not len(step):
        return None
    usual = float(np.median(step))
    spread = np.sqrt(np.mean((np.clip(step, 0.0, _GAP * usual) - usual) ** 2))
    if spread < 0.01 * usual:
        return None
    return (
        f"stamps: {1e3 * usual:.3g} ms apart, uneven by {1e3 * spread:.2g} ms (root mean square),"
        f" at most {1e3 * step.max():.3g} ms; [even] in the map makes rows even"
    )


def evened(table: Columns, rate: float) -> Columns:
    """Resample the rows of a table with `t` to an even rate [Hz] over the same time."""
    t = table["t"]
    even = np.arange(t[0], t[-1] + 1e-9, 1.0 / rate)
    streams = {name: (t, values) for name, values in table.items() if name != "t"}
    found = on_clock(even, streams, "the log")
    for name in found:
        if name.startswith(("gyro_", "accel_")):
            found[name] = means(found["t"], t, table[name])
    return found


def without_holds(table: Columns, kinds: tuple[str, ...]) -> Columns:
    """Interpolate the held columns of these kinds linearly between their samples."""
    found, t = dict(table), table["t"]
    for name, values in table.items():
        if column_kind(name) in kinds:
            read = np.concatenate([[True], np.diff(values) != 0.0])
            found[name] = np.interp(t, t[read], values[read])
    return found


def brought_forward(table: Columns, late: Mapping[str, float]) -> Columns:
    """Shift columns of these kinds or names to earlier times, by their delay [s].

    Rows at the ends for which a column has no value are cut.
    """
    t = table["t"]
    begin, end = t[0] - min(0.0, *late.values()), t[-1] - max(0.0, *late.values())
    inside = (t >= begin) & (t <= end)
    found = {name: values[inside] for name, values in table.items()}
    for name, values in table.items():
        delay = late.get(name, late.get(column_kind(name))) if name != "t" else None
        if delay is not None:
            found[name] = np.interp(t[inside] + delay, t, values)
    return found


def column_kind(name: str) -> str:
    """Kind of a column, as named in [even]: q, dq, gyro, foot, ..."""
    prefix = joint_prefix(name)
    return prefix[:-1] if prefix else name.split("_")[0]


def check_rising(t: np.ndarray, path: object, column: str, unit: str, rows: np.ndarray) -> None:
    """Raise LogError at the first time that is not later than the one before.

    Args:
        t: (N,) [s].
        path: of the file, for the message.
        column: its column, for the message.
        unit: name of a row in the message: "line", "message".
        rows: (N,) their numbers in the file.
    """
    bad = np.flatnonzero(np.diff(t) <= 0.0)
    if bad.size:
        row = int(bad[0]) + 1
        how = "duplicate stamp" if t[row] == t[row - 1] else "jumps back"
        raise LogError(
            f"{path}: column {column!r}, {unit} {rows[row]}: {how},"
            f" {t[row - 1]:.9g} s then {t[row]:.9g} s"
        )


def _rate(t: np.ndarray) -> float:
    return 1.0 / float(np.median(np.diff(t))) if len(t) > 1 else 1.0
