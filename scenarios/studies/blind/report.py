"""The report of the blind study: its rules, its confusion matrix, and tables of what was found."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from surefoot.scenarios.reporting.html import Picture, Section, write_report
from surefoot.scenarios.reporting.tables import to_csv, to_markdown
from surefoot.scenarios.studies.blind.figures import confusion, sizes
from surefoot.scenarios.studies.blind.score import (
    Record,
    by_effect,
    by_size,
    channel_said,
    named,
    points,
    right_channel,
    rules,
    tells_twins,
    truth,
)
from surefoot.sim.common.files import whole_file


def write_report_of(out: Path, records: Sequence[Record]) -> str:
    """Write report.html, table.md and cases.csv; returns the tables as text."""
    tables = {
        "What was asked, and what was measured": rules(records),
        "By effect": by_effect(records),
        "By size over the least that the log could show": by_size(records),
        **details([r for r in records if "fell" not in r]),
    }
    picture = Picture(
        confusion(records),
        "Rows: the effect that was put in, one of each log. Columns: the effect that trace named "
        "first. On the diagonal the target (joint, leg or axis) is right too, and the verdict is "
        "not confounded.",
    )
    sized = Picture(
        sizes(records),
        "A dot a log whose effect and target were named right first. The band is a tenth about the "
        "size put in; red where neither the band nor the interval holds it. Beyond the axis, dots "
        "stand at its edge.",
    )
    pictures = {"By effect": (picture,), "By size over the least that the log could show": (sized,)}
    parts = [
        Section(heading, table=rows, pictures=pictures.get(heading, ()))
        for heading, rows in tables.items()
    ]
    parts.append(Section("Every case", table=[_row(r) for r in records]))
    write_report(out / "report.html", "Blind study of trace", parts, True)
    text = "\n\n".join(f"{heading}\n\n{to_markdown(rows)}" for heading, rows in tables.items())
    for name, content in (
        ("table.md", text + "\n"),
        ("cases.csv", to_csv([_row(r) for r in records])),
    ):
        with whole_file(out / name, force=True) as temporary:
            temporary.write_text(content, encoding="utf-8")
    return text


def details(records: Sequence[Record]) -> dict[str, list[dict[str, Any]]]:
    """A table of each kind of case, a row a log: of single effects those that were missed."""
    of = {kind: [r for r in records if r["kind"] == kind]
          for kind in ("single", "clean", "outside", "together", "twins")}  # fmt: skip
    rows = {
        "Every miss": [
            _short(r) | {"size over floor": r["over_floor"][0]}
            for r in of["single"]
            if points(r) < 1
        ],
        "False names on clean logs": [_short(r) for r in of["clean"] if named(r)],
        "Effects in no catalogue": [
            _short(r) | {"channel": channel_said(r), "right": _yes(right_channel(r))}
            for r in of["outside"]
        ],
        "Two effects at once": [
            _short(r) | {"both": _yes(set(truth(r)) <= set(named(r)))} for r in of["together"]
        ],
        "Twins of a robot that stands": [
            _short(r) | {"its twin": r["twin"], "right": _yes(tells_twins(r))} for r in of["twins"]
        ],
    }
    return {heading: table for heading, table in rows.items() if table}


def _short(record: Record) -> dict[str, Any]:
    row = _row(record)
    name = row["named"] if row["rivals"] == "-" else f"{row['named']} (rivals: {row['rivals']})"
    return {key: row[key] for key in ("put in", "robot", "verdict")} | {"named": name}


def _yes(right: bool) -> str:
    return "yes" if right else "no"


def _row(record: Record) -> dict[str, object]:
    def words(effects) -> str:
        return (
            ", ".join(f"{e['name']} {e['target']} {e['value']:.3g} {e['unit']}" for e in effects)
            or "-"
        )

    rivals = ", ".join(f"{r['name']} {r['target']}" for r in record.get("rivals") or ())
    over = [x for x in record.get("over_floor", ()) if x is not None]
    return {
        "case": record["number"], "kind": record["kind"], "robot": record["robot"],
        "seed": record["seed"], "put in": words(record["effects"]),
        "verdict": record.get("verdict", "fell"), "named": words(record.get("effects_found", ())),
        "rivals": rivals or "-", "size over floor": over[0] if over else None,
    }  # fmt: skip
