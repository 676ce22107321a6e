"""What the public modules offer: each name is what its home has; for plug-ins two suffice."""

import ast
import inspect
import re
from importlib import import_module
from pathlib import Path

import pytest

import surefoot
from surefoot import estimator, extend
from surefoot.scenarios import reporting

ROOT = next(p for p in Path(__file__).resolve().parents if (p / "pyproject.toml").exists())
BLOCK = re.compile(r"^```python[^\n]*\n(.*?)^```", re.MULTILINE | re.DOTALL)
AUTHORS = [
    *(ROOT / "docs").glob("guides/*.md"),
    *(ROOT / "docs").glob("examples/**/*.py"),
    *(ROOT / "tests/packages").glob("*/*.py"),
    *(ROOT / "scenarios/skeletons").glob("*/*.py.txt"),
]
"""What is written as a user writes it."""
DOORS = (surefoot, extend, estimator, reporting)


def homes(module) -> dict[str, str]:
    """Name -> "module:attribute" of the imports for type checkers."""
    tree = ast.parse(Path(module.__file__).read_bytes())
    (block,) = [node for node in tree.body if isinstance(node, ast.If)]
    return {
        alias.asname or alias.name: f"{node.module}:{alias.name}"
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }


@pytest.mark.parametrize("module", DOORS)
def test_the_names_are_listed_and_others_are_refused(module):
    assert set(homes(module)) <= set(dir(module))
    with pytest.raises(AttributeError, match="no attribute 'evalute'"):
        module.evalute  # noqa: B018


def test_star_imports_the_names():
    found: dict[str, object] = {}
    exec("from surefoot.scenarios.reporting import *", found)
    assert found.keys() - {"__builtins__"} == homes(reporting).keys()


@pytest.mark.parametrize("module", DOORS)
def test_a_name_is_what_its_home_has(module):
    for name, home in homes(module).items():
        place, _, attribute = home.partition(":")
        assert getattr(module, name) is getattr(import_module(place), attribute), name
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = module.no_such_name


@pytest.mark.parametrize("path", AUTHORS, ids=lambda path: path.name)
def test_authors_import_from_the_two_public_modules_alone(path):
    text = path.read_text(encoding="utf-8")
    for code in BLOCK.findall(text) if path.suffix == ".md" else [text]:
        imports = re.findall(r"^\s*(?:from|import) (surefoot[\w.]*)", code, re.MULTILINE)
        assert set(imports) <= {"surefoot", "surefoot.extend"}


def test_the_signature_of_trace_can_be_read():
    options = inspect.signature(surefoot.trace).parameters["options"]
    assert options.annotation is surefoot.TraceOptions
