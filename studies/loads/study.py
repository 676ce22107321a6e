"""The study of loads tied to links of arms and of walking robots, and of machines on fixed bases.

`loads.toml` is the plan. Finished cases are stored, so that an interrupted study is resumed. Run
it, and write its report, by `python -m studies.loads -o DIR`.
"""

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from studies.cases import run_cases
from studies.command import OutputFolder
from studies.loads.plan import PLAN, LoadCase, draw_load_cases, machine_of
from studies.loads.report import write_page_of
from studies.loads.trial import run_load_case
from surefoot.extend import read_toml
from surefoot.models.attribution.evidence import candidates_digest
from surefoot.scenarios.reporting import file_digest

_MODULE = "studies.loads.trial"


def run_loads_study(
    folder: Path, workers: int = 1, at_most: int | None = None
) -> list[dict[str, Any]]:
    """Run up to `at_most` unfinished cases; returns the records of all finished ones.

    Cases of one individual are run by one worker, since they share its calibration.
    """
    plan = read_toml(PLAN, "study")
    kept = draw_load_cases(plan), folder, _MODULE, partial(_inputs, plan=plan), run_load_case
    return run_cases(*kept, _individual, workers, at_most)


def _individual(case: LoadCase) -> tuple[str, int | None, int]:
    return case.machine, case.individual, case.number if case.individual is None else -1


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
