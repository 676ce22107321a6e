"""Progress bars that fit into 80 columns, with the time that is left."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from surefoot.sim.common.progress import bar as drawn_bar

LAYOUT = "{l_bar}{bar}| {elapsed}, {remaining} left{postfix}"
LONGEST_LABEL = 24
"""Number of characters to which a label is cut."""


@contextmanager
def percent_bar(label: str) -> Iterator[Callable[[float], None]]:
    """Context with a function that takes the completed share of the work, from 0 to 1."""
    with drawn_bar(total=100, desc=label[:LONGEST_LABEL], bar_format=LAYOUT) as bar:
        yield lambda share: bar.update(100.0 * share - bar.n)
