"""Cases of a study that are kept one by one, so that a stopped study resumes."""

from collections.abc import Callable, Hashable, Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Protocol, TypeVar

from surefoot.scenarios.reporting import finished_case, processes, read_case, stage


class Numbered(Protocol):
    """A case, which has a number of its own."""

    @property
    def number(self) -> int: ...


Numbers = TypeVar("Numbers", bound=Numbered)
Row = dict[str, Any]


def run_cases(
    cases: Iterable[Numbers],
    folder: Path,
    module: str,
    inputs: Callable[[Numbers], Row],
    run: Callable[[Numbers], Row],
    group: Callable[[Numbers], Hashable],
    workers: int = 1,
    at_most: int | None = None,
) -> list[Row]:
    """Run up to `at_most` unfinished cases; returns the rows of all finished ones.

    Args:
        cases: of the study.
        folder: with a file for each finished case.
        module: whose code makes the rows.
        inputs: all that decides a case's row.
        run: the row of a case.
        group: cases of the same one are run by one worker, since they share what it keeps.
        workers: processes.
        at_most: number of cases to run now; by default all.
    """
    groups: dict[Hashable, list[Numbers]] = {}
    rows: dict[int, Row] = {}
    left = float("inf") if at_most is None else at_most
    for case in cases:
        row = read_case(folder, _name(case), inputs(case), module)
        if row is not None:
            rows[case.number] = row
        elif left > 0:
            left -= 1
            groups.setdefault(group(case), []).append(case)
    with processes(workers) as pool:
        jobs = {key: (_run, own, folder, module, inputs, run) for key, own in groups.items()}
        for made in stage(pool, "study", jobs).values():
            rows |= made
    return [rows[number] for number in sorted(rows)]


def _run(
    group: Sequence[Numbers],
    folder: Path,
    module: str,
    inputs: Callable[[Numbers], Row],
    run: Callable[[Numbers], Row],
) -> dict[int, Row]:
    return {
        case.number: finished_case(folder, _name(case), inputs(case), module, partial(run, case))
        for case in group
    }


def _name(case: Numbered) -> str:
    return f"{case.number:03d}"
