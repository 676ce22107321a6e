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
    texts = [path.read_text(encoding="utf-8") for path in (ROOT / "docs").rglob("*.md")]
    texts += [(ROOT / page).read_text(encoding="utf-8") for page in hooks.PAGES]
    texts += [hooks._maps(), hooks._scenario_files(), *hooks._catalogues(), hooks._plausibility()]
    titles = [hooks._title(text) for text in texts] + ["Commands", "Results"]
    assert len(titles) > 60
    assert not _more_than_once(titles)


def test_pages_of_walkers_are_told_apart():
    text = "# Realism: simulated walks\n\ncompared with 3 simulated walks of {}"
    assert hooks._title(text.format("go1")) != hooks._title(text.format("go2"))


def test_no_two_entries_of_the_navigation_have_the_same_title():
    nav = (ROOT / "mkdocs.yml").read_text(encoding="utf-8").partition("\nnav:\n")[2]
    entries = re.findall(r"^ +- (.+): ?\S*$", nav, re.MULTILINE)
    assert len(entries) > 50
    assert not _more_than_once(entries)


def test_every_page_is_in_the_navigation():
    nav = (ROOT / "mkdocs.yml").read_text(encoding="utf-8").partition("\nnav:\n")[2]
    pages = {str(path.relative_to(ROOT / "docs")) for path in (ROOT / "docs").rglob("*.md")}
    assert not {page for page in pages if page not in nav}
