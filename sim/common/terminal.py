"""What a command prints: names in files cannot colour, move or imitate what a terminal shows."""

import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from shutil import get_terminal_size
from typing import Any, TextIO, cast
from unicodedata import category

NARROWEST = 20
"""Columns of a terminal below which help would take minutes to wrap."""
_TO_A_BAR = re.compile(r"\r|(\x1b\[A)+\Z")
"""What tqdm prints to reach the line of a bar."""


def printable(text: str, kept: str = "") -> str:
    """A text whose control characters are escaped, but for those in `kept`."""
    plain = {c for c in set(text) if c.isprintable() or c in kept or category(c) == "Zs"}
    return "".join(c if c in plain else ascii(c)[1:-1] for c in text)


def one_line(text: object) -> str:
    """Any message as one line without control characters."""
    line = printable(str(text))
    return line if len(line) <= 2000 else f"{line[:1500]} ... {line[-100:]}"


def plain_terminals() -> None:
    """Print characters that a terminal does not support as question marks; print nothing to closed
    streams.
    """
    sys.stdout = sys.stdout or open(os.devnull, "w")  # noqa: SIM115
    sys.stderr = sys.stderr or open(os.devnull, "w")  # noqa: SIM115
    if get_terminal_size().columns < NARROWEST:
        os.environ["COLUMNS"] = str(NARROWEST)
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")


@contextmanager
def printing_plainly() -> Iterator[None]:
    """Context in which nothing that is printed controls the terminal, but progress bars."""
    before = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = (cast(TextIO, _Plain(stream)) for stream in before)
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before


class _Plain:
    """A stream on which control characters are escaped."""

    def __init__(self, stream: TextIO):
        self._stream = stream

    def write(self, text: str) -> int:
        # What tqdm prints before each drawing of a bar, alone or first.
        start = _TO_A_BAR.match(text) if self._stream.isatty() else None
        drawn = start[0] if start else ""
        return self._stream.write(drawn + printable(text[len(drawn) :], "\n\t"))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)
