"""Write the README's table between its markers, from the output of `surefoot demo`.

`python docs/readme_table.py out/demo` (or `make readme`, which runs the demo first).
"""

import sys
from pathlib import Path

import pandas as pd

from surefoot.scenarios.reporting.pages import origin_of
from surefoot.scenarios.reporting.tables import to_markdown

README = Path(__file__).resolve().parent.parent / "README.md"
BEGIN, END = "<!-- table of the demo: made by `make readme` -->", "<!-- end of the table -->"
ROWS = {
    ("walk", "leg"): "`leg`",
    ("walk", "leg_slip"): "`leg_slip`",
    ("walk", "coverage_gml"): "`coverage_gml`",
    ("walk", "coverage_persistent"): "`coverage_persistent`",
    ("known", "leg_slip"): "`leg_slip`, known",
}
"""Log and filter of each row -> its first column."""
COLUMNS = ("APE_trans [m]", "APE_rot [deg]", "RPE_trans [m]", "NEES_pos", "step [us]")


def with_table(text: str, table: str, first: str = BEGIN, last: str = END) -> str:
    """A page with `table` between two markers. Raises SystemExit where they are missing."""
    before, begin, rest = text.partition(first)
    _, end, after = rest.partition(last)
    if not (begin and end):
        raise SystemExit(f"the page lacks the markers {first} and {last}")
    return f"{before}{begin}\n{table}\n{end}{after}"


def table_of(demo: Path) -> str:
    """Some rows of the demo's table, and what they were measured on."""
    try:
        found = pd.read_csv(demo / "table.csv").set_index(["log", "filter"])
    except FileNotFoundError:
        raise SystemExit(f"{demo / 'table.csv'}: not there; run `make demo` first") from None
    rows = [
        {"filter": name} | {column: float(found.at[row, column]) for column in COLUMNS}
        for row, name in ROWS.items()
    ]
    origin = origin_of("surefoot.scenarios.demo", "surefoot demo")
    made = f"`surefoot demo` on commit `{origin.commit}`, {origin.date}, {origin.machine}."
    return f"\n{to_markdown(rows, markup=True)}\n\n{made}\n"


if __name__ == "__main__":
    written = with_table(README.read_text(encoding="utf-8"), table_of(Path(sys.argv[1])))
    README.write_text(written, encoding="utf-8")
