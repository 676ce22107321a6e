"""Walks that are drawn at random, simulated in parallel, and kept in the cache.

A walk that ends in a fall is drawn again. Finished walks are read from the cache by whoever draws
them again, such as an interrupted run.
"""

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

from surefoot.scenarios.cache import product
from surefoot.sim.common.files import cache_folder
from surefoot.sim.common.sources import code_digest
from surefoot.sim.effects import Effect
from surefoot.sim.gait.options import pattern_named
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario
from surefoot.sim.walk import Fallen, walk
from surefoot.sim.walking.batch import on_threads

Report = Callable[[float], None]


@dataclass(frozen=True)
class DrawnWalk:
    """A walk to simulate, whose effects its log does not declare."""

    scenario: Scenario
    robot: Robot
    seed: int
    effects: Sequence[Effect] = ()

    @property
    def inputs(self) -> dict[str, Any]:
        """All that determines it, besides the code of the simulation."""
        return {
            "scenario": repr(self.scenario),
            "gait": asdict(pattern_named(self.scenario.gait.pattern)),
            "robot": [self.robot.name, self.robot.digest, self.robot.q_home.tolist()],
            "seed": self.seed,
            "effects": [one.as_dict() for one in self.effects],
            "code": code_digest(*map(type, self.effects)),
        }


Draw = Callable[[int, int], DrawnWalk]
"""Walk of a number, drawn again in each further attempt: (number, attempt) -> walk."""


@dataclass(frozen=True)
class KeptLogs:
    """Logs on disk, which are read one at a time as they are used, and named by their number."""

    paths: Mapping[int, Path]
    name: str

    def __len__(self) -> int:
        return len(self.paths)

    def __iter__(self) -> Iterator[Log]:
        for number, path in self.paths.items():
            yield replace(Log.read(path), name=f"{self.name}_{number}")

    def first(self, count: int) -> "KeptLogs":
        """The first `count` of them."""
        return KeptLogs(dict(islice(self.paths.items(), count)), self.name)


def kept_walks(
    draw: Draw,
    count: int,
    attempts: int,
    name: str,
    progress: Report | None = None,
    workers: int = 0,
) -> KeptLogs:
    """Logs of so many walks, without those that fell in every attempt.

    Args:
        draw: of each walk.
        count: of walks, numbered from 0.
        attempts: draws of a walk before it is left out.
        name: of the logs, before their number.
        progress: called with the share done.
        workers: threads, by default one for each core.
    """
    work, cores = partial(_kept_walk, draw, attempts), os.cpu_count() or 1
    made = dict(on_threads(range(count), work, workers or cores, progress))
    return KeptLogs({k: path for k in range(count) if (path := made[k])}, name)


def _kept_walk(draw: Draw, attempts: int, number: int, report: Report) -> tuple[int, Path | None]:
    for attempt in range(attempts):
        drawn = draw(number, attempt)
        make = partial(_simulated, drawn, report)
        folder = cache_folder() / "training"
        made = product(folder, "walk", drawn.inputs, "surefoot.sim.walk", ".parquet", make)
        if not made.facts["fell"]:
            return number, made.path
    return number, None


def _simulated(drawn: DrawnWalk, report: Report, path: Path) -> dict[str, Any]:
    """Write the log of a walk; if the robot fell, a text that says so."""
    try:
        log = walk(drawn.scenario, drawn.robot, drawn.seed, drawn.effects, False, report)
    except Fallen as fall:
        path.write_text(f"{fall}\n", encoding="utf-8")
        return {"fell": str(fall)}
    log.write(path, force=True)
    return {"fell": ""}
