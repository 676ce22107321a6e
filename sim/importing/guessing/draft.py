"""A draft of an import map: its entries, and its text with a question for each doubt.

`sim.importing.guessing.guess` creates drafts from the files of a recording.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from surefoot.sim.common.terminal import printable
from surefoot.sim.importing.columns import UNITS, ColumnEntry, kind_of, map_line

_LISTED = 20
"""Largest number of unused columns that are listed for a reason."""

_INTRODUCTION = (
    "# A draft by `surefoot import --guess`. A line with a # ? is a question: answer it by",
    "# what you know of the robot, then delete it. No log tells the signs of joints.",
)


@dataclass(frozen=True)
class Entry:
    """A column of the log, and the column of the recording that it is read from.

    Attributes:
        name: the log's column.
        theirs: the recording's column.
        unit: theirs, None where it has none.
        gain: as in a map.
        doubt: a question for the user, empty where there is none.
    """

    name: str
    theirs: str
    unit: str | None = None
    gain: float = 1.0
    doubt: str = ""

    @property
    def scale(self) -> float:
        """Factor from the recording's values to SI units."""
        return self.gain * (UNITS[kind_of(self.name)][self.unit] if self.unit else 1.0)


@dataclass(frozen=True)
class Draft:
    """A draft of a map.

    Attributes:
        file: the main file.
        main: entries of [columns].
        reference: entries of [reference.columns], from `reference_file`.
        reference_file: file of the reference.
        sources: further files by name, with the entry of their times.
        layouts: keys of [source] for text files.
        rate: of the rows [Hz], where no times were found, and what states it.
        robot: name.
        contact: on and off force of [contact].
        notes: questions that concern no single column.
        unused: columns and arrays without a use, by the reason.
    """

    file: Path
    main: tuple[Entry, ...]
    reference: tuple[Entry, ...] = ()
    reference_file: Path | None = None
    sources: Mapping[str, tuple[Path, Entry]] = field(default_factory=dict)
    layouts: Mapping[Path, Mapping[str, object]] = field(default_factory=dict)
    rate: tuple[float, str] | None = None
    robot: str | None = None
    contact: tuple[float, float] | None = None
    notes: tuple[str, ...] = ()
    unused: Mapping[str, Sequence[str]] = field(default_factory=dict)

    @property
    def text(self) -> str:
        """The draft as a map file (TOML)."""
        sections = {"[source]": self._file(self.file)}
        if self.rate:
            rate, stated = self.rate
            asked = f"# ? no times found; by {' '.join(stated.split())}"
            sections["[source]"].append(f"rate = {rate:.6g} {asked}")
        for name, (path, clock) in self.sources.items():
            sections[f"[sources.{name}]"] = [*self._file(path), _line(replace(clock, name="t"))]
        sections["[columns]"] = _lines(self.main)
        if self.reference:
            of = 'frame = "imu" # ? whose pose is it, and on which clock: try surefoot align'
            file = self.reference_file
            named = self._file(file) if file is not None and file != self.file else []
            sections |= {"[reference]": [*named, of], "[reference.columns]": _lines(self.reference)}
        if self.robot:
            sections["[robot]"] = [map_line("name", self.robot)]
        if self.contact:
            on, off = self.contact
            heading = "[contact] # ? are these between swing and stance?"
            sections[heading] = [f"on = {on:.4g}", f"off = {off:.4g}"]
        lines = [*_INTRODUCTION, *(f"# ? {' '.join(note.split())}" for note in self.notes)]
        for heading, body in sections.items():
            lines += ["", heading, *body]
        lines += [""] * bool(self.unused)
        for reason, names in self.unused.items():
            listed = ", ".join(names[:_LISTED]) + ", ..." * (len(names) > _LISTED)
            lines.append(f"# not used ({reason}): {' '.join(listed.split())}")
        return printable("\n".join(lines), "\n") + "\n"

    def _file(self, path: Path) -> list[str]:
        """Lines that name a file and its layout."""
        keys = {"file": path.name} | {**self.layouts.get(path, {})}
        return [map_line(key, value) for key, value in keys.items()]


def _lines(entries: Sequence[Entry]) -> list[str]:
    """Lines of entries; a doubt is written above the first of those that share it, and marks
    each.
    """
    lines, above = [], ""
    for entry in entries:
        if entry.doubt and entry.doubt != above:
            lines.append(f"# ? {' '.join(entry.doubt.split())}")
        above = entry.doubt
        lines.append(_line(entry))
    return lines


def _line(entry: Entry) -> str:
    column = ColumnEntry(entry.theirs, entry.unit, gain=entry.gain)
    return map_line(entry.name, column) + " # ?" * bool(entry.doubt)
