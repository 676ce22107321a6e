"""A report as one self-contained HTML file, with style and pictures inside."""

from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass, replace
from html import escape
from pathlib import Path

from matplotlib.figure import Figure

from surefoot.scenarios.reporting.plotting import png
from surefoot.scenarios.reporting.tables import (
    Table,
    in_markdown,
    to_html,
    to_markdown,
    without_tags,
)
from surefoot.sim.common.files import whole_file, write_whole

_STYLE = """
:root { color-scheme: light; }
body { font: 16px/1.55 system-ui, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif;
  color: #222; background: #fff; max-width: 76rem; margin: 2.5rem auto; padding: 0 1.25rem; }
h1 { font-size: 1.7rem; line-height: 1.25; margin: 0 0 1.5rem; }
h2 { font-size: 1.2rem; margin: 2.6rem 0 .6rem; padding-top: .8rem; border-top: 1px solid #ddd; }
h3 { font-size: 1.02rem; margin: 1.8rem 0 .5rem; }
p { max-width: 46rem; margin: .6rem 0; }
nav { font-size: .92rem; margin-bottom: 1rem; }
nav { display: flex; flex-wrap: wrap; gap: .1rem 1.2rem; }
nav a { color: #0b5a8a; text-decoration: none; }
.table { overflow-x: auto; margin: 1rem 0; }
table { border-collapse: collapse; font-size: .84rem; font-variant-numeric: tabular-nums; }
th, td { padding: .3rem .55rem; border-bottom: 1px solid #e4e4e4; text-align: left; }
th { border-bottom: 2px solid #999; vertical-align: bottom; }
.number { text-align: right; }
td.number { white-space: nowrap; }
tbody tr:nth-child(even) { background: #f7f7f7; }
figure { margin: 1.4rem 0; }
figure img { max-width: 100%; height: auto; }
figcaption { font-size: .9rem; color: #444; max-width: 46rem; margin-top: .3rem; }
@media print {
  body { margin: 0; max-width: none; font-size: 10.5pt; }
  nav { display: none; }
  figure, tr { break-inside: avoid; }
  h2, h3 { break-after: avoid; }
  .table { overflow: visible; }
  table { font-size: 6.8pt; }
  th, td { padding: .12rem .25rem; }
  thead { display: table-header-group; }
  @page { size: A4 landscape; margin: 12mm; }
  figure img { max-height: 22cm; }
}
"""


@dataclass(frozen=True)
class Picture:
    """A figure (or the bytes of a PNG), and its caption."""

    figure: Figure | bytes
    caption: str


@dataclass(frozen=True)
class Section:
    """A part of a report. `prose` is plain text; an empty line starts a new paragraph. `level` is
    that of the heading: 3 for a part of the last section of level 2.
    """

    heading: str
    prose: str = ""
    table: Table | None = None
    pictures: tuple[Picture, ...] = ()
    level: int = 2


def nested(sections: Sequence[Section]) -> list[Section]:
    """The same as parts of the section that they come after."""
    return [replace(section, level=section.level + 1) for section in sections]


def write_report(
    path: str | Path, title: str, sections: Sequence[Section], force: bool = False
) -> None:
    """Write the sections as a self-contained HTML page; all text is escaped.

    Raises SurefootError where `path` exists and `force` is not given, or cannot be written.
    """
    text = html_report(title, sections)
    write_whole(path, text, force)


def html_report(title: str, sections: Sequence[Section]) -> str:
    """The page that `write_report` writes."""
    links = [
        f'<a href="#s{k}">{escape(s.heading)}</a>' for k, s in enumerate(sections) if s.level == 2
    ]
    parts = [
        "<!DOCTYPE html>",
        '<html lang="en"><head><meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>{escape(title)}</title><style>{_STYLE}</style></head><body>",
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
        parts += [in_markdown(heading(section)), without_tags(section.prose.strip())]
        parts.append("" if section.table is None else to_markdown(section.table))
    return "\n\n".join(part for part in parts if part) + "\n"


def heading(section: Section) -> str:
    """A section's heading in Markdown."""
    return f"{'#' * section.level} {section.heading}"


def save_picture(picture: Picture, path: str | Path, force: bool = False) -> None:
    """Write the picture as a PNG. Raises SurefootError where `path` exists (no `force`)."""
    data = _bytes(picture)
    with whole_file(path, force) as temporary:
        temporary.write_bytes(data)


def _section(number: int, section: Section) -> str:
    tag = f"h{section.level}"
    parts = [f'<section id="s{number}"><{tag}>{escape(section.heading)}</{tag}>']
    paragraphs = [p.strip() for p in section.prose.split("\n\n")]
    parts += [f"<p>{escape(p)}</p>" for p in paragraphs if p]
    if section.table is not None:
        parts.append(f'<div class="table">{to_html(section.table)}</div>')
    parts += [_picture(picture) for picture in section.pictures]
    return "\n".join([*parts, "</section>"])


def _picture(picture: Picture) -> str:
    data = _bytes(picture)
    caption = escape(picture.caption)
    source = f"data:image/png;base64,{b64encode(data).decode('ascii')}"
    return (
        f'<figure><img alt="{caption}" src="{source}"><figcaption>{caption}</figcaption></figure>'
    )


def _bytes(picture: Picture) -> bytes:
    return picture.figure if isinstance(picture.figure, bytes) else png(picture.figure)
