"""Pages that list the keys of maps and scenarios: every key is there, with its meaning."""

import sys
from dataclasses import fields
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "docs"))
hooks = pytest.importorskip("hooks", reason="the site needs mkdocs", exc_type=ImportError)

import keys as module  # noqa: E402

KINDS: list[type] = []
"""Dataclasses of the tables of both pages."""
with pytest.MonkeyPatch.context() as patch:
    patch.setattr(module, "keys_page", lambda *page: KINDS.extend(kind for _, kind in page[2]))
    hooks._maps()
    hooks._scenario_files()


@pytest.mark.parametrize("kind", KINDS)
def test_every_key_is_listed_with_its_meaning(kind):
    found = module.keys(kind)
    assert {key for key, *_ in found} == {one.name for one in fields(kind)} - {"bumps"}
    assert all(len(meaning) >= 1 for *_, meaning in found), found
    page = module.keys_page("Title", "Words.", [("[table]", kind)])
    assert page.count("\n| `") == len(found)
    assert not any("[" in value for _, value, *_ in found)


def test_both_pages_have_all_their_tables():
    assert len(KINDS) == len(set(KINDS)) == 19
