"""Progress bars that fit into 80 columns, with the time that is left."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from surefoot.sim.common.progress import bar as drawn_bar

LAYOUT = "{l_bar}{bar}| {elapsed}, {remaining} left{postfix}"
COUNTED = "{desc}: {n_fmt} of {total_fmt} |{bar:20}| {elapsed}, {remaining} left{postfix}"
LONGEST_LABEL = 24
"""Number of characters to which a label is cut."""


@contextmanager
def percent_bar(label: str) -> Iterator[Callable[[float], None]]:
    """Context with a function that takes the completed share of the work, from 0 to 1."""
    with drawn_bar(total=100, desc=_short(label), bar_format=LAYOUT) as bar:
        yield lambda share: bar.update(100.0 * share - bar.n)


@contextmanager
def counted_bar(label: str, total: int) -> Iterator[Callable[[str], None]]:
    """Context with a function that is called before each of `total` items, with its name."""
    with drawn_bar(total=total, desc=_short(label), bar_format=COUNTED) as bar:
        started: list[str] = []

        def begin(name: str) -> None:
            bar.set_postfix_str(name, refresh=False)  # or a pipe has a line an item
            bar.update(len(started) - bar.n)
            started.append(name)

        yield begin
        bar.set_postfix_str("", refresh=False)
        bar.update(len(started) - bar.n)


def _short(label: str) -> str:
    return label if len(label) <= LONGEST_LABEL else f"{label[: LONGEST_LABEL - 3]}..."
