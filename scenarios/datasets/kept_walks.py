"""Simulated walks that are kept in a cache, where an interrupted run finds them again.

Those that are drawn at random are simulated in parallel, and one that ends in a fall is drawn
again.
"""

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from surefoot.scenarios.cache import Product, product
from surefoot.scenarios.datasets.index import FACTS, determinants, walk_facts
from surefoot.sim.common.files import cache_folder
from surefoot.sim.effects import Effect
from surefoot.sim.log import Log
from surefoot.sim.robot import Robot
from surefoot.sim.scenario import Scenario
from surefoot.sim.walk import Fallen, walk
from surefoot.sim.walking.batch import on_threads

Report = Callable[[float], None]


@dataclass(frozen=True)
class DrawnWalk:
    """A walk to simulate; its log lists its effects if they are `declared`."""

    scenario: Scenario
    robot: Robot
    seed: int
    effects: Sequence[Effect] = ()
    declared: bool = False

    @property
    def inputs(self) -> dict[str, Any]:
        """All that determines its log."""
        parts = self.scenario, self.robot, self.seed, self.effects
        return {**determinants(*parts), "declared": self.declared}

    def simulated(self, progress: Report | None = None) -> Log:
        """Its log. Raises Fallen if the robot falls."""
        parts = self.scenario, self.robot, self.seed, self.effects
        return walk(*parts, self.declared, progress)


Draw = Callable[[int, int], DrawnWalk]
"""Walk of a number, drawn again in each further attempt: (number, attempt) -> walk."""


@dataclass(frozen=True)
class KeptLogs:
    """Logs on disk, which are read one at a time as they are used, and named by their number.

    Attributes:
        paths: by number.
        name: of all logs, before their number.
        seen_as: what is made of each log as it is read; by default nothing.
    """

    paths: Mapping[int, Path]
    name: str
    seen_as: Callable[[Log], Log] | None = None

    def __len__(self) -> int:
        return len(self.paths)

    def __iter__(self) -> Iterator[Log]:
        for number, path in self.paths.items():
            log = replace(Log.read(path), name=f"{self.name}_{number}")
            yield self.seen_as(log) if self.seen_as else log

    def first(self, count: int) -> "KeptLogs":
        """The first `count` of them."""
        return replace(self, paths=dict(islice(self.paths.items(), count)))


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
    folder, workers = cache_folder() / "training", workers or os.cpu_count() or 1

    def standing(number: int, report: Report) -> tuple[int, Product | None]:
        return number, standing_walk(folder, draw, attempts, number, report)

    made = dict(on_threads(range(count), standing, workers, progress))
    return KeptLogs({k: one.path for k in range(count) if (one := made[k])}, name)


def standing_walk(
    folder: Path, draw: Draw, attempts: int, number: int, report: Report | None = None
) -> Product | None:
    """The log of walk `number`, drawn again where the robot falls; None if it falls each time.

    Args:
        folder: of the cache.
        draw: of each attempt.
        attempts: draws of the walk.
        number: of the walk.
        report: called with the share done of an attempt.
    """
    for attempt in range(attempts):
        made = kept_walk(folder, draw(number, attempt), report)
        if not made.facts["falls"]:
            return made
    return None


def kept_walk(folder: Path, drawn: DrawnWalk, report: Report | None = None) -> Product:
    """The log of a walk, with its facts (`walk_facts`); if the robot fell, a text that says so.

    Args:
        folder: of the cache.
        drawn: the walk.
        report: called with the share done.
    """

    def make(path: Path) -> dict[str, Any]:
        try:
            log = drawn.simulated(report)
        except Fallen as fall:
            path.write_text(f"{fall}\n", encoding="utf-8")
            return dict.fromkeys(FACTS, np.nan) | {"falls": 1, "fell_at": fall.time}
        log.write(path, force=True)
        return walk_facts([log]) | {"falls": 0, "fell_at": np.nan}

    return product(folder, "walk", drawn.inputs, "surefoot.sim.walk", ".parquet", make)
