"""The study of loads tied to links of arms and of walking robots, and of machines on fixed bases.

`loads.toml` is the plan. Finished cases are stored, so that an interrupted study is resumed. Run
it, and write its report, by `python -m studies.loads -o DIR`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from studies.command import OutputFolder
from studies.loads.plan import PLAN, LoadCase, draw_load_cases, machine_of
from studies.loads.report import write_page_of
from studies.loads.trial import run_load_case
from surefoot.extend import read_toml
from surefoot.models.attribution.evidence import candidates_digest
from surefoot.scenarios.reporting import file_digest, finished_case, processes, read_case, stage

_MODULE = "studies.loads.trial"


def run_loads_study(
    folder: Path, workers: int = 1, at_most: int | None = None
) -> list[dict[str, Any]]:
    """Run up to `at_most` unfinished cases; returns the records of all finished ones.

    Cases of one individual are run by one worker, since they share its calibration.
    """
    plan = read_toml(PLAN, "study")
    groups: dict[tuple, list[LoadCase]] = {}
    records: dict[int, dict[str, Any]] = {}
    left = float("inf") if at_most is None else at_most
    for case in draw_load_cases(plan):
        row = read_case(folder, _name(case), _inputs(case, plan), _MODULE)
        if row is not None:
            records[case.number] = row
        elif left > 0:
            left -= 1
            alone = case.number if case.individual is None else -1
            groups.setdefault((case.machine, case.individual, alone), []).append(case)
    with processes(workers) as pool:
        jobs = {key: (_run_group, group, folder) for key, group in groups.items()}
        for rows in stage(pool, "study", jobs).values():
            records |= rows
    return [records[number] for number in sorted(records)]


def _run_group(group: Sequence[LoadCase], folder: Path) -> dict[int, dict[str, Any]]:
    plan = read_toml(PLAN, "study")
    return {
        case.number: finished_case(
            folder, _name(case), _inputs(case, plan), _MODULE, lambda case=case: run_load_case(case)
        )
        for case in group
    }


def _name(case: LoadCase) -> str:
    return f"{case.number:03d}"


def _inputs(case: LoadCase, plan: dict[str, Any]) -> dict[str, Any]:
    effects = [one.as_dict() for one in case.effects]
    drawn = {"kind": case.kind, "machine": case.machine, "individual": case.individual}
    known = {"candidates": candidates_digest(), "model": file_digest(machine_of(case.machine).file)}
    return drawn | known | {"effects": effects, "plan": plan}


@dataclass(frozen=True)
class LoadsStudy:
    """Run or resume the study of loads and fixed bases, and write its report."""

    out: OutputFolder = Path("out/loads")
    """Folder of the report."""
    data: Path | None = None
    """Folder of finished cases; by default `cases` in the output folder."""
    workers: int = 2
    at_most: int | None = None
    """Number of unfinished cases to run now; 0 for the report alone."""
    page: Path | None = None
    """Page of results to write too, such as docs/results/loads.md."""

    def run(self) -> None:
        records = run_loads_study(self.data or self.out / "cases", self.workers, self.at_most)
        print(write_page_of(self.out, records, self.page))
