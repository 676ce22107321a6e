"""Tries the mutants of `plan.toml`, or goes on with them, and writes docs/results/mutants.md:
`make mutants`, or `python tests/mutation/run.py`.

Each finished mutant is a row under docs/data/mutants. It lapses when the code of the mutated module
changes, or of a test that decided it: of a mutant that was killed the file of the test that did it,
of one that survived all files whose tests are looked at. Rows that lapsed are made again before new
ones.

Tests are written for survivors, so that the share that is killed now says nothing of other mutants.
What it was when each was first tried (`first` of its row) does, with the interval of a share in a
sample: of the first mutants of the draw, in its order and without a gap.
"""

import ast
import hashlib
import json
import sys
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from fnmatch import fnmatch
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
sys.path[:0] = [str(HERE), str(HERE.parent / "common")]
import pandas as pd  # noqa: E402
import tyro  # noqa: E402
from mutate import Mutant, drawn, read_plan  # noqa: E402
from scipy.stats import binomtest  # noqa: E402
from trial import Outcome, Workplace, dotted  # noqa: E402

from surefoot.scenarios.reporting.html import Section  # noqa: E402
from surefoot.scenarios.reporting.pages import origin_of, write_page  # noqa: E402
from surefoot.sim.common.files import cache_folder, kept_file  # noqa: E402
from surefoot.sim.common.toml import read_typed  # noqa: E402

EQUIVALENT = HERE / "equivalent.toml"
DATA = ROOT / "docs" / "data" / "mutants"
PAGE = ROOT / "docs" / "results" / "mutants.md"
KILLED = ("killed", "timeout")
KINDS = ("killed", "survived", "uncovered", "equivalent")
WARM = (
    "matplotlib.pyplot",
    "mujoco",
    "pandas",
    "pyarrow.parquet",
    "scipy.optimize",
    "scipy.signal",
    "scipy.stats",
    "torch",
)
"""What children find imported, for it takes longer than most tests."""


@dataclass(frozen=True)
class Reason:
    """Why no test can tell a mutant from the code; change is for those who read the file."""

    change: str
    reason: str


@dataclass(frozen=True)
class Mutants:
    """Try the mutants that are not finished, and write the page."""

    at_most: int | None = None
    """Mutants to try in this sitting; 0 for the page alone."""
    only: str = "*"
    """Files to mutate, such as 'estimator/*'."""
    survivors: bool = False
    """Try those again that survived, whatever has changed."""

    def run(self) -> None:
        for name in WARM:
            import_module(name)
        place = Workplace(ROOT, cache_folder() / "mutants", read_plan())
        rows = run_mutants(place, DATA, self.at_most, self.only, self.survivors)
        print(write_mutants_page(PAGE, place.plan.mutants, rows, first_outcomes(place, DATA)))


def run_mutants(
    place: Workplace,
    data: Path,
    at_most: int | None = None,
    only: str = "*",
    survivors: bool = False,
) -> list[dict[str, Any]]:
    """The rows of the finished mutants, after at most so many more were tried.

    Args:
        place: the checkout, and its plan.
        data: folder of the rows.
        at_most: mutants to try; None for all.
        only: pattern of the files to mutate.
        survivors: whether those that survived are tried again, whatever has changed.
    """
    place.refresh()
    every = drawn(place.plan, place.root)
    rows = {mutant.key: read_row(data, mutant, place) for mutant in every}
    todo = [
        (kept_row(data, mutant) is None, number, mutant)
        for number, mutant in enumerate(every, 1)
        if fnmatch(mutant.file, only)
        and ((row := rows[mutant.key]) is None or (survivors and row["outcome"] not in KILLED))
    ]
    for _, number, mutant in sorted(todo, key=lambda one: one[:2])[:at_most]:
        row = write_row(data, mutant, place, place.try_mutant(mutant))
        rows[mutant.key] = row
        print(f"{number}/{len(every)} {shown(row)}", flush=True)
    return [row for row in rows.values() if row is not None]


def first_outcomes(place: Workplace, data: Path) -> list[str]:
    """What became of the first mutants of the draw when they were first tried, until the first that
    was not."""
    found = []
    for mutant in drawn(place.plan, place.root):
        row = kept_row(data, mutant)
        if row is None:
            break
        found.append(row.get("first", row["outcome"]))
    return found


def shown(row: Mapping[str, Any]) -> str:
    """A row as a line: what became of which change."""
    change = f"{row['file']}:{row['line']} [{row['key']}] {row['before']} -> {row['after']}"
    return f"{row['outcome']} {change} ({row['by'] or row['tests']}, {row['seconds']} s)"


def write_row(folder: Path, mutant: Mutant, place: Workplace, outcome: Outcome) -> dict[str, Any]:
    """The row of a finished mutant, kept in a file by its key."""
    before, after = mutant.lines((place.root / mutant.file).read_bytes())
    kept = kept_row(folder, mutant) or {}
    row = {
        "key": mutant.key,
        "file": mutant.file,
        "line": mutant.line,
        "scope": mutant.scope,
        "kind": mutant.kind,
        "before": before,
        "after": after,
        "first": kept.get("first", kept.get("outcome", outcome.outcome)),
        **asdict(outcome),
        "files": list(outcome.files),
    }
    values = {"digest": _digest(mutant, place, row), "row": row}
    with kept_file(folder / f"{mutant.key}.json") as temporary:
        temporary.write_text(json.dumps(values, indent=1) + "\n", encoding="utf-8")
    return row


def read_row(folder: Path, mutant: Mutant, place: Workplace) -> dict[str, Any] | None:
    """The row of a mutant, None where it is not finished or has lapsed."""
    row = kept_row(folder, mutant)
    return row if row is not None and row.pop("digest") == _digest(mutant, place, row) else None


def kept_row(folder: Path, mutant: Mutant) -> dict[str, Any] | None:
    """The row of a mutant with its digest, lapsed or not; None where it was never tried."""
    try:
        values = json.loads((folder / f"{mutant.key}.json").read_text(encoding="utf-8"))
        return values["row"] | {"digest": values["digest"]}
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _digest(mutant: Mutant, place: Workplace, row: Mapping[str, Any]) -> str:
    """SHA-256 of the mutated module and of the tests that decided the row, by their code."""
    if row["outcome"] in KILLED:
        tests: Iterable[Path] = (place.root / file for file in row["files"])
    else:
        tests = place.nearest_tests(dotted(mutant.file))
    digest = hashlib.sha256(_code((place.root / mutant.file).read_bytes()))
    for path in tests:
        digest.update(
            path.relative_to(place.root).as_posix().encode() + b"\0" + _code(path.read_bytes())
        )
    return digest.hexdigest()


@cache
def _code(source: bytes) -> bytes:
    """The syntax tree of a source without its docstrings."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            node.body = [one for one in body if not _is_text(one)]  # type: ignore[attr-defined]
    return ast.dump(tree).encode()


def _is_text(node: ast.stmt) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)


def write_mutants_page(
    page: Path, drawn_in_all: int, rows: list[dict[str, Any]], first: list[str]
) -> str:
    """Write the page and return its first words; first as of `first_outcomes`."""
    reasons = read_typed(EQUIVALENT, dict[str, Reason], "equivalent mutants")
    columns = ["key", "file", "line", "kind", "before", "after", "outcome", "tests", "seconds"]
    table = pd.DataFrame(rows, columns=columns).sort_values(["file", "line"])
    timeouts = (table["outcome"] == "timeout").sum()
    table["folder"] = [str(Path(file).parent) for file in table["file"]]
    table["fate"] = table["outcome"].replace("timeout", "killed")
    table.loc[table["key"].isin(list(reasons)) & (table["fate"] != "killed"), "fate"] = KINDS[-1]
    table["line"] = table["file"] + ":" + table["line"].astype(str)
    table["why"] = [reasons[key].reason if key in reasons else "" for key in table["key"]]
    of = {kind: table.loc[table["fate"] == kind] for kind in KINDS}
    killed, survived, uncovered, equivalent = (len(one) for one in of.values())
    seconds = table["seconds"].sum()
    words = (
        f"{killed} of the {killed + survived + uncovered} mutants that are not equivalent to the "
        f"code are killed ({_share(killed, survived + uncovered)} %).\n\n"
        f"{len(rows)} of the {drawn_in_all} mutants that were drawn are finished; "
        f"{timeouts} are killed by the time they took, {survived} survived, of {uncovered} no test "
        f"that imports the module is quick enough, and {equivalent} are equivalent. "
        f"{_first_words(first)} A mutant takes {seconds / max(len(rows), 1):.1f} s of the "
        f"processor, all take {seconds / 60:.0f} min."
    )
    how = (
        "A mutant is one change of a line: a sign, a constant by a tenth or by one, a comparison, "
        "two swapped arguments, a statement left out. `tests/mutation/plan.toml` says which files "
        "and holds the seed. The quickest tests of the files that import the module and least else "
        "are run, until one fails."
    )
    change = ["key", "line", "before", "after"]
    sections = [
        Section("Findings", words, _counts(table, "folder")),
        Section("Method", how),
        Section("By kind of change", "", _counts(table, "kind"), file="kinds"),
        Section("By file", "", _counts(table, "file"), file="files"),
    ]
    for title, text, kind, shown_columns in (
        ("Survivors", "What no test notices.", "survived", [*change, "tests"]),
        ("Without a test", "Changes that no quick test is near.", "uncovered", change),
        ("Equivalent", "Changes that no test can notice, and why.", "equivalent", [*change, "why"]),
    ):
        found = of[kind].loc[:, shown_columns].to_dict(orient="records")
        sections.append(Section(title, text, found or None, file=title.lower().replace(" ", "_")))
    write_page(page, "Mutants", sections, origin_of("surefoot.scenarios.cli.main", "make mutants"))
    return words


def _first_words(first: list[str]) -> str:
    """The share killed at the first trial, and how far that of all mutants may be from it."""
    if not first:
        return "The first mutant of the draw was not tried yet."
    killed = sum(outcome in KILLED for outcome in first)
    low, high = binomtest(killed, len(first)).proportion_ci()
    return (
        "Tests are written for those that survive, so that this share holds for no others. Of the "
        f"first {len(first)} of the draw {100 * killed / len(first):.1f} % were killed when they "
        f"were first tried, in 95 % of samples {100 * low:.1f} to {100 * high:.1f} % of all."
    )


def _counts(table: pd.DataFrame, by: str) -> list[dict[str, Any]]:
    """A row for each file, kind or folder."""
    rows = []
    for name, fates in table.groupby(by)["fate"]:
        found = Counter(fates)
        counts = {kind: found[kind] for kind in KINDS}
        share = _share(counts["killed"], counts["survived"] + counts["uncovered"])
        rows.append({by: name, "mutants": len(fates), **counts, "killed [%]": share})
    return rows


def _share(killed: int, survived: int) -> str:
    return f"{100 * killed / (killed + survived):.1f}" if killed + survived else "-"


if __name__ == "__main__":
    tyro.cli(Mutants).run()
