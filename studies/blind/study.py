"""The blind study of `trace`: logs with undeclared effects, and the effects that it finds.

`study.toml` is the plan. Finished cases are stored, so that an interrupted study is resumed. Run
it, and write its report, by `python -m studies.blind -o DIR`.
"""

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from studies.blind.plan import PLAN, Case, draw_cases, study_robot
from studies.blind.report import write_report_of
from studies.blind.trial import run_case
from studies.cases import run_cases
from studies.command import OutputFolder
from surefoot.extend import read_toml
from surefoot.models.attribution.evidence import candidates_digest

_MODULE = "studies.blind.trial"


def run_blind_study(
    folder: Path, workers: int = 1, at_most: int | None = None, plan: Path = PLAN
) -> list[dict[str, Any]]:
    """Run up to `at_most` unfinished cases of a plan; returns the records of all finished ones.

    Cases of the same walk are run by one worker, since they share its noise floor.
    """
    drawn = read_toml(plan, "study")
    inputs, run = partial(_inputs, plan=drawn), partial(run_case, plan=plan)
    kept = draw_cases(drawn), folder, _MODULE, inputs, run
    return run_cases(*kept, _walk_of, workers, at_most)


def _walk_of(case: Case) -> tuple[int, str, int]:
    # Small groups, so that a study stopped early has covered all effects alike.
    return case.number // 80, case.robot, case.seed


def _inputs(case: Case, plan: dict[str, Any]) -> dict[str, Any]:
    effects = [e.as_dict() for e in case.effects]
    drawn = {"kind": case.kind, "robot": case.robot, "seed": case.seed, "effects": effects}
    known = {"candidates": candidates_digest(), "model": study_robot(case.robot).digest}
    ground = {"standing": case.standing, "ground": case.ground, "rough": plan.get("rough")}
    return drawn | known | ground | {"walk": plan["walk"]}


@dataclass(frozen=True)
class BlindStudy:
    """Run or resume the blind study of trace, and write its report."""

    out: OutputFolder = Path("out/blind_study")
    """Folder of the report."""
    data: Path | None = None
    """Folder of finished cases; by default `cases` in the output folder."""
    workers: int = 2
    at_most: int | None = None
    """Number of unfinished cases to run now; 0 for the report alone."""
    page: Path | None = None
    """Page of results to write too, such as docs/results/blind.md."""
    plan: Path = PLAN
    """Another plan: `beyond.toml` has other grounds and larger effects, `pilot.toml` is for
    development.
    """

    def run(self) -> None:
        folder = self.data or self.out / "cases"
        records = run_blind_study(folder, self.workers, self.at_most, self.plan)
        print(write_report_of(self.out, records, self.page, self.plan))
