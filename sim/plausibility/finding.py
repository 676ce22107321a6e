"""What a rule of plausibility finds in a log, and what a rule is."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from surefoot.sim.plausibility.view import LogView


@dataclass(frozen=True)
class Finding:
    """Something in a log that cannot be, or hardly.

    streams: columns that it is about; evidence: what was measured, with its unit; cause: the likely
    one; map_line: what mends it in an import map, "" where nothing there does; rule: by name.
    """

    streams: tuple[str, ...]
    evidence: str
    cause: str
    map_line: str = ""
    rule: str = ""

    @property
    def line(self) -> str:
        """In words."""
        mended = f"; in the map: {self.map_line}" if self.map_line else ""
        return f"{_named(self.streams)}: {self.cause} ({self.evidence}){mended}"


@dataclass(frozen=True)
class Rule:
    """One rule of plausibility.

    name; compares: what with what; threshold: from where on it speaks; reason: why there; remedy:
    what to do; needs: columns, by their first part, without which or in doubt of which it is not
    asked; find: what it finds in a log.
    """

    name: str
    compares: str
    threshold: str
    reason: str
    remedy: str
    needs: tuple[str, ...]
    find: Callable[[LogView], Iterator[Finding]]

    def asks_of(self, doubted: set[str]) -> bool:
        """Whether no column that it needs is in doubt."""
        return not any(d == n or d.startswith(f"{n}_") for d in doubted for n in self.needs)


def _named(columns: Sequence[str]) -> str:
    return ", ".join(columns) if len(columns) <= 4 else f"{columns[0]} to {columns[-1]}"
