"""Commands that run a grid: experiments of one's own, and the two suites."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from tyro.conf import Positional

from surefoot.scenarios.cli.options import Out
from surefoot.sim.common.files import bundled


@dataclass(frozen=True, kw_only=True)
class Grid:
    """What both commands take."""

    out: Out
    """Folder for tables, report and recordings."""
    workers: int = 1
    """Processes at once."""
    seeds: str | None = None
    """One seed, or a range such as 0:8; the file's where left out (three in a suite)."""
    cache: Path | None = None
    """Folder of what is made on the way, to go on from; `cache` in the output where left out."""
    recordings: bool = True
    """Write a rerun recording of each sequence."""
    force: bool = False
    """Write tables and report again; what is in the cache is not made again."""

    def make(self, file: Path) -> None:
        from surefoot.scenarios.experiments.report import experiment

        experiment(
            file, self.out, self.workers, self.seeds, self.cache, self.recordings, self.force
        )


@dataclass(frozen=True, kw_only=True)
class ExperimentCommand(Grid):
    """A grid over scenarios, robots, conditions, gamma, filters and seeds: one tidy table."""

    file: Positional[Path]
    """Experiment file (TOML)."""

    def run(self) -> None:
        self.make(self.file)


@dataclass(frozen=True, kw_only=True)
class Suite(Grid):
    """The paper's two tables on the simulated suites, from simulation to table."""

    name: Positional[Literal["spot", "vision60"]]

    def run(self) -> None:
        self.make(bundled("surefoot.scenarios.experiments", "suites") / f"{self.name}.toml")
