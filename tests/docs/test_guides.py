"""Every guide is run from top to bottom, in a folder of its own; a guide that continues another
one finds that one's files."""

import shutil
import sys
from pathlib import Path

import pytest
from processes import python

DOCS = Path(__file__).resolve().parents[2] / "docs"
sys.path.insert(0, str(DOCS))

import guide as guides  # noqa: E402

PAGES = sorted(guides.GUIDES.glob("*.md"))


@pytest.fixture(scope="session")
def folders(tmp_path_factory):
    """Runs a guide once, after the one that it continues, and gives its folder."""
    done: dict[Path, Path] = {}

    def folder_of(page: Path) -> Path:
        if page not in done:
            folder = tmp_path_factory.mktemp(page.stem)
            if before := guides.continued(page):
                shutil.copytree(folder_of(before), folder, dirs_exist_ok=True)
            ran = python(DOCS / "guide.py", page, cwd=folder, timeout=None)
            assert ran.returncode == 0, f"{ran.stdout[-2000:]}\n{ran.stderr[-4000:]}"
            done[page] = folder
        return done[page]

    return folder_of


@pytest.mark.slow
@pytest.mark.parametrize("page", [pytest.param(page, id=page.stem) for page in PAGES])
def test_a_guide_runs_from_top_to_bottom(page, folders):
    folders(page)


@pytest.mark.parametrize("page", [pytest.param(page, id=page.stem) for page in PAGES])
def test_every_block_of_a_guide_is_run_or_says_why_not(page):
    found = guides.blocks(page)
    assert page.read_text(encoding="utf-8").count("\n```") == 2 * len(found)
    assert all(block.not_run is None or len(block.not_run) > 10 for block in found)
    assert {b.language for b in found} <= {"bash", "python", "toml", "xml", "csv", "text"}
    assert all(b.file for b in found if b.language in {"toml", "xml", "csv"} and b.not_run is None)


def test_a_guide_that_fails_is_seen_to_fail(tmp_path):
    page = tmp_path / "failing.md"
    for text in ("```python\nraise ValueError\n```\n", "```bash\nfalse\ntrue\n```\n"):
        page.write_text(f"Some words.\n\n{text}")
        ran = python(DOCS / "guide.py", page, cwd=tmp_path)
        assert ran.returncode != 0
        assert "failing.md:4: this block fails" in ran.stderr
