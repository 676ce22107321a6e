"""Names of logs, filters and scenarios are words of a report, never its code."""

import csv
import re
import shutil
import subprocess
from html import escape
from io import StringIO
from pathlib import Path

import pytest
from forked import copied
from web_page import Page

from surefoot.scenarios.cli.main import main
from surefoot.scenarios.reporting.html import Section, html_report, markdown_report
from surefoot.scenarios.reporting.tables import to_csv, to_markdown

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


MARKUP = (
    *EVIL,
    *("[click](https://example.com)", "![](https://example.com/a.png)", "<https://example.com>"),
    *("`code`", "a|b", "back\\slash", "\\`code`", "two\nlines", "\x1b[31mred", "x<img src=x>"),
)


@pytest.mark.parametrize("name", MARKUP)
def test_no_name_is_markup_in_a_table_of_markdown(name):
    text = to_markdown([{"log": name, name: 1.0}])
    assert len(text.splitlines()) == 3
    assert all(len(re.findall(r"(?<!\\)\|", line)) == 3 for line in text.splitlines())
    shown = re.sub(r"\\[\\`|(]", "", text)  # without what is escaped
    assert not re.search(r"<[A-Za-z/!?]|\]\(|`", shown)
    assert all(c.isprintable() or c == "\n" for c in text)


def test_what_is_no_markup_stays_as_it_is():
    rows = [{"pi<gamma [%]": "a < b", "best": "**0.1**"}]
    assert to_markdown(rows).splitlines()[2] == "| a < b        | **0.1** |"
    assert "pi<gamma [%]" in to_markdown(rows)
    assert "| [`x`](y) |" in to_markdown([{"code": "[`x`](y)"}], markup=True)
    prose = markdown_report("a<b>", [Section("[h](x)", "see `pi<gamma`\n\n<img src=x>")])
    assert prose == "# a&lt;b>\n\n## [h]\\(x)\n\nsee `pi<gamma`\n\n&lt;img src=x>\n"


FORMULAS = ("=HYPERLINK(1)", "+1+1", "@SUM(1)", "\t=1", "\r=1", "-cmd|' /C calc'!A0")


@pytest.mark.parametrize("name", FORMULAS)
def test_no_name_is_a_formula_in_csv(name):
    header, row = csv.reader(StringIO(to_csv([{name: name}]), newline=""))
    assert header == row
    assert len(row) == 1
    assert row[0][0] not in "=+-@\t\r"


def test_numbers_and_other_texts_stay_as_they_are_in_csv():
    rows = [{"x": -1.5, "n": -3, "text": "-0.2 ± 0.1", "ok": True, "none": None, "name": "a-b"}]
    assert to_csv(rows) == "x,n,text,ok,none,name\n-1.5,-3,-0.2 ± 0.1,True,,a-b\n"


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
        pages.append(Page(text))
    plain, hostile = pages
    assert set(hostile.tags) == set(plain.tags)
    assert hostile.attributes == plain.attributes
