"""The blind study of `trace`: logs with one undeclared effect each, and the effects that it names.

`study.toml` says what is drawn. Each finished case is a row, so that a study that was stopped goes
on where it was; `python -m surefoot.scenarios.studies.blind.study -o DIR` runs it and reports.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from surefoot.models.attribution.diagnose import Diagnosis, diagnose
from surefoot.models.attribution.evidence import candidates_code
from surefoot.models.attribution.settings import DEFAULT
from surefoot.scenarios.cache import finished_case, read_case
from surefoot.scenarios.cli.options import Out
from surefoot.scenarios.stages import processes, stage
from surefoot.scenarios.studies.blind.plan import PLAN, Case, cases, study_robot
from surefoot.scenarios.studies.blind.report import write_report_of
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.toml import read_toml
from surefoot.sim.effects import Effect
from surefoot.sim.ground.terrain import Ground, Patch
from surefoot.sim.log import Log
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.walk import walk

_MODULE = "surefoot.scenarios.studies.blind.study"
STAND = 20.0
"""s that a robot stands whose log has an effect that standing does not distinguish from another."""


@lru_cache(maxsize=8)
def ground_and_course(seed: int, standing: bool, plan: Path = PLAN) -> Scenario:
    """The walk of a seed: some stretches, and patches of little friction on the way."""
    w = read_toml(plan, "study")["walk"]
    if standing:
        # A last step or two, since a walk without any is none; `standing_part` cuts them off.
        return Scenario("stand", (Segment(0.5),), Ground(0.8), stand=STAND)
    rng = np.random.default_rng([seed, 7])
    segments = tuple(
        Segment(
            duration=rng.uniform(*w["duration"]),
            forward=rng.uniform(*w["forward"]),
            lateral=rng.choice([0.0, 0.08, -0.08]),
            turn=rng.choice([0.0, -1.0, 1.0]) * rng.uniform(*w["turn"]),
        )
        for _ in range(w["stretches"])
    )
    places = rng.uniform(-3.0, 6.0, (w["patches"], 2))
    patches = tuple(Patch(x, y, 1.0, 1.0, rng.uniform(0.15, 0.3)) for x, y in places)
    return Scenario("study", segments, Ground(rng.uniform(*w["mu"]), patches))


def run_case(case: Case, plan: Path = PLAN) -> dict[str, Any]:
    """Walk and trace one case of a plan: what was put in, and the verdict, effects and channels
    found."""
    record: dict[str, Any] = {
        "number": case.number,
        "kind": case.kind,
        "robot": case.robot,
        "seed": case.seed,
        "effects": [e.as_dict() for e in case.effects],
        "twin": case.twin,
    }
    robot = study_robot(case.robot)
    scenario = ground_and_course(case.seed, case.standing, plan)
    try:
        log = walk(scenario, robot, case.seed, case.effects, declared=False)
    except SurefootError as fell:
        return record | {"fell": str(fell)}
    if case.standing:
        log = standing_part(log)
    found = diagnose([log], robot)
    result = found.as_dict()
    record |= {key: result.get(key) for key in ("verdict", "rivals", "remainder", "channels")}
    record["effects_found"] = result["effects"]
    record["over_floor"] = [over_floor(found, one) for one in case.effects]
    return record


def standing_part(log: Log) -> Log:
    """The log up to its first step: a few samples of stepping would distinguish the twins."""
    still = log.t - log.t[0] < STAND - 0.5
    return replace(log, frame=log.frame[still])


def over_floor(found: Diagnosis, one: Effect) -> float | None:
    """An effect's size over the least that this log could show of it; None where unknown.

    Of friction that is the share that may be lost before feet slide. Zero for an effect that is no
    candidate and leaves no channel above its noise floor.
    """
    if one.name == "foot_slip" and found.friction is not None:
        return one.value / max(1.0 - found.friction.held / DEFAULT.floor_friction, 1e-3)
    rounds = found.attribution.rounds if found.attribution else ()
    for c in rounds[0] if rounds else ():
        if c.key == (one.name, one.target):
            least = 4.0 * float(np.hypot(c.floor, c.error))
            return abs(one.value) / least if np.isfinite(least) and least > 0 else 0.0
    shown = any(not replace(c, after=c.before).at_floor for c in found.channels.values())
    return None if shown else 0.0


def run_blind_study(
    folder: Path, workers: int = 1, at_most: int | None = None, plan: Path = PLAN
) -> list[dict[str, Any]]:
    """The records of the finished cases of a plan, after at most so many more were run.

    Each finished case is a file of `folder`, so that a study that was stopped goes on. A walk's
    cases are run by one worker, for they share its noise floor.
    """
    drawn = read_toml(plan, "study")
    groups: dict[tuple, list[Case]] = {}
    records: dict[int, dict[str, Any]] = {}
    left = float("inf") if at_most is None else at_most
    for case in cases(drawn):
        row = read_case(folder, _name(case), _inputs(case, drawn), _MODULE)
        if row is not None:
            records[case.number] = row
        elif left > 0:
            left -= 1
            # Groups of a few turns: a study that is stopped early has seen as much of each effect.
            key = case.number // 80, case.robot, case.seed
            groups.setdefault(key, []).append(case)
    with processes(workers) as pool:
        jobs = {key: (_run_group, group, folder, plan) for key, group in groups.items()}
        for rows in stage(pool, "study", jobs).values():
            records |= rows
    return [records[number] for number in sorted(records)]


def _run_group(group: Sequence[Case], folder: Path, plan: Path) -> dict[int, dict[str, Any]]:
    drawn = read_toml(plan, "study")
    return {
        case.number: finished_case(
            folder,
            _name(case),
            _inputs(case, drawn),
            _MODULE,
            lambda case=case: run_case(case, plan),
        )
        for case in group
    }


def _name(case: Case) -> str:
    return f"{case.number:03d}"


def _inputs(case: Case, plan: dict[str, Any]) -> dict[str, Any]:
    effects = [e.as_dict() for e in case.effects]
    drawn = {"kind": case.kind, "robot": case.robot, "seed": case.seed, "effects": effects}
    known = {"candidates": candidates_code(), "model": study_robot(case.robot).digest}
    return drawn | known | {"standing": case.standing, "walk": plan["walk"]}


@dataclass(frozen=True)
class BlindStudy:
    """Run the blind study of trace, or go on with it, and write its report."""

    out: Out = Path("out/blind_study")
    """Folder of the report."""
    data: Path | None = None
    """Folder of finished cases; `cases` in the output where left out."""
    workers: int = 2
    at_most: int | None = None
    """Cases to run in this sitting, of those that are not finished; 0 for the report alone."""
    page: Path | None = None
    """Page of results to write as well, such as docs/results/blind.md."""
    plan: Path = PLAN
    """Other draws, courses and robots than the study's: `pilot.toml` is for development."""

    def run(self) -> None:
        folder = self.data or self.out / "cases"
        records = run_blind_study(folder, self.workers, self.at_most, self.plan)
        print(write_report_of(self.out, records, self.page, self.plan))


if __name__ == "__main__":
    tyro.cli(BlindStudy).run()
