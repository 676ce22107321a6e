"""Which pages of results are stale.

`python docs/result_pages.py docs/results` lists the pages with the commit that each was measured
on. A page is stale if its code has changed since then, or is unknown.
"""

import sys
from pathlib import Path

from surefoot.scenarios.reporting.pages import read_origin
from surefoot.scenarios.reporting.tables import to_markdown


def pages_table(folder: Path) -> list[dict[str, str]]:
    """One row for each page of a folder: the commit it was measured on, and whether it is stale."""
    rows = []
    for path in sorted(folder.glob("*.md")):
        one = read_origin(path)
        if one.commit:
            state = "stale" if one.stale else "current"
            rows.append({"page": path.name, "commit": one.commit, "date": one.date, "state": state})
    return rows


if __name__ == "__main__":
    print(to_markdown(pages_table(Path(sys.argv[1]))))
