"""Progress bar for work that reports its completed share."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from surefoot.sim.common.progress import bar as drawn_bar


@contextmanager
def percent_bar(label: str) -> Iterator[Callable[[float], None]]:
    """Context with a function that takes the completed share of the work, from 0 to 1."""
    layout = "{l_bar}{bar}| {elapsed}<{remaining}"
    with drawn_bar(total=100, desc=label, unit="%", bar_format=layout) as bar:
        yield lambda share: bar.update(100.0 * share - bar.n)
