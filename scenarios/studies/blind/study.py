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
from surefoot.scenarios.cache import finished_case, read_case
from surefoot.scenarios.cli.options import Out
from surefoot.scenarios.stages import processes, stage
from surefoot.scenarios.studies.blind.outside_effects import OUTSIDE_EFFECTS
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.files import bundled
from surefoot.sim.common.toml import read_toml
from surefoot.sim.effects import CATALOGUE, Effect, effect
from surefoot.sim.ground.terrain import Ground, Patch
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot
from surefoot.sim.robot.limbs import QUADRUPED
from surefoot.sim.scenario import Scenario, Segment
from surefoot.sim.walk import walk
from surefoot.sim.walking.batch import known_robot

PLAN = bundled("surefoot.scenarios.studies.blind", "study.toml")
ROBOTS = bundled("surefoot.scenarios.studies.blind", "robots")
_MODULE = "surefoot.scenarios.studies.blind.study"
STAND = 20.0
"""s that a robot stands whose log has an effect that standing does not distinguish from another."""


@dataclass(frozen=True)
class Case:
    """One log: what kind of case, on which walk, with which undeclared effects."""

    number: int
    kind: str  # single, clean, outside, together, twins
    robot: str
    seed: int
    effects: tuple[Effect, ...] = ()
    twin: str = ""
    standing: bool = False


def cases(plan: dict[str, Any]) -> list[Case]:
    """Every case of a plan, drawn from its seed."""
    rng = np.random.default_rng(plan["seed"])
    walks = [(r, s) for s in plan["walk"]["seeds"] for r in plan["walk"]["robots"]]
    known = [name for name in CATALOGUE if name in plan["sizes"]]
    found: list[Case] = []

    def add(kind: str, effects: Sequence[Effect] = (), **more) -> None:
        robot, seed = walks[len(found) % len(walks)]
        found.append(Case(len(found), kind, robot, seed, tuple(effects), **more))

    # Turn by turn, so that a study that is stopped early has seen as much of each.
    for turn in range(plan["each"]):
        for name in known:
            add("single", [_drawn(name, plan["sizes"][name], rng, turn in plan["group_turns"])])
        for _ in range(_share(plan["clean"], turn, plan["each"])):
            add("clean")
        for k in range(_share(plan["outside"] * len(OUTSIDE_EFFECTS), turn, plan["each"])):
            name = list(OUTSIDE_EFFECTS)[(turn + k) % len(OUTSIDE_EFFECTS)]
            add("outside", [_drawn(name, plan["outside_sizes"][name], rng)])
        for _ in range(_share(plan["together"], turn, plan["each"])):
            first, second = rng.choice(known, 2, replace=False)
            add("together", [_drawn(n, plan["sizes"][n], rng) for n in (first, second)])
        for k in range(_share(plan["confounded"], turn, plan["each"])):
            pair = plan["twins"][(turn + k) % len(plan["twins"])]
            name, target = pair["of"][0].split()
            one = effect(name, target, np.exp(rng.uniform(*np.log(pair["size"]))))
            add("twins", [one], twin=pair["of"][1], standing=True)
    return found


def _share(count: int, turn: int, turns: int) -> int:
    """How many of `count` fall to this turn."""
    return count * (turn + 1) // turns - count * turn // turns


def _drawn(
    name: str, size: Sequence[float], rng: np.random.Generator, of_group: bool = False
) -> Effect:
    """An effect of a drawn size, sign and target; on a group of parts, where it has any, if asked.

    Args:
        name: of the effect.
        size: the ends of its range.
        rng: draws.
        of_group: whether the target is a group.
    """
    kind = CATALOGUE[name] if name in CATALOGUE else OUTSIDE_EFFECTS[name]
    value = float(np.exp(rng.uniform(*np.log(size))))
    sign = rng.choice([-1.0, 1.0])
    several = tuple(kind.group_targets(QUADRUPED)) if of_group else ()
    target = str(rng.choice(several or kind.single_targets(QUADRUPED)))
    # No delay is negative.
    both = kind.bounds[0] < 0 and not name.endswith("_delay")
    return kind(target, sign * value if both else value)


@lru_cache(maxsize=8)
def ground_and_course(seed: int, standing: bool) -> Scenario:
    """The walk of a seed: some stretches, and patches of little friction on the way."""
    w = read_toml(PLAN, "study")["walk"]
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


def study_robot(name: str) -> Robot:
    """A robot of the study alone, or a known one."""
    own = ROBOTS / f"{name}.xml"
    return known_robot(str(own) if own.is_file() else name)


def run_case(case: Case) -> dict[str, Any]:
    """Walk and trace one case: what was put in, and the verdict, effects and channels found."""
    record: dict[str, Any] = {
        "number": case.number,
        "kind": case.kind,
        "robot": case.robot,
        "seed": case.seed,
        "effects": [e.as_dict() for e in case.effects],
        "twin": case.twin,
    }
    robot = study_robot(case.robot)
    scenario = ground_and_course(case.seed, case.standing)
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

    Zero for an effect that is no candidate and leaves no channel above its noise floor.
    """
    rounds = found.attribution.rounds if found.attribution else ()
    for c in rounds[0] if rounds else ():
        if c.key == (one.name, one.target):
            least = 4.0 * float(np.hypot(c.floor, c.error))
            return abs(one.value) / least if np.isfinite(least) and least > 0 else 0.0
    shown = any(not replace(c, after=c.before).at_floor for c in found.channels.values())
    return None if shown else 0.0


def run_blind_study(
    folder: Path, workers: int = 1, at_most: int | None = None
) -> list[dict[str, Any]]:
    """The records of the finished cases of the plan, after at most so many more were run.

    Each finished case is a file of `folder`, so that a study that was stopped goes on. A walk's
    cases are run by one worker, for they share its noise floor.
    """
    plan = read_toml(PLAN, "study")
    groups: dict[tuple, list[Case]] = {}
    records: dict[int, dict[str, Any]] = {}
    left = float("inf") if at_most is None else at_most
    for case in cases(plan):
        row = read_case(folder, _name(case), _inputs(case, plan), _MODULE)
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


def _run_group(group: Sequence[Case], folder: Path, plan: dict) -> dict[int, dict[str, Any]]:
    return {
        case.number: finished_case(
            folder, _name(case), _inputs(case, plan), _MODULE, lambda case=case: run_case(case)
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

    def run(self) -> None:
        from surefoot.scenarios.studies.blind.report import write_report_of

        records = run_blind_study(self.data or self.out / "cases", self.workers, self.at_most)
        print(write_report_of(self.out, records, self.page))


if __name__ == "__main__":
    tyro.cli(BlindStudy).run()
