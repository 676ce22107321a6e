"""Docstrings of the rooms: every argument of a long signature and every public name has one."""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
FILES = sorted(
    f
    for r in ("sim", "estimator", "models", "scenarios", "studies")
    for f in ROOT.glob(f"{r}/**/*.py")
)
FEW = 4
"""Arguments that a function may have without naming each."""

Function = ast.FunctionDef | ast.AsyncFunctionDef
Definition = Function | ast.ClassDef


def _public(name: str) -> bool:
    return not name.startswith("_")


def _arguments(function: Function) -> list[str]:
    a = function.args
    every = [*a.posonlyargs, *a.args, *a.kwonlyargs, *(x for x in (a.vararg, a.kwarg) if x)]
    return [one.arg for one in every if one.arg not in ("self", "cls")]


def undocumented_arguments(tree: ast.Module) -> list[str]:
    """Of each function with more than FEW arguments, those that its docstring does not name.

    `__init__` may be documented in its class.
    """
    of_class = {
        id(child): ast.get_docstring(node) or ""
        for node in ast.walk(tree)
        if isinstance(node, ast.ClassDef)
        for child in node.body
    }
    found = []
    for node in ast.walk(tree):
        if not isinstance(node, Function):
            continue
        names, text = _arguments(node), ast.get_docstring(node) or ""
        if node.name == "__init__":
            text += of_class.get(id(node), "")
        missing = [name for name in names if not re.search(rf"\b{re.escape(name)}\b", text)]
        if len(names) > FEW and missing:
            found.append(f"line {node.lineno}, {node.name}: {', '.join(missing)}")
    return found


def undocumented_names(tree: ast.Module) -> list[str]:
    """The module, its public classes and functions that have no docstring.

    Methods are left out: most implement a protocol, which documents them.
    """
    found = [] if ast.get_docstring(tree) else ["the module"]
    return found + [
        f"line {node.lineno}, {node.name}"
        for node in tree.body
        if isinstance(node, Definition) and _public(node.name) and not ast.get_docstring(node)
    ]


def _all(of, files=FILES) -> list[str]:
    return [
        f"{file.relative_to(ROOT)}: {what}"
        for file in files
        for what in of(ast.parse(file.read_text(encoding="utf-8")))
    ]


def test_every_argument_of_a_long_signature_is_documented() -> None:
    assert len(FILES) > 100
    assert not _all(undocumented_arguments)


def test_every_public_module_class_and_function_has_a_docstring() -> None:
    assert not _all(undocumented_names)


def test_what_is_missing_is_found() -> None:
    """Arguments of `__init__` may be documented in the class."""
    source = 'class A:\n    """Of a, b, c, d, e."""\n    def __init__(self, a, b, c, d, e): ...'
    assert undocumented_arguments(ast.parse(source)) == []
    tree = ast.parse(source.replace(", e.", "."))
    assert undocumented_arguments(tree) == ["line 3, __init__: e"]
    tree = ast.parse("def f(): ...\ndef _g(): ...\nclass A: ...")
    assert undocumented_names(tree) == ["the module", "line 1, f", "line 3, A"]
