"""Size of the project, and its limits: `make size`.

Code lines are lines without blanks, comments and docstrings, those of attributes included. Only
files that git tracks count.
"""

import ast
import io
import subprocess
import sys
import tokenize
from collections import Counter
from itertools import chain
from pathlib import Path

PACKAGE = ("sim", "models", "estimator", "scenarios", "surefoot")
MOST_LINES = 35_500
MOST_FILES = 16
"""Python files in a folder of the package, `__init__` not counted."""
LARGE_FOLDERS = ("models/attribution", "models/residuals", "sim/plausibility")
"""Folders that may have more."""
MOST_ARGUMENTS = 6
"""Arguments of a function that is no kernel."""
_NO_CODE = (
    *(tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT),
    *(tokenize.ENCODING, tokenize.ENDMARKER),
)
_Function = ast.FunctionDef | ast.AsyncFunctionDef


def code_lines(text: str, tree: ast.Module) -> int:
    """Number of code lines of a module."""
    bodies = (getattr(node, "body", None) for node in ast.walk(tree))
    docs = {
        line
        for one in chain.from_iterable(body for body in bodies if isinstance(body, list))
        if isinstance(one, ast.Expr) and isinstance(one.value, ast.Constant)
        if isinstance(one.value.value, str)
        for line in range(one.lineno, (one.end_lineno or one.lineno) + 1)
    }
    lines: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in _NO_CODE:
            lines.update(range(token.start[0], token.end[0] + 1))
    return len(lines - docs)


def argument_count(function: _Function) -> int:
    """Number of arguments, self and cls not counted."""
    a = function.args
    named = [one.arg for one in (*a.posonlyargs, *a.args)]
    own = named[:1] in (["self"], ["cls"])
    return len(named) - own + len(a.kwonlyargs) + bool(a.vararg) + bool(a.kwarg)


def room_of(path: Path) -> str:
    """Where the lines of a file are listed: its folder at the top, or a room of scenarios."""
    depth = 2 if path.parts[0] == "scenarios" and len(path.parts) > 2 else 1
    return "/".join(path.parts[:depth])


def main() -> int:
    """Print the size by room, and what exceeds a limit; returns the exit status."""
    listed = subprocess.run(["git", "ls-files", "*.py"], capture_output=True, text=True, check=True)
    lines, folders = Counter(), Counter()
    beyond: list[str] = []
    for path in map(Path, listed.stdout.split()):
        text, room = path.read_text(encoding="utf-8"), room_of(path)
        tree = ast.parse(text)
        lines[room] += code_lines(text, tree)
        if path.parts[0] not in PACKAGE:
            continue
        folders[path.parent.as_posix()] += path.stem != "__init__"
        beyond += [
            f"{path}:{node.lineno} {node.name}: {argument_count(node)} arguments"
            for node in ast.walk(tree)
            if isinstance(node, _Function) and argument_count(node) > MOST_ARGUMENTS
            if not any("kernel" in ast.unparse(one) for one in node.decorator_list)
        ]
    beyond += [
        f"{folder}: {count} files"
        for folder, count in sorted(folders.items())
        if count > MOST_FILES and folder not in LARGE_FOLDERS
    ]
    total = sum(lines[room] for room in lines if room.split("/")[0] in PACKAGE)
    for name, count in [*sorted(lines.items()), ("package", total)]:
        print(f"{name:24}{count:8}")
    if total > MOST_LINES:
        beyond.append(f"package: {total} lines")
    limits = f"{MOST_LINES} lines, {MOST_FILES} files a folder, {MOST_ARGUMENTS} arguments"
    print("\n".join([f"\nbeyond the limits ({limits}):", *beyond]) if beyond else f"\nin {limits}")
    return bool(beyond)


if __name__ == "__main__":
    sys.exit(main())
