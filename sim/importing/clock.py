"""Resample streams of several files and topics, each with its own times, to the rows of one log."""

from bisect import bisect_left
from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

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
_FEW_OUTSIDE = 0.05
"""Share of the rows outside the reference that are not worth a note."""
_GOES_ON, _SHOWS, _WITHIN = 0.5, 0.25, 0.01
"""Relative error up to which motion goes on over a leap of the stamps, least motion relative to the
usual from which that shows, and time over which motion hardly changes [s]: found in nine of ten
leaps of walks of 50 to 500 Hz, and in one of a hundred gaps.
"""
_AVERAGING_RATIO = 1.5
"""Ratio to the log's rate from which an IMU is averaged over a row instead of interpolated."""
_MOST_LEFT_OUT = 0.05
"""Share of a stream's rows whose stamps may be wrong; more of them are no accident."""
_MOST_SET_BACK = 3.5
"""Number of rows by which stamps may go back and on from there, as messages overtake each other."""
_ROUNDED = 1e-6
"""Largest error of a stamp that was rounded [s]."""
_ROWS_TO_A_FAR_ONE = 100
"""Number of rows to one that may lie far from all others, at either end."""
_EPOCH = 1e6
"""Time beyond which a clock counts from an epoch, such as Unix time [s]: eleven days."""


def is_event(name: str) -> bool:
    """Whether a column holds its value until the next sample: contacts and flags."""
    return name.startswith(("contact_", "ref_ok"))


def on_clock(
    t: np.ndarray, streams: Mapping[str, Stamped], where: str, averaged: float = _AVERAGING_RATIO
) -> Columns:
    """Resample streams to the times t (N,) [s], including `t`; times outside any stream are cut.

    Streams with exactly these times are used as they are. Of others, events hold their last value,
    readings are interpolated, and gyro and accel, from a ratio `averaged` of their rate to that of
    the rows, are averaged over the interval since the preceding row, which is their definition in a
    log. Raises SurefootError, starting with `where`, where they do not overlap in time.
    """
    begin = max([t[0], *(stamps[0] for stamps, _ in streams.values())])
    end = min([t[-1], *(stamps[-1] for n, (stamps, _) in streams.items() if not is_event(n))])
    inside = (t >= begin) & (t <= end)
    if not inside.any():
        times = {"t": t} | {name: stamps for name, (stamps, _) in streams.items()}
        early, last = (pick(times, key=lambda name: times[name][0]) for pick in (min, max))
        raise SurefootError(
            f"{where}: the topics and files of the map do not overlap in time: {early} is"
            f" {span(times[early])}, {last} {span(times[last])}; t of a further file has an offset"
        )
    table = {"t": t[inside]}
    for name, (stamps, values) in streams.items():
        if len(stamps) == len(t) and np.array_equal(stamps, t):
            table[name] = values[inside]
        elif is_event(name):
            table[name] = values[np.searchsorted(stamps, t[inside] + _ROUNDED, "right") - 1]
        elif name.startswith(("gyro_", "accel_")) and usual_rate(stamps) > averaged * usual_rate(t):
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


def legs_moving(table: Mapping[str, np.ndarray] | pd.DataFrame) -> np.ndarray:
    """Angles of joints and coordinates of feet (N, D) of a table with `t`."""
    names = [name for name in map(str, table) if column_kind(name) in ("q", "foot")]
    return np.column_stack([np.zeros((len(table["t"]), 0)), *(table[name] for name in names)])


def set_forward(t: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Rows (K,) after which times t (N,) [s] leap, but motion x (N, D) goes on as it does beside: a
    clock that was set, where none are missing. At rest, nothing is known.
    """
    step = np.diff(t)
    if len(step) < 3:
        return np.zeros(0, dtype=int)
    usual = float(np.median(step))
    rows = max(1, round(_WITHIN / usual))
    # Rows that were held up follow each other at once.
    caught_up = np.append(step[1:], usual) < 0.5 * usual
    leaps = np.flatnonzero((step > max(LONG_GAP, _GAP * usual)) & ~caught_up)
    around = leaps[:, None] - rows // 2 + rows * np.arange(-1, 3)
    around = around[(around[:, 0] >= 0) & (around[:, 3] < len(t))]
    x = x / np.maximum(x.std(axis=0), 1e-12)
    before, over, after = np.diff(x[around], axis=1).swapaxes(0, 1)
    expected = 0.5 * (before + after)
    moves, missed = (np.linalg.norm(one, axis=1) for one in (expected, over - expected))
    least = _SHOWS * np.median(np.linalg.norm(x[rows:] - x[:-rows], axis=1))
    return around[(missed < _GOES_ON * moves) & (moves > least), 1] + rows // 2 + 1


def outside_lines(table: Columns, reference_t: np.ndarray) -> tuple[str, ...]:
    """A note on rows that a log omits, since its reference (M,) [s] does not reach them."""
    t = table["t"]
    out = (t < reference_t[0]) | (t > reference_t[-1])
    if out.mean() <= _FEW_OUTSIDE:
        return ()
    said = f"rows: left out, outside the reference ({span(reference_t)}): {out.sum()} of {len(t)}"
    for row in set_forward(t, legs_moving(table))[:1]:
        said += f"; stamps leap from {seconds(t[row - 1])} to {seconds(t[row])} s while joints go"
        said += " on: a clock that was set; import the rows from there on separately"
    return (said,)


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


def without_holds(table: Columns, kinds: tuple[str, ...]) -> Columns:
    """Interpolate the held columns of these kinds linearly between their samples."""
    found, t = dict(table), table["t"]
    for name, values in table.items():
        if column_kind(name) in kinds:
            read = np.concatenate([[True], np.diff(values) != 0.0])
            found[name] = np.interp(t, t[read], values[read])
    return found


def resampled(table: Columns, t: np.ndarray, delays: Mapping[str, float]) -> Columns:
    """Resample a table to the times t (N,) [s], and shift columns of some kinds or names to earlier
    ones, by their delay [s].

    Times for which a column has no value are cut; raises SurefootError if none is left.
    """
    streams: dict[str, Stamped] = {}
    for name, values in table.items():
        delay = delays.get(name, delays.get(column_kind(name), 0.0))
        streams[name] = table["t"] - delay, values
    del streams["t"]
    inside = t[t <= table["t"][-1] - max((0.0, *delays.values()))]
    if not len(inside):
        raise SurefootError("[even] late: is longer than the recording")
    return on_clock(inside, streams, "[even]", averaged=0.0)


def column_kind(name: str) -> str:
    """Kind of a column, as named in [even]: q, dq, gyro, foot, ..."""
    prefix = joint_prefix(name)
    return prefix[:-1] if prefix else name.split("_")[0]


def kept_rows(
    t: np.ndarray, values: Sequence[np.ndarray], column: str, unit: str, rows: np.ndarray
) -> tuple[np.ndarray, str]:
    """Rows (K,) of a stream that have a stamp of their own, and a note on the others.

    A sample that repeats an earlier one, stamp and values, is left out, and so are the fewest rows
    without which the stamps rise: one that leaps, one in the wrong place, the second of two with
    one stamp. Stamps at either end from before a clock was set are, too. The note is "" if none is
    left out. Raises LogError where these are more than single rows.

    Args:
        t: (N,) [s].
        values: of the samples, each (N,).
        column: file and column of the stamps, for messages.
        unit: name of a row: "line", "message".
        rows: (N,) their numbers in the file.
    """
    kept = np.arange(len(t))
    if not rises(t):
        kept = np.flatnonzero(~pd.DataFrame(np.column_stack([t, *values])).duplicated())
    repeated, unlike = len(t) - len(kept), kept
    kept = kept[_longest_rise(t[kept])]
    kept = kept[_without_far_ends(t[kept])]
    out = np.setdiff1d(unlike, kept)
    if len(out) > max(1.0, _MOST_LEFT_OUT * len(t)) or _goes_back(t[unlike], np.isin(unlike, kept)):
        raise LogError(f"{column}, {_contradiction(t, out, kept, unit, rows)}")
    said = [f"{repeated} repeated samples"] if repeated else []
    if len(out):
        said += [f"{len(out)} rows whose stamps do not rise with the others'"]
        said[-1] += f" (the first in {unit} {rows[out[0]]}, {seconds(t[out[0]])} s)"
    return kept, f"{column}: left out: {' and '.join(said)}" if said else ""


def rises(t: np.ndarray) -> bool:
    """Whether every time of t (N,) is later than the one before."""
    return bool(np.all(np.diff(t) > 0.0))


def mostly_rises(t: np.ndarray) -> bool:
    """Whether t (N,) rises but for single times, and samples that are repeated."""
    changes = t[np.concatenate([[True], np.diff(t) != 0.0])]
    least = (1.0 - _MOST_LEFT_OUT) * len(changes)
    return rises(t) or (len(changes) > 2 and len(_longest_rise(changes)) >= least)


def _goes_back(t: np.ndarray, kept: np.ndarray) -> bool:
    """Whether t (N,) lacks the time of rows that were left out between those in the mask `kept`, as
    after a clock was set back; a row in the wrong place lacks one or two.
    """
    rows, step = np.flatnonzero(kept), np.diff(t[kept])
    if kept.all() or not len(step):
        return False
    return bool(np.any(np.diff(rows) - step / np.median(step) > _MOST_SET_BACK))


def _contradiction(
    t: np.ndarray, out: np.ndarray, kept: np.ndarray, unit: str, rows: np.ndarray
) -> str:
    """Describe stamps of which too many do not rise.

    Args:
        t: (N,) [s].
        out: rows that are left out.
        kept: rows that are not.
        unit: name of a row.
        rows: (N,) their numbers in the file.
    """
    if np.isin(out - 1, np.flatnonzero(np.diff(t) == 0.0)).mean() > 0.5:
        return (
            f"{unit} {rows[out[0]]}: repeats the stamp {seconds(t[out[0]])} s with other values, as"
            f" {len(out)} of {len(t)} do: too coarse a clock; give another t, or the rate of the"
            " rows"
        )
    row = int(np.argmin(np.diff(t))) + 1
    return (
        f"{unit} {rows[row]}: jumps back, {seconds(t[row - 1])} s then {seconds(t[row])} s: a clock"
        f" that was restarted or set back; import what is before {unit} {rows[row]}"
        " and the rest separately"
    )


def _longest_rise(t: np.ndarray) -> np.ndarray:
    """Indices (K,) of the longest rising subsequence of t (N,) (Fredman, Discrete Mathematics 11,
    1975).
    """
    if rises(t):
        return np.arange(len(t))
    ends: list[float] = []
    at: list[int] = []
    before: list[int] = []
    for k, x in enumerate(t.tolist()):
        place = bisect_left(ends, x)
        before.append(at[place - 1] if place else -1)
        if place == len(ends) or x < ends[place]:  # of equal ones, the first
            ends[place : place + 1], at[place : place + 1] = [x], [k]
    chain = [at[-1]]
    while before[chain[-1]] >= 0:
        chain.append(before[chain[-1]])
    return np.array(chain[::-1])


def _without_far_ends(t: np.ndarray) -> slice:
    """The rows of rising t (N,) without a few at an end, beyond a gap longer than all the rest."""
    few = len(t) // _ROWS_TO_A_FAR_ONE
    step = np.diff(t)
    first = next((k for k in range(few, 0, -1) if step[k - 1] > t[-1] - t[k]), 0)
    last = next((k for k in range(few, 0, -1) if step[-k] > t[-k - 1] - t[first]), 0)
    return slice(first, len(t) - last)


def epoch_of(t: np.ndarray) -> float:
    """Whole seconds to subtract from times t (N,) [s] that count from an epoch; 0 from others."""
    return float(np.floor(t[0])) if len(t) and abs(t[0]) > _EPOCH else 0.0


def span(t: np.ndarray) -> str:
    """First and last of times t (N,) [s]."""
    return f"from {seconds(t[0])} to {seconds(t[-1])} s"


def seconds(t: float | np.ndarray) -> str:
    """A time [s] with all digits down to a microsecond."""
    return f"{t:.6f}".rstrip("0").rstrip(".")


def usual_rate(t: np.ndarray) -> float:
    """Usual rate [Hz] of times t (N,) [s], to six digits; 1 of a single one."""
    return float(f"{1.0 / np.median(np.diff(t)):.6g}") if len(t) > 1 else 1.0
