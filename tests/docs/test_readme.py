"""The README is short, its Python runs, its commands exist, and its links lead somewhere."""

import re
import sys
from pathlib import Path

import pytest
from processes import printed

import surefoot
from surefoot import estimator
from surefoot.scenarios import reporting
from surefoot.scenarios.cli.main import COMMANDS

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "docs"))

import guide  # noqa: E402
import readme_table  # noqa: E402

README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_it_is_short():
    assert len(README.encode()) <= 10_000


@pytest.mark.slow
def test_its_python_runs(tmp_path):
    python = [b.text for b in guide.blocks(ROOT / "README.md") if b.language == "python"]
    assert len(python) == 2
    script = tmp_path / "readme.py"
    script.write_text("\n".join(python), encoding="utf-8")
    printed(script, cwd=tmp_path)


@pytest.mark.parametrize(
    ("module", "page"),
    [(surefoot, "index.md"), (estimator, "estimator.md"), (reporting, "scenarios.md")],
)
def test_the_reference_has_every_public_name(module, page):
    text = (ROOT / "docs/reference" / page).read_text(encoding="utf-8")
    named = re.findall(r"(?<=[`.])\w+(?=`|$)", text, re.MULTILINE)
    assert set(module.__all__) <= set(named)


def test_every_command_is_named_and_there_is_no_other():
    table = README.partition("## Commands")[2].partition("\n## ")[0]
    named = set(re.findall(r"surefoot (\w+)", table)) | set(re.findall(r"· `(\w+)`", table))
    assert named - {"FILE"} == set(COMMANDS)


@pytest.mark.parametrize("page", ["README.md", "CONTRIBUTING.md", "CHANGELOG.md"])
def test_its_links_lead_somewhere(page):
    text = (ROOT / page).read_text(encoding="utf-8")
    links = re.findall(r"\]\(([^)#]+)", text)
    assert not [link for link in links if "://" not in link and not (ROOT / link).exists()]


def test_the_table_goes_between_its_markers():
    made = readme_table.with_table(README, "| new |")
    assert made.count("| new |") == 1
    assert made.partition(readme_table.BEGIN)[0] == README.partition(readme_table.BEGIN)[0]
    assert made.partition(readme_table.END)[2] == README.partition(readme_table.END)[2]
    with pytest.raises(SystemExit, match="lacks the markers"):
        readme_table.with_table("no markers", "| new |")


def test_modules_of_0_1_0_are_listed_beside_modules_that_exist():
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    table = text.partition("### Modules of 0.1.0")[2].partition("## 0.1.0")[0]
    rows = re.findall(r"^\| (\w+) \| ([\w.]+) \|$", table, re.MULTILINE)
    assert len(rows) > 150
    missing = [
        f"{old} -> {new}"
        for old, new in rows
        if not (ROOT / f"{new.replace('.', '/')}.py").exists()
        and not (ROOT / new.replace(".", "/") / "__init__.py").exists()
    ]
    assert not missing
