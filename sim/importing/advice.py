"""Lines of an import map that follow what the findings of a log advise, all of them together."""

import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

from scipy.spatial.transform import Rotation

from surefoot.sim.importing.columns import ColumnEntry, kind_of, map_line, read_column
from surefoot.sim.importing.map import ImportMap
from surefoot.sim.importing.sections import ReferenceTable

_OF_COLUMNS = re.compile(
    r"([\w, ]+?)(, \.\.\.)? = \{ (?:\.\.\.|column = <their column of (\w+)>)(?:, (.+))? \}"
)
_NO_TURN = (1.0, 0.0, 0.0, 0.0)
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
                named = found[1].split(", ")
                if found[2]:
                    named = [one for one in concerned if kind_of(one) == kind_of(named[0])]
                for section, entries in own.items():
                    for column in (one for one in named if one in entries):
                        there = changed.setdefault(section, {})
                        before: Any = there.get(column, entries[column])
                        there[column] = _changed(column, entries.get(found[3]) or before, changes)
            elif found := _IN_SECTION.fullmatch(line):
                _add(changed, rules, name, found[1], tomllib.loads(found[2]))
    lines: list[str] = []
    for section, values in changed.items():
        lines += [
            f"[{section}]",
            *(map_line(key, value) for key, value in values.items()),
        ]
    return tuple(lines)


def _changed(column: str, entry: ColumnEntry | str, changes: Mapping[str, Any]) -> ColumnEntry:
    """A column's entry, with changes to the values in SI that it gives so far."""
    entry = ColumnEntry(entry) if isinstance(entry, str) else entry
    sign, gain = changes.get("sign", 1.0), changes.get("gain", 1.0)
    entry = replace(
        entry,
        unit=changes.get("unit", entry.unit),
        sign=sign * entry.sign,
        gain=gain * entry.gain,
        offset=sign * gain * entry.offset + changes.get("offset", 0.0),
    )
    if "wrap" not in changes:
        return entry
    return replace(entry, wrap=changes["wrap"] / abs(read_column("", column, entry, ()).scale))


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
    there = changed.setdefault(section, {})
    there |= values
    if section == "reference" and reference is not None:
        there |= _turned_further(values, reference, rules.model)
        if "offset" in values and isinstance(reference.offset, dict):
            there["offset"] = reference.offset | {name: values["offset"]}
    elif section == "even" and even is not None:
        if "held" in values:
            there["held"] = [*dict.fromkeys((*even.held, *values["held"]))]
        if "late" in values:
            more = {kind: even.late.get(kind, 0.0) + x for kind, x in values["late"].items()}
            there["late"] = even.late | more


def _turned_further(
    values: Mapping[str, Any], reference: ReferenceTable, model: Mapping[str, Any]
) -> dict[str, Any]:
    """Advised rotations of a reference, together with those of the map, in the frame "imu"."""
    of_map = {"q_GW": reference.q_GW, "q_IM": reference.q_IM}
    made = {}
    if "q_IM" in values and reference.frame == "base":
        R_IB = Rotation.from_quat(model.get("q_BI", _NO_TURN), scalar_first=True).inv()
        made |= {"frame": "imu", "p_IM": (-R_IB.apply(model["p_BI"])).tolist()}
        of_map["q_IM"] = R_IB.as_quat(scalar_first=True)
    for key in values.keys() & of_map.keys():
        both = [Rotation.from_quat(q, scalar_first=True) for q in (values[key], of_map[key])]
        q = (both[0] * both[1]).as_quat(canonical=True, scalar_first=True)
        made[key] = (q.round(6) + 0.0).tolist()
    return made
