"""A report as one self-contained HTML file, with style and pictures inside."""

from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

from matplotlib.figure import Figure

from surefoot.scenarios.reporting.plotting import png, save_figure
from surefoot.scenarios.reporting.tables import (
    Table,
    in_markdown,
    to_html,
    to_markdown,
    without_tags,
)
from surefoot.sim.common.files import bundled, write_whole

_STYLE = bundled("surefoot.scenarios.reporting", "report.css")


@dataclass(frozen=True)
class Picture:
    """A figure (or the bytes of a PNG), its caption, and the path, relative to the report, of a PNG
    to save besides; "" for none.
    """

    figure: Figure | bytes
    caption: str
    file: str = ""


@dataclass(frozen=True)
class Step:
    """Something to do, in words, and the command that does it; "" for none."""

    words: str
    command: str = ""


@dataclass(frozen=True)
class Section:
    """A part of a report. `prose` is plain text; an empty line starts a new paragraph. `steps`
    are numbered. One that is `folded` shows its heading until it is opened. `file` names the CSV
    that has the table where a page of results links to it instead of showing it.
    """

    heading: str
    prose: str = ""
    table: Table | None = None
    pictures: tuple[Picture, ...] = ()
    steps: tuple[Step, ...] = ()
    folded: bool = False
    file: str = ""


def write_report(
    path: str | Path, title: str, sections: Sequence[Section], force: bool = False
) -> None:
    """Write the sections as a self-contained HTML page, and their pictures that have a file; all
    text is escaped.

    Raises SurefootError where a file exists and `force` is not given, or cannot be written.
    """
    write_whole(path, html_report(title, sections), force)
    for picture in (picture for section in sections for picture in section.pictures):
        if picture.file:
            save_figure(picture.figure, Path(path).parent / picture.file, force)


def html_report(title: str, sections: Sequence[Section]) -> str:
    """The page that `write_report` writes."""
    links = [
        f'<a href="#s{k}">{escape(s.heading)}</a>' for k, s in enumerate(sections) if not s.folded
    ]
    parts = [
        "<!DOCTYPE html>",
        '<html lang="en"><head><meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>{escape(title)}</title><style>\n{_STYLE.read_text()}</style></head><body>",
        f"<h1>{escape(title)}</h1>",
        f"<nav>{''.join(links)}</nav>" if len(links) > 2 else "",
        *[_section(k, section) for k, section in enumerate(sections)],
        "</body></html>",
    ]
    return "\n".join(part for part in parts if part) + "\n"


def markdown_report(title: str, sections: Sequence[Section]) -> str:
    """The same in Markdown: headings, words and tables, without the pictures."""
    parts = [f"# {in_markdown(title)}"]
    for section in sections:
        parts += [f"## {in_markdown(section.heading)}", without_tags(section.prose.strip())]
        for number, step in enumerate(section.steps, 1):
            command = f"\n\n       {step.command}" if step.command else ""
            parts.append(f"{number}. {in_markdown(step.words)}{command}")
        parts.append("" if section.table is None else to_markdown(section.table))
    return "\n\n".join(part for part in parts if part) + "\n"


def _section(number: int, section: Section) -> str:
    title = f"<h2>{escape(section.heading)}</h2>"
    tag = "details" if section.folded else "section"
    title = f"<summary>{title}</summary>" if section.folded else title
    parts = [f'<{tag} id="s{number}">{title}']
    paragraphs = [p.strip() for p in section.prose.split("\n\n")]
    parts += [f"<p>{escape(p)}</p>" for p in paragraphs if p]
    parts += ["<ol>", *map(_step, section.steps), "</ol>"] if section.steps else []
    if section.table is not None:
        parts.append(f'<div class="table">{to_html(section.table)}</div>')
    parts += [_picture(picture) for picture in section.pictures]
    return "\n".join([*parts, f"</{tag}>"])


def _step(step: Step) -> str:
    command = f"<pre>{escape(step.command)}</pre>" if step.command else ""
    return f"<li>{escape(step.words)}{command}</li>"


def _picture(picture: Picture) -> str:
    caption = escape(picture.caption)
    source = f"data:image/png;base64,{b64encode(png(picture.figure)).decode('ascii')}"
    return (
        f'<figure><img alt="{caption}" src="{source}"><figcaption>{caption}</figcaption></figure>'
    )
