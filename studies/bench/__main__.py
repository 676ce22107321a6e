"""`python -m studies.bench`: run times relative to peers."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import UseAppendAction, arg

from studies.bench.run import ROWS, bench
from studies.command import run_study


@dataclass(frozen=True)
class Bench:
    """Measure run times, each as a ratio to a reference timed in the same run."""

    rounds: int = 12
    """Number of repetitions of each pair, alternating; the shortest time counts."""
    only: Annotated[
        UseAppendAction[tuple[str, ...]],
        arg(metavar="ITEM", help=f"One of {', '.join(ROWS)}; by default all."),
    ] = ()
    page: Path | None = None
    """Page of results to write as well, such as docs/results/bench.md."""

    def run(self) -> None:
        print(bench(self.rounds, self.only, self.page))


if __name__ == "__main__":
    run_study(Bench)
