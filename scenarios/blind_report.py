"""The report of the blind study: its rules, its confusion matrix, and tables by effect and size."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from scenarios.blind_score import Record, by_effect, by_size, named, points, rules, truth
from scenarios.palette import INK
from scenarios.plotting import new_figure, set_title
from scenarios.report import Picture, Section, write_report
from scenarios.tables import to_csv, to_markdown
from sim.effects import CATALOGUE
from sim.files import whole_file

OTHER = ("nothing", "another target", "confounded")


def write_report_of(out: Path, records: Sequence[Record]) -> str:
    """Write report.html, table.md and cases.csv; returns the tables as text."""
    tables = {
        "What was asked, and what was measured": rules(records),
        "By effect": by_effect(records),
        "By size over the least that the log could show": by_size(records),
    }
    picture = Picture(
        confusion(records),
        "Rows: the effect that was put in, one of each log. Columns: the effect that trace named "
        "first. On the diagonal the target (joint, leg or axis) is right too, and the verdict is "
        "not confounded.",
    )
    parts = [
        Section(heading, table=rows, pictures=(picture,) if heading == "By effect" else ())
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


def confusion(records: Sequence[Record]) -> Figure:
    """Which effect was put in against which was named first, as counts."""
    names = list(CATALOGUE)
    columns = [*names, *OTHER]
    counts = np.zeros((len(names), len(columns)))
    for r in records:
        if r["kind"] != "single" or "fell" in r:
            continue
        name = truth(r)[0][0]
        first = named(r)[0][0] if named(r) else "nothing"
        if first == name and points(r) < 1.0:
            first = "confounded" if r["verdict"] == "confounded" else "another target"
        counts[names.index(name), columns.index(first)] += 1
    figure, axes = new_figure(size=(9.5, 8.5))
    ax = axes[0, 0]
    ax.imshow(counts, cmap="Blues", vmin=0, vmax=max(1.0, counts.max()), aspect="auto")
    for i, j in zip(*np.nonzero(counts), strict=True):
        dark = counts[i, j] > 0.6 * counts.max()
        ax.text(
            j, i, f"{counts[i, j]:.0f}", ha="center", va="center", fontsize=7,
            color="white" if dark else INK,
        )  # fmt: skip
    ax.set_xticks(range(len(columns)), [c.replace("_", " ") for c in columns], rotation=90)
    ax.set_yticks(range(len(names)), [n.replace("_", " ") for n in names])
    ax.tick_params(labelsize=7)
    ax.grid(False)
    ax.axvline(len(names) - 0.5, color=INK, linewidth=0.8)
    ax.set_xlabel("named first")
    ax.set_ylabel("put in")
    set_title(ax, "What trace takes each undeclared effect for")
    return figure


def _row(record: Record) -> dict[str, object]:
    def words(effects) -> str:
        return ", ".join(f"{e['name']} {e['target']} {e['value']:.4g}" for e in effects) or "-"

    rivals = ", ".join(f"{r['name']} {r['target']}" for r in record.get("rivals") or ())
    over = [x for x in record.get("over_floor", ()) if x is not None]
    return {
        "case": record["number"], "kind": record["kind"], "robot": record["robot"],
        "seed": record["seed"], "put in": words(record["effects"]),
        "verdict": record.get("verdict", "fell"), "named": words(record.get("effects_found", ())),
        "rivals": rivals or "-", "size over floor": over[0] if over else None,
    }  # fmt: skip
