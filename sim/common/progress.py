"""Bars of progress: drawn on a terminal; a line a minute where a file or a pipe takes them."""

import sys
from typing import Any, TextIO

from tqdm import tqdm

A_MINUTE = 60.0
"""s between lines where nobody watches, and before the first."""


def bar(iterable: Any = None, **options: Any) -> Any:
    """`tqdm.tqdm`, that draws on a terminal alone. Takes and gives what that does."""
    if sys.stderr.isatty():
        return tqdm(iterable, **options)
    quiet = {"mininterval": A_MINUTE, "maxinterval": A_MINUTE, "delay": A_MINUTE, "ncols": 79}
    return tqdm(iterable, file=_Lines(sys.stderr), **quiet, **options)


class _Lines:
    """A stream to which every drawing of a bar is a line of its own."""

    def __init__(self, stream: TextIO):
        self._stream = stream

    def write(self, text: str) -> None:
        if line := text.strip():
            self._stream.write(f"{line}\n")

    def flush(self) -> None:
        self._stream.flush()
