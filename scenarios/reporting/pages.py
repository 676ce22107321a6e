"""Pages of results. The command that measures writes them; each names the code that made it."""

import os
import platform
import re
import subprocess
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import date
from importlib.metadata import version
from pathlib import Path

from surefoot.scenarios.reporting.html import Section, heading, markdown_report, write_report
from surefoot.scenarios.reporting.plotting import png
from surefoot.scenarios.reporting.tables import Table, to_csv, to_markdown
from surefoot.sim.common.errors import SurefootError
from surefoot.sim.common.files import kept_file, refuse_input, write_whole
from surefoot.sim.common.sources import sources_digest


@dataclass(frozen=True)
class Origin:
    """Origin of a page; empty fields are unknown.

    `module` made the page; `digest` is that of its source and of all that it imports.
    """

    commit: str = ""
    machine: str = ""
    date: str = ""
    command: str = ""
    module: str = ""
    digest: str = ""

    @property
    def stale(self) -> bool:
        """Whether the code that made the page is unknown, or has changed since."""
        return not self.digest or self.digest != sources_digest(self.module)


def origin_of(module: str, command: str) -> Origin:
    """The origin of a page that this process makes with `module` (a dotted name) and `command`."""
    machine = f"{_processor()}, {os.cpu_count()} cores"
    return Origin(
        _commit(), machine, date.today().isoformat(), command, module, sources_digest(module)
    )


def write_results(
    out: Path,
    title: str,
    sections: Sequence[Section],
    tables: Mapping[str, Table],
    force: bool = False,
) -> str:
    """Write a study's report.html and table.md, and one CSV per table; returns the text of
    table.md.

    Args:
        out: folder.
        title: of the report.
        sections: of the report.
        tables: by the name of their CSV.
        force: whether files may be replaced.
    """
    text = markdown_report(title, sections)
    contents = {"table.md": text} | {f"{name}.csv": to_csv(t) for name, t in tables.items()}
    for name, content in contents.items():
        write_whole(out / name, content, force)
    write_report(out / "report.html", title, sections, force)
    return text


def write_page(path: Path, title: str, sections: Sequence[Section], origin: Origin) -> None:
    """Write a page of results in Markdown, with its pictures next to it as PNG; replaces an older
    one.

    Raises SurefootError if another file than a page of results has this path.
    """
    check_page(path)
    parts = [f"# {title}", "\n".join(["| | |", "| --- | --- |", *_header(origin)])]
    for number, section in enumerate(sections, 1):
        parts += [heading(section), section.prose.strip()]
        if section.table is not None:
            parts.append(to_markdown(section.table))
        for place, picture in enumerate(section.pictures, 1):
            name = f"{path.stem}_{number}_{place}.png"
            with kept_file(path.with_name(name)) as temporary:
                temporary.write_bytes(png(picture.figure))
            parts += [f"![{section.heading}]({name})", picture.caption]
    with kept_file(path) as temporary:
        temporary.write_text("\n\n".join(p for p in parts if p) + "\n", encoding="utf-8")


def check_page(path: Path) -> None:
    """Raise SurefootError if the path is that of a file other than a page of results."""
    refuse_input(path)
    if path.exists() and read_origin(path) == Origin():
        raise SurefootError(f"page {path}: is no page of results; move it away")


def read_origin(path: Path) -> Origin:
    """Read the header of a page of results; all fields are empty if it has none."""
    text = path.read_text(encoding="utf-8", errors="replace")
    found = {
        name: match.group(1)
        for name in asdict(Origin())
        if (match := re.search(rf"^\| {name} \| (.*) \|$", text, re.MULTILINE))
    }
    return Origin(**{name: value.strip("`") for name, value in found.items()})


def _header(origin: Origin) -> list[str]:
    coded = {"commit", "command", "module", "digest"}
    return [
        f"| {name} | {f'`{value}`' if name in coded else value} |"
        for name, value in asdict(origin).items()
        if value
    ]


def _commit() -> str:
    """The commit, with `-dirty` if files differ from it; without a checkout, the version."""
    here = Path(__file__).resolve().parent
    described = subprocess.run(
        ["git", "describe", "--always", "--dirty", "--abbrev=7", "--exclude=*"],
        cwd=here,
        capture_output=True,
        text=True,
    )
    return described.stdout.strip() or version("surefoot")


def _processor() -> str:
    cpus = Path("/proc/cpuinfo")
    text = cpus.read_text(encoding="utf-8") if cpus.exists() else ""
    match = re.search(r"^model name\s*: (.*)$", text, re.MULTILINE)
    return match.group(1) if match else platform.processor() or platform.machine()
