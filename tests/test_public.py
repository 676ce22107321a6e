"""What `surefoot` and `surefoot.extend` offer: stated alike for use and for types, and enough."""

import ast
import inspect
import re
from importlib import import_module
from pathlib import Path

import pytest

import surefoot
from surefoot import extend

ROOT = next(p for p in Path(__file__).resolve().parents if (p / "pyproject.toml").exists())
BLOCK = re.compile(r"^```python[^\n]*\n(.*?)^```", re.MULTILINE | re.DOTALL)
AUTHORS = [
    *(ROOT / "docs").glob("guides/*.md"),
    *(ROOT / "docs").glob("examples/**/*.py"),
    *(ROOT / "tests/packages").glob("*/*.py"),
    *(ROOT / "scenarios/skeletons").glob("*/*.py.txt"),
]
"""What is written as a user writes it."""


def homes(module) -> dict[str, str]:
    """Name -> "module:attribute"."""
    return {
        words.rpartition(" ")[2]: f"surefoot.{home}:{words.partition(' ')[0]}"
        for home, names in module._HOMES.items()
        for words in names
    }


def imported_for_types(module) -> dict[str, str]:
    """Name -> "module:attribute" of the imports for type checkers."""
    tree = ast.parse(Path(module.__file__).read_bytes())
    (block,) = [node for node in tree.body if isinstance(node, ast.If)]
    return {
        alias.asname or alias.name: f"{node.module}:{alias.name}"
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }


@pytest.mark.parametrize("module", [surefoot, extend])
def test_the_lists_are_equal(module):
    assert imported_for_types(module) == homes(module)
    assert set(homes(module)) <= set(dir(module))


def test_the_list_for_star_is_that_of_the_names():
    assert sorted([*homes(surefoot), "__version__"]) == sorted(surefoot.__all__)


@pytest.mark.parametrize("module", [surefoot, extend])
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
    found = inspect.signature(surefoot.trace).parameters
    assert "TraceOptions" in str(found["options"].annotation)
