"""Studies of real machines: `make study-hardware`.

They read public recordings from a folder. A study without its recording is skipped with a message.
The tables and figure of a finished study are stored until its recording or its code changes.
"""

import sys
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from studies.command import OutputFolder
from studies.hardware.machines import MACHINES, Folders
from studies.hardware.report import machine_report
from studies.measured import measured_folder
from surefoot.extend import SurefootError
from surefoot.scenarios.reporting import (
    file_digest,
    finished_case,
    origin_of,
    refuse_overwrite,
    save_figure,
    write_page,
    write_results,
)

MEASURED = measured_folder()
_MODULE = "studies.hardware.machines"


@dataclass(frozen=True)
class HardwareStudy:
    """Effects that the models of real machines lack: a report and a page for each machine."""

    out: OutputFolder
    """Folder that gets a folder for each machine."""
    measured: Path = MEASURED
    """Folder that has a folder of recordings for each machine."""
    only: tuple[str, ...] = ()
    """Machines to run; by default all."""
    data: Path | None = None
    """Folder of finished studies, which are not run again; by default `cases` in the output folder.
    """
    pages: Path | None = None
    """Folder of the pages of results to write too, such as docs/results."""
    force: bool = False

    def run(self) -> None:
        run_hardware(self)


def run_hardware(options: HardwareStudy) -> list[str]:
    """Run the studies whose recordings are available; returns their names.

    Raises SurefootError if a report exists (without `force`), or for an unknown name.
    """
    for name in options.only:
        if name not in MACHINES:
            raise SurefootError(f"--only {name}: unknown; choose {' | '.join(MACHINES)}")
    data = options.data or options.out / "cases"
    done = []
    for name in options.only or tuple(MACHINES):
        folder, out = options.measured / name, options.out / name
        if not folder.is_dir():
            print(f"{name}: skipped, its recording is not in {options.measured}", file=sys.stderr)
            continue
        refuse_overwrite(out / "report.html", options.force)
        files = sorted(path for path in folder.rglob("*") if path.is_file())
        inputs = {str(path.relative_to(folder)): file_digest(path) for path in files}
        picture = data / f"{name}.png"
        if not picture.exists():
            (data / f"{name}.json").unlink(missing_ok=True)
        make = partial(_row, name, Folders(folder, out / "traces", data / f"{name}_cases"), picture)
        row = finished_case(data, name, inputs, _MODULE, make)
        title, sections = machine_report(name, row, picture.read_bytes())
        write_results(out, title, sections, force=True)
        if options.pages:
            origin = origin_of(_MODULE, "make study-hardware")
            write_page(options.pages / f"hardware_{name}.md", title, sections, origin)
        done.append(name)
    return done


def _row(name: str, folders: Folders, picture: Path) -> dict[str, Any]:
    """The stored row of a study; its figure is written to `picture`."""
    found = MACHINES[name](folders)
    save_figure(found.figure, picture, force=True)
    tables = {table: rows.to_dict("records") for table, rows in found.tables.items()}
    return {"verdict": found.verdict, "tables": tables}
