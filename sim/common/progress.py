"""Progress bars: drawn on a terminal, else one line a minute."""

import sys
from typing import Any, TextIO

from tqdm import tqdm

A_MINUTE = 60.0
"""Time before the first line and between lines if the output is no terminal [s]."""


def bar(iterable: Any = None, **options: Any) -> Any:
    """`tqdm.tqdm`, as a bar on a terminal and in lines elsewhere."""
    if sys.stderr.isatty():
        return tqdm(iterable, **options)
    quiet = {"mininterval": A_MINUTE, "maxinterval": A_MINUTE, "delay": A_MINUTE, "ncols": 79}
    return tqdm(iterable, file=_Lines(sys.stderr), **quiet, **options)


class _Lines:
    """A stream that turns every update of a bar into a line."""

    def __init__(self, stream: TextIO):
        self._stream = stream

    def write(self, text: str) -> None:
        if line := text.strip():
            self._stream.write(f"{line}\n")

    def flush(self) -> None:
        self._stream.flush()
