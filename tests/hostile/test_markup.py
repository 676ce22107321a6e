"""Names of logs, filters and scenarios are words of a report, never its code."""

import shutil
import subprocess
from html import escape
from html.parser import HTMLParser
from pathlib import Path

import pytest
from forked import copied

from surefoot.scenarios.cli.main import main
from surefoot.scenarios.reporting.html import Section, html_report
from surefoot.scenarios.reporting.tables import to_html

EVIL = (
    *("<script>alert(1)</script>", "<img src=x onerror=alert(1)>", '"><svg onload=alert(1)>'),
    *("javascript:alert(1)", "</title><script>", "<!--", "&lt;script&gt;", "'onmouseover='x"),
)

RUNS = "document.documentElement.setAttribute(`ran`,`yes`)"
ATTACKS = (
    f"<script>{RUNS}</script>",
    f'<img src=x onerror="{RUNS}">',
    f'"><svg onload="{RUNS}">',
    f"</title></style><script>{RUNS}</script>",
    f"--><script>{RUNS}</script>",
    f"]]><script>{RUNS}</script>",
    f'<iframe srcdoc="<script>parent.{RUNS}</script>">',
    f'<details open ontoggle="{RUNS}">',
    f"' type='image' src='x' onerror='{RUNS}",
)
BROWSERS = ("chromium-headless-shell", "chromium", "google-chrome")
BROWSER = next(filter(None, map(shutil.which, BROWSERS)), None)


class Seen(HTMLParser):
    """The elements and attributes that a browser would see."""

    def __init__(self):
        super().__init__()
        self.tags: set[str] = set()
        self.attributes: set[str] = set()

    def handle_starttag(self, tag, attrs):
        self.tags.add(tag)
        self.attributes |= {name for name, _ in attrs}


def test_no_word_is_code():
    plain = Seen()
    rows = [{"log": "a", "filter": "b"}]
    sections = [Section("a", "b\n\nc", rows)] * 3
    plain.feed(html_report("t", sections))
    hostile = Seen()
    rows = [{evil: evil, "filter": evil} for evil in EVIL]
    page = html_report(EVIL[4], [Section(evil, f"{evil}\n\n{evil}", rows) for evil in EVIL])
    hostile.feed(page)
    assert hostile.tags == plain.tags
    assert hostile.attributes == plain.attributes
    assert "<script" not in page.lower()
    assert "<script" not in to_html(rows).lower()


@pytest.mark.long
@pytest.mark.skipif(BROWSER is None, reason="no browser: chromium-headless-shell")
def test_no_word_is_run_by_a_browser(tmp_path):
    """Each attack is run in a page that takes it as it is, and none in a report."""
    page = tmp_path / "page.html"
    for attack in ATTACKS:
        page.write_text(f"<title>a</title><input value='{attack}'><p>{attack}")
        assert 'ran="yes"' in rendered(page), attack
    every = [*ATTACKS, *map(escape, ATTACKS)]
    rows = [{attack: attack, "filter": attack} for attack in every]
    sections = [Section(attack, f"{attack}\n\n{attack}", rows) for attack in every]
    page.write_text(html_report("".join(every), sections))
    assert 'ran="yes"' not in rendered(page)


def rendered(page: Path) -> str:
    """A page's elements after its scripts have run."""
    command = [str(BROWSER), "--headless", "--no-sandbox", "--disable-gpu", "--dump-dom"]
    done = subprocess.run(
        [*command, page.as_uri()], capture_output=True, text=True, timeout=60, check=True
    )
    assert "</html>" in done.stdout
    return done.stdout


@pytest.mark.long
def test_no_name_of_a_log_is_code_in_a_report(good, tmp_path, monkeypatch):
    """A slash cannot be in a file's name: the others go through the whole command."""
    pages = []
    for name in ("walk", "".join(evil for evil in EVIL if "/" not in evil)):
        folder = copied(good, tmp_path / f"case{len(pages)}")
        monkeypatch.chdir(folder)
        (folder / "walk.parquet").rename(folder / f"{name}.parquet")
        main(["compare", f"{name}.parquet", "-o", "new"])
        text = (folder / "new" / "report.html").read_text(encoding="utf-8")
        assert escape(name) in text
        pages.append(Seen())
        pages[-1].feed(text)
    plain, hostile = pages
    assert hostile.tags == plain.tags
    assert hostile.attributes == plain.attributes
