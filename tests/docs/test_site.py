"""The site: no two pages have the same title, in their text or in the navigation."""

import re
import sys
from collections import Counter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "docs"))

hooks = pytest.importorskip("hooks", reason="the site needs mkdocs", exc_type=ImportError)


def _more_than_once(titles):
    return [title for title, count in Counter(titles).items() if count > 1]


def test_no_two_pages_have_the_same_title():
    paths = [*(ROOT / "docs").rglob("*.md"), *(ROOT / page for page in hooks.PAGES)]
    made = [hooks._maps(), hooks._scenario_files(), *hooks._catalogues(), hooks._plausibility()]
    titles = [hooks._title(path) for path in paths] + [text.partition("\n")[0][2:] for text in made]
    titles += ["Commands", "Results"]
    assert len(titles) > 60
    assert not _more_than_once(titles)


def test_the_main_finding_of_a_page_is_its_first_sentence(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("# Title\n\n## Findings\n\nThe error is 0.5 m. It was larger.\n\nMore.\n")
    assert hooks.main_finding(page) == "The error is 0.5 m."
    page.write_text("# Title\n\n| a |\n| - |\n\n[![P](p.png)](p.png)\n\nNone. More.\n")
    assert hooks.main_finding(page) == "None."


def test_the_index_has_the_main_finding_of_every_page():
    pages = sorted((ROOT / "docs" / "results").glob("*.md"))
    lines = [line for line in hooks._results().splitlines() if line.startswith("| [")]
    assert len(lines) == len(pages)
    for page, line in zip(pages, lines, strict=True):
        link, finding = line.strip("| ").split(" | ", maxsplit=1)
        assert f"({page.name})" in link
        assert finding in page.read_text(encoding="utf-8")


@pytest.mark.parametrize("page", sorted((ROOT / "docs" / "results").glob("*.md")), ids=str)
def test_pages_of_results_are_short_and_their_tables_fit(page):
    if page.stem.startswith("blind"):
        pytest.skip("of the earlier form")
    text = page.read_text(encoding="utf-8")
    tables = [part for part in text.split("\n\n") if part.startswith("| ") and part[2] != "|"]
    assert len(tables) == 1
    assert tables[0].splitlines()[0].count("|") <= 8
    assert len(text.split()) < 1500


def test_every_page_is_in_the_navigation_by_a_title_of_its_own():
    nav = (ROOT / "mkdocs.yml").read_text(encoding="utf-8").partition("\nnav:\n")[2]
    entries = re.findall(r"^ +- (.+): ?\S*$", nav, re.MULTILINE)
    assert len(entries) > 50
    assert not _more_than_once(entries)
    pages = {str(path.relative_to(ROOT / "docs")) for path in (ROOT / "docs").rglob("*.md")}
    assert not {page for page in pages if page not in nav}
