"""Changes to an import map that findings of a log advise: in words, and as lines of the map."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from surefoot.sim.importing.columns import ColumnEntry, map_line, read_column
from surefoot.sim.importing.map import ImportMap
from surefoot.sim.importing.sections import ContactTable, EvenTable

Changes = Mapping[str, Mapping[str, Any]]
"""By section and key of a map, the value that it is to have. Those of _COMBINED are relative to the
map's own.

In "columns", which stands for those of the reference too, a value has the keys of a `ColumnEntry`
that change, relative to its conversion to SI: `sign`, `gain` and `offset` follow it, `wrap` is in
SI. `of` is the log's column whose entry is taken instead.
"""
_Values = dict[tuple[str, str], Any]
"""Values of a map by section and key."""


def entries(columns: Iterable[str], **keys: Any) -> Changes:
    """The same change of the entries of some columns of the log."""
    return {"columns": dict.fromkeys(columns, keys)}


def scaled(column: str, factor: float) -> Changes:
    """The change of the entry of a column whose values are `factor` times too large."""
    return entries((column,), gain=float(f"{1.0 / factor:.4g}"))


def quaternion(R: Rotation) -> tuple[float, ...]:
    """A rotation as w, x, y, z for a map."""
    return _rounded(R.as_quat(canonical=True, scalar_first=True))


def advice_words(changes: Changes) -> str:
    """Changes to a map that is not known, in words."""
    words: dict[str, list[str]] = {}
    for section, values in changes.items():
        for key, value in values.items():
            if section != "columns":
                words[f"{map_line(key, value)} in [{section}]"] = []
                continue
            keys = [f"the column of {x}" if k == "of" else map_line(k, x) for k, x in value.items()]
            words.setdefault(f"{', '.join(keys)} in the entry of ", []).append(key)
    return "; ".join(f"{what}{', '.join(columns)}" for what, columns in words.items())


def advised_lines(
    advice: Iterable[Changes], rules: ImportMap, name: str
) -> tuple[tuple[str, ...], tuple[bool, ...]]:
    """Lines to put in place of those of a map, and which advice they follow: that which the map has
    a place for.

    Args:
        advice: of each finding.
        rules: the map with which the log was imported.
        name: of the recording.
    """
    before = mended = _values(rules)
    follows, lines = [], []
    for changes in advice:
        after = _followed(mended, changes, name)
        follows.append(after != mended)
        mended = after
    for (section, key), value in mended.items():
        if value != before[section, key]:
            lines += [f"[{section}]"] * (f"[{section}]" not in lines) + [map_line(key, value)]
    return tuple(lines), tuple(follows)


def lines_of(changes: Changes) -> tuple[str, ...]:
    """Changes to sections of a map that is not known, as lines of one without them."""
    return tuple(
        line
        for section, values in changes.items()
        for line in (f"[{section}]", *(map_line(*one) for one in values.items()))
    )


def _values(rules: ImportMap) -> _Values:
    """The values of a map that advice may be about."""
    of = rules.sections
    contact = of.contact or ContactTable(on=0.0, off=0.0)
    given = {"reference": of.reference, "robot": of.robot, "contact": contact}
    given["even"] = of.even or EvenTable()
    tables = {"columns": of.columns} | {name: vars(x) for name, x in given.items() if x}
    tables["reference.columns"] = of.reference.columns if of.reference else {}
    tables["model"] = rules.model
    return {(section, key): x for section, table in tables.items() for key, x in table.items()}


def _followed(given: _Values, changes: Changes, name: str) -> _Values:
    """The values of a map with changes made for the recording `name`; as they are where it lacks a
    section.
    """
    if not changes.keys() <= {section for section, _ in given}:
        return given
    after = given | _body_by_imu(given, changes)
    for section, values in changes.items():
        for key, value in values.items():
            if section == "columns":
                places = [x for x in ((section, key), ("reference.columns", key)) if x in given]
                after |= {place: _changed(given, place, value) for place in places}
                continue
            before = after[section, key]
            if (section, key) == ("reference", "offset") and isinstance(before, dict):
                value = before | {name: value}
            after[section, key] = _COMBINED[key](before, value) if key in _COMBINED else value
    return after


def _changed(given: _Values, place: tuple[str, str], keys: Mapping[str, Any]) -> ColumnEntry:
    """The entry of a column at a place of a map, with changes."""
    section, column = place
    entry = given.get((section, keys.get("of", column)), given[place])
    entry = ColumnEntry(entry) if isinstance(entry, str) else entry
    sign, gain = keys.get("sign", 1.0), keys.get("gain", 1.0)
    entry = replace(
        entry,
        unit=keys.get("unit", entry.unit),
        sign=sign * entry.sign,
        gain=gain * entry.gain,
        offset=sign * gain * entry.offset + keys.get("offset", 0.0),
    )
    if "wrap" not in keys:
        return entry
    return replace(entry, wrap=keys["wrap"] / abs(read_column("", column, entry, ()).scale))


def _body_by_imu(given: _Values, changes: Changes) -> _Values:
    """The place of a reference's body relative to the IMU as it is to be turned, where it is the
    base or the IMU itself is turned.
    """
    turned = changes.get("reference", {})
    if turned.keys().isdisjoint(("q_IM", "p_IM")):
        return {}
    place = {key: given["reference", key] for key in ("frame", "p_IM", "q_IM")}
    if place["frame"] == "base":
        q_BI = given.get(("model", "q_BI"), (1.0, 0.0, 0.0, 0.0))
        R_IB = Rotation.from_quat(q_BI, scalar_first=True).inv()
        p_IB = _rounded(-R_IB.apply(given["model", "p_BI"]))
        place = {"frame": "imu", "p_IM": p_IB, "q_IM": quaternion(R_IB)}
    if "robot" in changes:
        turn = Rotation.from_quat(turned["q_IM"], scalar_first=True)
        place["p_IM"] = _rounded(turn.apply(place["p_IM"]))
    return {("reference", key): value for key, value in place.items()}


def _rounded(p: np.ndarray) -> tuple[float, ...]:
    return tuple((p.round(6) + 0.0).tolist())


def _turned(given: Sequence[float], q: Sequence[float]) -> tuple[float, ...]:
    before, after = (Rotation.from_quat(x, scalar_first=True) for x in (given, q))
    return quaternion(after * before)


_COMBINED: Mapping[str, Callable[[Any, Any], Any]] = {
    "q_GW": _turned,
    "q_IM": _turned,
    "p_IM": lambda given, moved: _rounded(np.add(given, moved)),
    "joint_sign": lambda given, new: given | {k: x * given.get(k, 1.0) for k, x in new.items()},
    "late": lambda given, new: given | {k: x + given.get(k, 0.0) for k, x in new.items()},
    "held": lambda given, new: tuple(dict.fromkeys((*given, *new))),
}
"""How an advised value is combined with the map's own, by key."""
