"""`python -m studies.walking`: how the robots walk."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import UseAppendAction, arg

from studies.command import OutputFolder, run_study
from studies.walking.study import report, walking_study


@dataclass(frozen=True)
class Walking:
    """Measure how robots walk: falls, tracking, slip, creep and speed on four grounds and courses.

    Without --robot and --course: every known robot, and the courses of both suites.
    """

    out: OutputFolder
    """Folder for walking.md and finished walks."""
    robot: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="NAME|FILE")] = ()
    """Name of a robot, or its file (MJCF or URDF); it walks on flat ground, a slope, a slippery
    patch and stairs.
    """
    course: Annotated[UseAppendAction[tuple[str, ...]], arg(metavar="NAME|FILE")] = ()
    """Scenario (TOML file or bundled name), walked by its own robot with every seed."""
    seeds: int = 5
    """Number of seeds of each course, from 0."""
    workers: int = 1
    """Number of walks at a time."""
    data: Path | None = None
    """Folder of finished walks, which later runs reuse; by default `walks` in the output."""
    page: Path | None = None
    """Page of results to write as well, such as docs/results/walking.md."""
    force: bool = False
    """Replace what an earlier run of this study wrote."""

    def run(self) -> None:
        walks = walking_study(
            self.out,
            self.robot,
            self.course,
            self.seeds,
            self.workers,
            self.data,
            self.page,
            self.force,
        )
        print(report(walks))
        print(f"table: {self.out / 'walking.md'}")


if __name__ == "__main__":
    run_study(Walking)
