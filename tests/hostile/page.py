"""Runs every hostile case and writes docs/results/hostile.md: `python tests/hostile/page.py`."""

import sys
from collections import defaultdict
from pathlib import Path
from tempfile import TemporaryDirectory

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent / "common")]

from forked import Outcome, copied, run_forked  # noqa: E402
from good_files import good_files  # noqa: E402
from test_refused import CASES  # noqa: E402

from surefoot.scenarios.reporting.html import Section  # noqa: E402
from surefoot.scenarios.reporting.pages import origin_of, write_page  # noqa: E402

PAGE = HERE.parents[1] / "docs" / "results" / "hostile.md"


def main() -> None:
    found: dict[str, list[tuple[str, Outcome]]] = defaultdict(list)
    with TemporaryDirectory() as work:
        good = good_files(Path(work) / "good")
        for what, change, command, _ in CASES:
            folder = copied(good, Path(work) / "case")
            change(folder)
            kind, _, case = what.partition(": ")
            found[kind].append((case, run_forked(command.split(), folder)))
    rows = [_row(kind, [one for _, one in outcomes]) for kind, outcomes in found.items()]
    rows.append(_row("all", [one for outcomes in found.values() for _, one in outcomes]))
    missed = [
        f"{kind}: {case}"
        for kind, outcomes in found.items()
        for case, one in outcomes
        if not one.refused
    ]
    origin = origin_of("surefoot.scenarios.cli.main", "python tests/hostile/page.py")
    write_page(PAGE, "Hostile input", [Section("Findings", _words(rows, missed), rows)], origin)


def _words(rows: list[dict[str, object]], missed: list[str]) -> str:
    cases, refused = (rows[-1][name] for name in ("cases", "refused"))
    return (
        f"{refused} of {cases} files and commands that must be refused are refused.\n\n"
        "Refused means: one line, no traceback, every file as it was. Seconds are of the "
        "processor." + (f"\n\nNot refused: {'; '.join(missed)}." if missed else "")
    )


def _row(kind: str, outcomes: list[Outcome]) -> dict[str, object]:
    return {
        "what": kind,
        "cases": len(outcomes),
        "refused": sum(one.refused for one in outcomes),
        "tracebacks": sum(one.traceback for one in outcomes),
        "longest [s]": max(one.seconds for one in outcomes),
    }


if __name__ == "__main__":
    main()
