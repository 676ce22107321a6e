"""What `import surefoot` offers is stated three times, alike: for use, for types and for `*`."""

import ast
import inspect
from importlib import import_module
from pathlib import Path

import pytest

import surefoot


def imported_for_types() -> dict[str, str]:
    """Name -> "module:attribute" of the imports for type checkers."""
    tree = ast.parse(Path(surefoot.__file__).read_bytes())
    (block,) = [node for node in tree.body if isinstance(node, ast.If)]
    return {
        alias.asname or alias.name: f"{node.module}:{alias.name}"
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }


def test_the_three_lists_are_equal():
    assert imported_for_types() == surefoot._HOMES
    assert sorted([*surefoot._HOMES, "__version__"]) == sorted(surefoot.__all__)


@pytest.mark.parametrize("name", list(surefoot._HOMES))
def test_a_name_is_what_its_home_has(name):
    module, _, attribute = surefoot._HOMES[name].partition(":")
    assert getattr(surefoot, name) is getattr(import_module(module), attribute)


def test_the_signature_of_trace_can_be_read():
    assert "settings: TraceSettings | None = None" in str(
        inspect.signature(surefoot.trace)
    ).replace("surefoot.models.attribution.settings.", "")
