"""One name has one meaning in the whole house: no public class or function is in two modules."""

import ast
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
ROOMS = ("sim", "models", "estimator", "scenarios", "studies")


def defined(tree: ast.Module) -> set[str]:
    """Public classes and functions of a module; what it imports is not its own."""
    nodes = (n for n in tree.body if isinstance(n, ast.FunctionDef | ast.ClassDef))
    return {node.name for node in nodes if not node.name.startswith("_")}


def test_no_public_name_is_defined_in_two_modules():
    places = defaultdict(list)
    for room in ROOMS:
        for path in sorted((ROOT / room).rglob("*.py")):
            for name in defined(ast.parse(path.read_text(encoding="utf-8"))):
                places[name].append(str(path.relative_to(ROOT)))
    assert len(places) > 1000  # the rooms were found
    assert {name: where for name, where in places.items() if len(where) > 1} == {}
