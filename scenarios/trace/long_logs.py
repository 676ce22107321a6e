"""Logs too long to be traced as a whole, represented by twenty blocks of one minute.

Each block is treated as a separate run: zeros and clocks, which drift within hours, are fitted to
each. A file is read in pieces, with the memory of a few blocks.
"""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from surefoot.sim.log import Log, LogReader

TRACED_BLOCKS = 20
"""Number of blocks, spread evenly from the first row to the last."""
TRACED_BLOCK = 60.0
"""Length of a block [s]."""


def in_blocks(log: Log) -> list[Log]:
    """The log, or its blocks if it is longer than all of them together."""
    return _blocks([log], log.meta.rate, len(log.t))


def read_in_blocks(path: str | Path) -> list[Log]:
    """Read a log from a file, or its blocks if it is longer than all of them together.

    Raises LogError, in one line with file, column and row, at the first fault anywhere in the file.
    """
    reader = LogReader(path)
    seconds = TRACED_BLOCK if _is_long(reader.rows, reader.meta.rate) else np.inf
    return _blocks(Log.chunks(reader, seconds), reader.meta.rate, reader.rows)


def note_on_blocks(logs: Iterable[list[Log]]) -> tuple[str, ...]:
    """A sentence if any of the logs, each given by its blocks, was divided."""
    cut = [blocks for blocks in logs if len(blocks) > 1]
    if not cut:
        return ()
    hours = max(blocks[-1].t[-1] - blocks[0].t[0] for blocks in cut) / 3600.0
    return (
        f"{len(cut)} of the logs last up to {hours:.1f} h and are traced on "
        f"{TRACED_BLOCKS} blocks of {TRACED_BLOCK:g} s each; zeros and clocks are fitted to each "
        "block",
    )


def _blocks(pieces: Iterable[Log], rate: float, rows: int) -> list[Log]:
    """The blocks of a log of so many rows, from its consecutive pieces; for a short log, its
    only piece.
    """
    if not _is_long(rows, rate):
        return list(pieces)
    length = _rows(rate)
    firsts = np.linspace(0, rows - length, TRACED_BLOCKS).round().astype(int)
    parts: list[list[Log]] = [[] for _ in firsts]
    end = 0
    for piece in pieces:
        begin, end = end, end + len(piece.frame)
        for own, first in zip(parts, firsts, strict=True):
            low, high = max(first, begin), min(first + length, end)
            if low < high:
                own.append(piece.rows(slice(low - begin, high - begin)))
    return [_joined(own, k) for k, own in enumerate(parts)]


def _joined(parts: list[Log], number: int) -> Log:
    frame = pd.concat([part.frame for part in parts], ignore_index=True)
    return replace(parts[0], frame=frame, name=f"{parts[0].name}_block_{number + 1}")


def _is_long(rows: int, rate: float) -> bool:
    return rows > TRACED_BLOCKS * _rows(rate)


def _rows(rate: float) -> int:
    return round(TRACED_BLOCK * rate)
