"""docs/equations.md is whole: what it names exists, and it names every label of the paper.

The paper is no part of the repository: labels are checked where SUREFOOT_PAPER names its LaTeX
source, or where that lies in `../shared/paper.tex` beside the checkout.
"""

import ast
import importlib
import os
import re
from pathlib import Path

import pytest

ROOT = next(p for p in Path(__file__).resolve().parents if (p / "pyproject.toml").exists())
PAGE = (ROOT / "docs" / "equations.md").read_text(encoding="utf-8")
PAPER = Path(os.environ.get("SUREFOOT_PAPER", ROOT.parent / "shared" / "paper.tex"))
NAME = re.compile(r"`((?:surefoot\.)?(?:sim|estimator|models|scenarios|studies)(?:\.\w+)+)`")
TEST = re.compile(r"`(tests/[\w/]+\.py)::(\w+)`")
QUOTED = re.compile(r"`[^`]+`")
NO_CODE = ("`fig:overview`",)
"""Labels that nothing can be named for."""


def rows() -> list[list[str]]:
    """The cells of each row of each table, less heads and rules."""
    lines = [line for line in PAGE.splitlines() if line.startswith("| ")]
    cells = [[c.strip() for c in re.split(r"(?<!\\)\|", line)[1:-1]] for line in lines]
    return [row for row in cells if row[0] not in ("Label", "Where")]


def labels() -> list[str]:
    return sorted(row[0].strip("`") for row in rows() if row[0].startswith("`"))


def resolve(name: str) -> object:
    """The module, class, function or method of that dotted name."""
    whole = name if name.startswith(("surefoot.", "studies.")) else f"surefoot.{name}"
    parts = whole.split(".")
    for length in range(len(parts), 0, -1):
        module = ".".join(parts[:length])
        try:
            found = importlib.import_module(module)
        except ModuleNotFoundError as error:
            # What is missing must be the name itself, not something that its module imports.
            if error.name is None or not f"{module}.".startswith(f"{error.name}."):
                raise
            continue
        for part in parts[length:]:
            found = getattr(found, part)
        return found
    raise ModuleNotFoundError(name)


@pytest.mark.parametrize("name", sorted(set(NAME.findall(PAGE))))
def test_code_that_is_named_exists(name):
    assert resolve(name) is not None


@pytest.mark.parametrize(("path", "test"), sorted(set(TEST.findall(PAGE))))
def test_tests_that_are_named_exist(path, test):
    tree = ast.parse((ROOT / path).read_text(encoding="utf-8"))
    assert test in [node.name for node in tree.body if isinstance(node, ast.FunctionDef)]


@pytest.mark.parametrize("row", rows(), ids=lambda row: f"{row[0].strip('`')} {row[1]}")
def test_a_row_names_its_code_and_its_tests(row):
    """In full, so that the two tests above have seen it; a section names no test."""
    assert len(row) in (3, 4)
    for cell, form in zip(row[2:], (NAME, TEST), strict=False):
        assert all(form.fullmatch(quoted) for quoted in QUOTED.findall(cell))
        assert bool(form.search(cell)) == (row[0] not in NO_CODE)


def test_a_label_has_one_row():
    assert labels() == sorted(set(labels()))


@pytest.mark.skipif(not PAPER.is_file(), reason=f"no paper at {PAPER}; name it in SUREFOOT_PAPER")
def test_every_label_of_the_paper_is_there_and_no_other():
    source = re.sub(r"(?<!\\)%.*", "", PAPER.read_text(encoding="utf-8"))
    assert labels() == sorted(set(re.findall(r"\\label\{([^}]+)\}", source)))
