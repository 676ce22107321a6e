"""Plausibility rules, and what they find in a log."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from surefoot.sim.plausibility.view import LogView


@dataclass(frozen=True)
class Finding:
    """An implausibility in a log.

    Attributes:
        streams: columns concerned.
        evidence: what was measured, with its unit.
        cause: the likely one.
        map_line: correction in an import map, "" where there is none.
        rule: name of the rule.
    """

    streams: tuple[str, ...]
    evidence: str
    cause: str
    map_line: str = ""
    rule: str = ""

    @property
    def line(self) -> str:
        """The finding in words."""
        mended = f"; in the map: {self.map_line}" if self.map_line else ""
        return f"{_named(self.streams)}: {self.cause} ({self.evidence}){mended}"


@dataclass(frozen=True)
class Rule:
    """A plausibility rule.

    Attributes:
        name: unique.
        compares: what is compared with what.
        threshold: from which it reports.
        reason: for the threshold.
        remedy: what to do.
        needs: columns or their prefixes; the rule is skipped where one of them is in doubt.
        find: function that finds violations in a log.
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
