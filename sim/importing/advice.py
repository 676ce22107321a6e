"""Lines of an import map that follow what the findings of a log advise, all of them together."""

import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from surefoot.sim.importing.columns import ColumnEntry, map_line
from surefoot.sim.importing.map import ImportMap

_OF_COLUMNS = re.compile(
    r"([\w, ]+?)(, \.\.\.)? = \{ (?:\.\.\.|column = <their column of (\w+)>)(?:, (.+))? \}"
)
_IN_SECTION = re.compile(r"\[([\w.]+)\] (.+ = .+)")


def advised_lines(
    advice: Iterable[tuple[Sequence[str], str]], rules: ImportMap, name: str
) -> tuple[str, ...]:
    """Lines to put in place of those of a map; advice that leaves a choice is left out.

    Args:
        advice: the columns concerned and the line of each finding.
        rules: the map with which the log was imported.
        name: of the recording.
    """
    own = {"columns": rules.sections.columns}
    if rules.sections.reference is not None:
        own["reference.columns"] = rules.sections.reference.columns
    changed: dict[str, dict[str, Any]] = {}
    for concerned, text in advice:
        for line in text.split("; "):
            if found := _OF_COLUMNS.fullmatch(line):
                changes = tomllib.loads(f"of = {{ {found[4] or ''} }}")["of"]
                named = concerned if found[2] else found[1].split(", ")
                for section, entries in own.items():
                    for column in (one for one in named if one in entries):
                        there = changed.setdefault(section, {})
                        before = there.get(column, entries[column])
                        there[column] = _changed(entries.get(found[3], before), changes)
            elif found := _IN_SECTION.fullmatch(line):
                _add(changed, rules, name, found[1], tomllib.loads(found[2]))
    lines: list[str] = []
    for section, values in changed.items():
        lines += [
            f"[{section}]",
            *(map_line(key, value) for key, value in values.items()),
        ]
    return tuple(lines)


def _changed(entry: ColumnEntry | str, changes: Mapping[str, Any]) -> ColumnEntry:
    """A column's entry, with changes to the values that it gives so far."""
    entry = ColumnEntry(entry) if isinstance(entry, str) else entry
    sign, gain = changes.get("sign", 1.0), changes.get("gain", 1.0)
    return replace(
        entry,
        unit=changes.get("unit", entry.unit),
        sign=sign * entry.sign,
        gain=gain * entry.gain,
        offset=sign * gain * entry.offset + changes.get("offset", 0.0),
        wrap=changes.get("wrap", entry.wrap),
    )


def _add(
    changed: dict[str, dict[str, Any]],
    rules: ImportMap,
    name: str,
    section: str,
    values: dict[str, Any],
) -> None:
    """Add advised keys of a section, together with what the map has there.

    Args:
        changed: values by section and key, which are added to.
        rules: the map.
        name: of the recording.
        section: that is named in the advice.
        values: advised ones.
    """
    if section == "robot.joint_sign":
        own = rules.sections.robot.joint_sign if rules.sections.robot else {}
        signs = changed.setdefault("robot", {}).setdefault("joint_sign", dict(own))
        signs |= {joint: sign * own.get(joint, 1.0) for joint, sign in values.items()}
        return
    reference, even = rules.sections.reference, rules.sections.even
    turns = reference and (reference.frame == "base" or any(reference.q_IM[1:]))
    if "q_IM" in values and turns:
        return  # the map turns the body already, or not by q_IM
    there = changed.setdefault(section, {})
    there |= values
    if section == "reference" and reference and isinstance(reference.offset, dict):
        there |= {key: reference.offset | {name: x} for key, x in values.items() if key == "offset"}
    elif section == "even" and even is not None:
        if "held" in values:
            there["held"] = [*dict.fromkeys((*even.held, *values["held"]))]
        if "late" in values:
            more = {kind: even.late.get(kind, 0.0) + x for kind, x in values["late"].items()}
            there["late"] = even.late | more
