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
from types import MappingProxyType

from surefoot.scenarios.reporting.html import Section, markdown_report, write_report
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
    tables: Mapping[str, Table] = MappingProxyType({}),
    force: bool = False,
) -> str:
    """Write a study's report.html and table.md, and the CSV of each section with a `file`; returns
    the text of table.md.

    Args:
        out: folder.
        title: of the report.
        sections: of the report.
        tables: further ones, by the name of their CSV.
        force: whether files may be replaced.
    """
    text = markdown_report(title, sections)
    filed = {s.file: s.table for s in sections if s.file and s.table is not None}
    contents = {"table.md": text} | {
        f"{n}.csv": to_csv(t) for n, t in (filed | dict(tables)).items()
    }
    for name, content in contents.items():
        write_whole(out / name, content, force)
    write_report(out / "report.html", title, sections, force)
    return text


def write_page(path: Path, title: str, sections: Sequence[Section], origin: Origin) -> None:
    """Write a page of results in Markdown; replaces an older one.

    Its first paragraph is the main finding, which the index of results repeats. Tables of sections
    with a `file` are CSV files in `tables_folder`, listed at the end; pictures are PNG files beside
    the page, which link to themselves in full size.

    Raises SurefootError if another file than a page of results has this path.
    """
    check_page(path)
    links = _write_tables(path, [(s, s.table) for s in sections if s.file and s.table is not None])
    parts, drawn = [f"# {title}"], 0
    for section in sections:
        shown = section if not section.file else Section(section.heading)
        if shown is section or section.pictures:
            parts += [f"## {section.heading}", shown.prose.strip()]
        if shown.table is not None:
            parts.append(to_markdown(shown.table))
        for picture in section.pictures:
            drawn += 1
            name = f"{path.stem}_{drawn}.png"
            with kept_file(path.with_name(name)) as temporary:
                temporary.write_bytes(png(picture.figure))
            parts += [f"[![{section.heading}]({name})]({name})", picture.caption]
    if links:
        parts += ["## Further tables", "\n".join(links)]
    parts += ["## Origin", "\n".join(["| | |", "| --- | --- |", *_header(origin)])]
    with kept_file(path) as temporary:
        temporary.write_text("\n\n".join(p for p in parts if p) + "\n", encoding="utf-8")


def _write_tables(page: Path, filed: Sequence[tuple[Section, Table]]) -> list[str]:
    """Write the table of each section as CSV; returns a line for each, with a link and the first
    paragraph of its prose.

    Raises SurefootError if a file has that name and there is no page yet.
    """
    files = [tables_folder(page) / f"{section.file}.csv" for section, _ in filed]
    if found := next((file for file in files if file.exists() and not page.exists()), None):
        raise SurefootError(f"page {page}: its table {found} is another file; move it away")
    lines = []
    for (section, table), file in zip(filed, files, strict=True):
        with kept_file(file) as temporary:
            temporary.write_text(to_csv(table), encoding="utf-8")
        address = Path(os.path.relpath(file, page.parent)).as_posix()
        words = section.prose.strip().partition("\n\n")[0]
        lines.append(f"- [{section.heading}]({address}){f': {words}' if words else ''}")
    return lines


def tables_folder(page: Path) -> Path:
    """Folder of a page's CSV files: docs/data/NAME for docs/results/NAME.md, and NAME beside a page
    in a folder of another name.
    """
    home = page.parent
    return (home.parent / "data" if home.name == "results" else home) / page.stem


def check_page(path: Path, outputs: Sequence[Path] = ()) -> None:
    """Raise SurefootError if the path is that of a file other than a page of results, or the folder
    of its tables is one of `outputs`.
    """
    refuse_input(path)
    if (folder := tables_folder(path).resolve()) in [one.resolve() for one in outputs]:
        raise SurefootError(f"page {path}: its tables would be in {folder}, which is the output")
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
    """The commit, with `-dirty` if files differ from it outside `docs`, where results are written;
    without a checkout, the version.
    """

    def git(*arguments: str) -> str:
        folder = Path(__file__).resolve().parent
        done = subprocess.run(["git", *arguments], cwd=folder, capture_output=True, text=True)
        return done.stdout.strip()

    commit = git("rev-parse", "--short=7", "HEAD")
    changed = git("status", "--porcelain", "--untracked-files=no", "--", ":/", ":(top,exclude)docs")
    return f"{commit}{'-dirty' if changed else ''}" if commit else version("surefoot")


def _processor() -> str:
    cpus = Path("/proc/cpuinfo")
    text = cpus.read_text(encoding="utf-8") if cpus.exists() else ""
    match = re.search(r"^model name\s*: (.*)$", text, re.MULTILINE)
    return match.group(1) if match else platform.processor() or platform.machine()
