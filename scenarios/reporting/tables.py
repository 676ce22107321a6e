"""Tables as Markdown, CSV and HTML, with the same numbers in each."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from html import escape
from numbers import Integral, Real
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from surefoot.sim.common.terminal import printable

if TYPE_CHECKING:
    from surefoot.estimator.metrics import Metrics

Table = pd.DataFrame | Sequence[Mapping]
METRICS = {
    "APE_trans [m]": "ape_trans",
    "APE_rot [deg]": "ape_rot",
    "RPE_trans [m]": "rpe_trans",
    "RPE_rot [deg/m]": "rpe_rot",
    "pi<gamma [%]": "pi_below_gamma",
    "NEES_pos": "nees_position",
    "NEES_vel": "nees_velocity",
    "NEES_att": "nees_attitude",
}
"""Columns of every table of errors, and the fields of `estimator.metrics.Metrics` they show."""

LOST_FROM = "not to be trusted from [s]"
WIDTH = 100
"""Largest width of a table on a terminal, in characters."""
LEAST_NEEDED = (
    "shared [s]",
    "APE_SE(3) [m]",
    "att in 95 % [%]",
    "vel in 95 % [%]",
    "RMSE_vel [m/s]",
    "RPE_rot [deg/m]",
    "NEES_vel",
    "pi<gamma [%]",
    "step [us]",
    "coverage [%]",
    LOST_FROM,
    "NEES_att",
    "RPE_trans [m]",
)
"""Columns that a table omits where it is too wide, the first one first."""


def metrics_row(metrics: Metrics) -> dict[str, float]:
    """The columns of one trajectory's metrics."""
    return {column: getattr(metrics, field) for column, field in METRICS.items()}


def as_frame(table: Table) -> pd.DataFrame:
    """A data frame, or a list of rows (column -> value), as a data frame without its index."""
    if isinstance(table, pd.DataFrame):
        return table.reset_index(drop=True)
    return pd.DataFrame(list(table))


def cell(value: object, digits: int = 3) -> str:
    """Format a value for a reader: with `digits` decimals, fewer for large numbers, a dash for
    none.
    """
    if value is None or value is pd.NA or (isinstance(value, float) and value != value):
        return "–"
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if isinstance(value, Integral) or not isinstance(value, Real):
        return str(value)
    number = float(value)
    if number != 0.0 and abs(number) < 0.5 * 10**-digits:
        return f"{number:.1e}"
    if abs(number) >= 1e6:
        return f"{number:.3g}"
    return f"{number:.{digits if abs(number) < 1000 else 0}f}"


def to_markdown(table: Table, digits: int = 3, markup: bool = False) -> str:
    """A Markdown table with right-aligned numbers, padded so that the source is readable too.

    markup: whether cells are Markdown; otherwise it shows them as they are.
    """
    frame = as_frame(table)
    text = _pipe if markup else in_markdown
    header = [text(str(name)) for name in frame.columns]
    rows = [[text(cell(v, digits)) for v in row] for row in frame.itertuples(index=False)]
    widths = [max(3, *(len(r[k]) for r in [header, *rows])) for k in range(len(header))]
    right = _numeric(frame)
    rule = [("-" * (w - 1) + ":") if r else "-" * w for w, r in zip(widths, right, strict=True)]

    def line(cells: Sequence[str]) -> str:
        padded = [
            c.rjust(w) if r else c.ljust(w) for c, w, r in zip(cells, widths, right, strict=True)
        ]
        return "| " + " | ".join(padded) + " |"

    return "\n".join([line(header), "|" + "|".join(f" {r} " for r in rule) + "|", *map(line, rows)])


def in_terminal(table: Table, wide: bool = False) -> str:
    """The table without empty columns and, where it is wider than WIDTH, without LEAST_NEEDED.

    wide: whether to keep all columns.
    """
    frame = as_frame(table).dropna(axis=1, how="all")
    text = to_markdown(frame)
    for name in LEAST_NEEDED:
        if wide or text.index("\n") <= WIDTH:
            break
        frame = frame.drop(columns=name, errors="ignore")
        text = to_markdown(frame)
    return text


def to_csv(table: Table) -> str:
    """Comma-separated values at full precision, with a header and empty cells for missing values.

    Texts that a spreadsheet would execute begin with an apostrophe.
    """
    frame = as_frame(table).rename(columns=_spreadsheet_text)
    for name in frame.select_dtypes(exclude="number"):
        frame[name] = pd.Series(map(_spreadsheet_text, frame[name]), dtype=object)
    return frame.to_csv(index=False, lineterminator="\n")


def to_html(table: Table) -> str:
    """An HTML table with every header and cell escaped; numeric columns have the class "number".

    A cell that is bold in Markdown (**so**) is bold here too.
    """
    frame = as_frame(table)
    classes = [' class="number"' if numeric else "" for numeric in _numeric(frame)]
    header = [f"<th{c}>{escape(str(n))}</th>" for n, c in zip(frame.columns, classes, strict=True)]
    rows = [
        [f"<td{c}>{_strong(cell(v))}</td>" for v, c in zip(row, classes, strict=True)]
        for row in frame.itertuples(index=False)
    ]
    body = "\n".join(f"<tr>{''.join(row)}</tr>" for row in rows)
    return (
        f"<table>\n<thead><tr>{''.join(header)}</tr></thead>\n<tbody>\n{body}\n</tbody>\n</table>"
    )


def _numeric(frame: pd.DataFrame) -> list[bool]:
    return [
        all(map(_is_number, column.dropna())) and column.notna().any()
        for _, column in frame.items()
    ]


def _is_number(value: object) -> bool:
    """Whether a value is a number, possibly as text with additions: "0.12 ± 0.03", "80.1 (75–86)",
    "**0.1**", "0.2 → 0.1".
    """
    if isinstance(value, str):
        one = r"[-+]?[\d.]+(e[-+]?\d+)?"
        number = rf"(\*\*)?{one}( ± {one})?( \([\d.–-]+\))?( → {one})?(\*\*)?"
        return re.fullmatch(number, value) is not None
    return isinstance(value, Real) and not isinstance(value, bool)


def _strong(text: str) -> str:
    if len(text) > 4 and text.startswith("**") and text.endswith("**"):
        return f"<strong>{escape(text[2:-2])}</strong>"
    return escape(text)


def in_markdown(text: str) -> str:
    """A text of one line for Markdown, which shows it as it is, but for stars."""
    return _pipe(without_tags(re.sub(r"[\\`]", r"\\\g<0>", text)))


def _pipe(text: str) -> str:
    return printable(text.replace("\n", " ")).replace("|", "\\|")


def without_tags(text: str) -> str:
    """A text of Markdown without tags of HTML, addresses and links; `pi<gamma` is none of these."""
    tag = r"(?<!\w)<(?=[A-Za-z/!?])|<(?=[A-Za-z/!?][^<]*>)"
    return re.sub(tag, "&lt;", text).replace("](", "]\\(")


def _spreadsheet_text(value: object) -> object:
    """A cell of CSV, in which a text that is no number is no formula of a spreadsheet either."""
    if not isinstance(value, str) or _is_number(value):
        return value
    text = printable(value, "\n\t")
    formula = text.startswith(tuple("=+-@\t")) and not re.fullmatch(r"[-+.\d]+ to [-+.\d]+", text)
    return f"'{text}" if formula else text
