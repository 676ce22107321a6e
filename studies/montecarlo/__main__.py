"""`python -m studies.montecarlo`: the paper's Monte-Carlo tables, with further regimes."""

from dataclasses import dataclass
from pathlib import Path

from studies.command import OutputFolder, run_study
from studies.montecarlo.report import montecarlo


@dataclass(frozen=True)
class Montecarlo:
    """Reproduce the paper's runtime-accuracy and consistency tables, with further regimes."""

    out: OutputFolder
    """Folder for the tables and report.html."""
    trials: int | None = None
    """Trials in each regime, at least two; by default those of montecarlo.toml."""
    seed: int | None = None
    """Seed of the trials; by default that of montecarlo.toml."""
    workers: int | None = None
    """Number of parallel processes on this machine; by default one for each core."""
    cluster: str | None = None
    """Address of a Dask scheduler that runs the work, such as tcp://127.0.0.1:8786."""
    data: Path | None = None
    """Folder of finished regimes, which later runs reuse; by default `cases` in the output."""
    page: Path | None = None
    """Page of results to write as well, such as docs/results/montecarlo.md."""
    force: bool = False
    """Replace what an earlier run of this study wrote."""

    def run(self) -> None:
        text = montecarlo(
            self.out,
            self.trials,
            self.seed,
            self.force,
            self.workers,
            self.cluster,
            self.data,
            self.page,
        )
        print(text)
        print(f"report: {self.out / 'report.html'}")


if __name__ == "__main__":
    run_study(Montecarlo)
