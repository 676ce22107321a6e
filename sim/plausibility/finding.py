"""What plausibility rules declare, and what they find in a log."""

import inspect
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

from surefoot.sim.importing.advice import Changes, advice_words
from surefoot.sim.plausibility import limits

_Find = Callable[..., Iterator["Finding"]]
PARAGRAPHS = ("Compares", "Threshold", "Reason", "Remedy")
"""Titles of the paragraphs that explain a rule."""


@dataclass(frozen=True)
class Finding:
    """An implausibility in a log.

    Attributes:
        streams: columns concerned.
        evidence: what was measured, with its unit; of several columns, that of the first.
        cause: the likely one, and what is to be decided or found out to correct it.
        changes: to the import map, that correct it; none where they are not known.
        rule: name of the rule.
    """

    streams: tuple[str, ...]
    evidence: str
    cause: str
    changes: Changes = field(default_factory=dict)
    rule: str = ""

    @property
    def map_line(self) -> str:
        """The correction in an import map in words, "" where there is none."""
        return advice_words(self.changes)

    @property
    def line(self) -> str:
        """The finding in words."""
        mended = f"; in the map, on top of its own: {self.map_line}" if self.map_line else ""
        return f"{_named(self.streams)}: {self.cause} ({self.evidence}){mended}"


@dataclass(frozen=True)
class Rule:
    """A plausibility rule: a function that finds violations in a log, which its docstring explains.

    Attributes:
        name: unique.
        find: the function, of a `LogView`.
        needs: columns or their prefixes; the rule is skipped where one is missing or in doubt.
        beside: columns or prefixes that may be missing, but must not be in doubt.
        when: properties of the view without which there is nothing to compare.
        is_note: whether it is only good to know, and puts no column in doubt.
    """

    name: str
    find: _Find
    needs: tuple[str, ...]
    beside: tuple[str, ...]
    when: tuple[str, ...]
    is_note: bool

    @property
    def explained(self) -> dict[str, str]:
        """The paragraphs of its docstring, by the titles of PARAGRAPHS.

        Names in braces are those of its module, or shared limits.
        """
        known = vars(limits) | vars(sys.modules[self.find.__module__])
        titles = re.compile(rf"^({'|'.join(PARAGRAPHS)}): ", re.M)
        _, *parts = titles.split(inspect.getdoc(self.find) or "")
        texts = (" ".join(text.split()).removesuffix(".").format_map(known) for text in parts[1::2])
        return dict(zip(parts[::2], texts, strict=True))


def plausibility_rule(
    name: str, needs: str = "", beside: str = "", when: str = "", is_note: bool = False
) -> Callable[[_Find], Rule]:
    """Make a function that finds violations in a log a `Rule`.

    Args:
        name: of the rule.
        needs, beside, when: as of `Rule`, each in one text.
        is_note: as of `Rule`.
    """
    needed = tuple(needs.split()), tuple(beside.split()), tuple(when.split())
    return lambda find: Rule(name, find, *needed, is_note)


def _named(columns: Sequence[str]) -> str:
    return ", ".join(columns) if len(columns) <= 4 else f"{columns[0]} to {columns[-1]}"
