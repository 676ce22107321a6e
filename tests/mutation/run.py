"""Tries the mutants of `plan.toml`, or goes on with them, and writes docs/results/mutants.md:
`make mutants`, or `python tests/mutation/run.py`.

Each finished mutant is a row under docs/data/mutants. It lapses when the mutated module changes, or
a test that decided it: of a mutant that was killed the file of the test that did it, of one that
survived all files whose tests are looked at.
"""

import hashlib
import json
import sys
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from fnmatch import fnmatch
from importlib import import_module
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
sys.path[:0] = [str(HERE), str(HERE.parent / "common")]
import tyro  # noqa: E402
from mutate import Mutant  # noqa: E402
from plan import PLAN, drawn, read_plan  # noqa: E402
from trial import Outcome, Workplace, dotted  # noqa: E402

from surefoot.scenarios.reporting.html import Section  # noqa: E402
from surefoot.scenarios.studies.pages import origin_of, write_page  # noqa: E402
from surefoot.sim.common.files import cache_folder, kept_file  # noqa: E402
from surefoot.sim.common.toml import read_typed  # noqa: E402

EQUIVALENT = HERE / "equivalent.toml"
DATA = ROOT / "docs" / "data" / "mutants"
PAGE = ROOT / "docs" / "results" / "mutants.md"
KILLED = ("killed", "timeout")
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
    data: Path = DATA
    """Folder of the finished rows."""
    page: Path = PAGE
    """Page of results."""
    plan: Path = PLAN

    def run(self) -> None:
        for name in WARM:
            import_module(name)
        place = Workplace(ROOT, cache_folder() / "mutants", read_plan(self.plan))
        rows = run_mutants(place, self.data, self.at_most, self.only, self.survivors)
        print(write_mutants_page(self.page, place.plan.mutants, rows))


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
    rows = []
    tried = 0
    for number, mutant in enumerate(every, 1):
        row = read_row(data, mutant, place)
        again = survivors and row is not None and row["outcome"] not in KILLED
        allowed = (at_most is None or tried < at_most) and fnmatch(mutant.file, only)
        if (row is None or again) and allowed:
            tried += 1
            row = write_row(data, mutant, place, place.try_mutant(mutant))
            print(f"{number}/{len(every)} {shown(row)}", flush=True)
        if row is not None:
            rows.append(row)
    return rows


def shown(row: Mapping[str, Any]) -> str:
    """A row as a line: what became of which change."""
    change = f"{row['file']}:{row['line']} [{row['key']}] {row['before']} -> {row['after']}"
    return f"{row['outcome']} {change} ({row['by'] or row['tests']}, {row['seconds']} s)"


def write_row(folder: Path, mutant: Mutant, place: Workplace, outcome: Outcome) -> dict[str, Any]:
    """The row of a finished mutant, kept in a file by its key."""
    before, after = mutant.lines((place.root / mutant.file).read_bytes())
    row = {
        "key": mutant.key,
        "file": mutant.file,
        "line": mutant.line,
        "scope": mutant.scope,
        "kind": mutant.kind,
        "before": before,
        "after": after,
        **asdict(outcome),
        "files": list(outcome.files),
    }
    values = {"digest": _digest(mutant, place, row), "row": row}
    with kept_file(folder / f"{mutant.key}.json") as temporary:
        temporary.write_text(json.dumps(values, indent=1) + "\n", encoding="utf-8")
    return row


def read_row(folder: Path, mutant: Mutant, place: Workplace) -> dict[str, Any] | None:
    """The row of a mutant, None where it is not finished or has lapsed."""
    try:
        values = json.loads((folder / f"{mutant.key}.json").read_text(encoding="utf-8"))
        return values["row"] if values["digest"] == _digest(mutant, place, values["row"]) else None
    except (OSError, ValueError, KeyError):
        return None


def _digest(mutant: Mutant, place: Workplace, row: Mapping[str, Any]) -> str:
    """SHA-256 of the mutated module and of the tests that decided the row."""
    if row["outcome"] in KILLED:
        tests: Iterable[Path] = (place.root / file for file in row["files"])
    else:
        tests = place.nearest_tests(dotted(mutant.file))[: place.plan.nearest]
    digest = hashlib.sha256((place.root / mutant.file).read_bytes())
    for path in tests:
        digest.update(path.relative_to(place.root).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


def write_mutants_page(page: Path, drawn_in_all: int, rows: list[dict[str, Any]]) -> str:
    """Write the page and return its first words."""
    reasons = read_typed(EQUIVALENT, dict[str, Reason], "equivalent mutants")
    equivalent = [r for r in rows if r["outcome"] not in KILLED and r["key"] in reasons]
    left = [r for r in rows if r["outcome"] not in KILLED and r["key"] not in reasons]
    killed = len(rows) - len(equivalent) - len(left)
    seconds = sum(row["seconds"] for row in rows)
    words = (
        f"{len(rows)} of the {drawn_in_all} mutants that were drawn are finished: {killed} killed, "
        f"{sum(row['outcome'] == 'timeout' for row in rows)} of them by the time they took, "
        f"{len(left)} survived, {len(equivalent)} are equivalent to the code. "
        f"Killed of those that are not equivalent: {_share(killed, len(left))} %. "
        f"{seconds / max(len(rows), 1):.1f} s of the processor a mutant, {seconds / 60:.0f} min in "
        "all."
    )
    how = (
        "A mutant is one change of a line: a sign, a constant by a tenth or by one, a comparison, "
        "two swapped arguments, a statement left out. `tests/mutation/plan.toml` says which files "
        "and holds the seed. The tests that call the changed function are run, of the files of "
        "tests that import the module and least else, until one fails."
    )
    sections = [
        Section("Share killed", f"{words}\n\n{how}", _counts(rows, reasons, "room")),
        Section("By kind of change", "", _counts(rows, reasons, "kind")),
        Section("By file", "", _counts(rows, reasons, "file")),
        Section(
            "Survivors",
            "What no test notices." if left else "None.",
            [
                {**_change(row), "tests": row["tests"]}
                for row in sorted(left, key=lambda row: (row["file"], row["line"]))
            ]
            or None,
        ),
        Section(
            "Equivalent",
            "Changes that no test can notice, and why." if equivalent else "None.",
            [{**_change(row), "why": reasons[row["key"]].reason} for row in equivalent] or None,
        ),
    ]
    origin = origin_of("surefoot.scenarios.cli.main", "make mutants")
    write_page(page, "Mutants", sections, origin)
    return words


def _change(row: Mapping[str, Any]) -> dict[str, Any]:
    place = f"{row['file']}:{row['line']}"
    code = {name: f"`{row[name]}`".replace("|", "\\|") for name in ("before", "after")}
    return {"key": row["key"], "line": place, **code}


def _counts(
    rows: list[dict[str, Any]], reasons: Mapping[str, Reason], by: str
) -> list[dict[str, Any]]:
    """A row for each file, kind or room."""
    counts: dict[str, Counter[str]] = {}
    for row in rows:
        name = str(Path(row["file"]).parent) if by == "room" else row[by]
        outcome = "killed" if row["outcome"] in KILLED else "survived"
        if outcome == "survived" and row["key"] in reasons:
            outcome = "equivalent"
        counts.setdefault(name, Counter())[outcome] += 1
    return [
        {
            by: name,
            "mutants": one.total(),
            "killed": one["killed"],
            "survived": one["survived"],
            "equivalent": one["equivalent"],
            "killed [%]": _share(one["killed"], one["survived"]),
        }
        for name, one in sorted(counts.items())
    ]


def _share(killed: int, survived: int) -> str:
    return f"{100 * killed / (killed + survived):.1f}" if killed + survived else "-"


if __name__ == "__main__":
    tyro.cli(Mutants).run()
