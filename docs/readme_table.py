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
FILTERS = ("coverage", "coverage_persistent", "velocity", "leg", "imu")
COLUMNS = ("APE_trans [m]", "APE_rot [deg]", "RPE_trans [m]", "NEES_pos", "step [us]")


def with_table(text: str, table: str, first: str = BEGIN, last: str = END) -> str:
    """A page with `table` between two markers. Raises SystemExit where they are missing."""
    before, begin, rest = text.partition(first)
    _, end, after = rest.partition(last)
    if not (begin and end):
        raise SystemExit(f"the page lacks the markers {first} and {last}")
    return f"{before}{begin}\n{table}\n{end}{after}"


def table_of(demo: Path) -> str:
    """Five filters of the demo's table, and what they were measured on."""
    try:
        found = pd.read_csv(demo / "table.csv").set_index("filter")
    except FileNotFoundError:
        raise SystemExit(f"{demo / 'table.csv'}: not there; run `make demo` first") from None
    rows = [
        {"filter": f"`{name}`"} | {column: float(found.at[name, column]) for column in COLUMNS}
        for name in FILTERS
    ]
    origin = origin_of("surefoot.scenarios.demo", "surefoot demo")
    made = f"`surefoot demo` on commit `{origin.commit}`, {origin.date}, {origin.machine}."
    return f"\n{to_markdown(rows, markup=True)}\n\n{made}\n"


if __name__ == "__main__":
    written = with_table(README.read_text(encoding="utf-8"), table_of(Path(sys.argv[1])))
    README.write_text(written, encoding="utf-8")
