"""Which sources a module is made of: its own and those of every module that it imports in turn.

Compiled kernels and products of long runs are kept under a digest of their code: docstrings, lines
of comment and empty lines may change. What is installed, numpy say, and the standard library do not
count, but for the package that the module itself is of.
"""

import ast
import hashlib
import re
import secrets
import sys
from collections.abc import Iterable, Mapping
from functools import cache
from importlib.machinery import all_suffixes
from importlib.util import find_spec, resolve_name
from pathlib import Path
from typing import Any, NamedTuple

LIBRARY = "surefoot"
INSTALLED = {"site-packages", "dist-packages"}
_MEMBER = re.compile(r"([\w.]+):[\w.]+")


def code_digest(*members: Any) -> str:
    """SHA-256 of the code that classes, functions or instances are made of.

    That is `sources_digest` of the modules that define them, in whatever order they are given. A
    product that depends on what a user chose by name, an effect say, is kept under it.
    """
    modules = sorted({member.__module__ for member in members})
    files = (getattr(sys.modules.get(module), "__file__", None) for module in modules)
    digests = [sources_digest(module, file) for module, file in zip(modules, files, strict=True)]
    return hashlib.sha256("".join(digests).encode()).hexdigest()


@cache
def sources_digest(module: str, file: str | None = None) -> str:
    """SHA-256 of the names of `imported_sources` and the lines of each that are code.

    Of a module without any, one typed at a prompt say, it is another in each process: what cannot
    be compared is made again.
    """
    sources = imported_sources(module, file)
    if not sources:
        return secrets.token_hex(32)
    digest = hashlib.sha256()
    for name, path in sorted(sources.items()):
        digest.update(name.encode() + b"\0" + _contents(path).code + b"\0")
    return digest.hexdigest()


def imported_sources(module: str, file: str | None = None) -> dict[str, Path]:
    """Name -> source file of a module and of all that it imports in turn.

    Args:
        module: its dotted name; a name that no source has yields nothing.
        file: its source, where Python cannot find it by name: a script, a test.

    Counts imports inside functions, relative ones, every package that a name lies in, compiled
    modules, what a Registry names as "module:attribute", and what a package imports by such a
    string of a dictionary once its key is asked for; not imports for type checkers alone. Other
    imports that are made of strings are not seen.
    """
    found: dict[str, Path] = {}
    waiting = [module]
    own = module.partition(".")[0]
    while waiting:
        name = waiting.pop()
        if name in found or not _counts(name.partition(".")[0], own):
            continue
        path = Path(file) if file and name == module else _source(name)
        if path is None or not path.is_file():
            continue
        found[name] = path
        package = name if path.name == "__init__.py" else name.rpartition(".")[0]
        for level, base, names in _contents(path).imports:
            if level:
                base = resolve_name("." * level + base, package) if package else base
            # `from a import b`: b may be a module itself. A package runs before what lies in it.
            for one in (base, *(f"{base}.{n}" for n in names), *_imported_late(base, names, own)):
                parts = one.split(".")
                waiting += [".".join(parts[: k + 1]) for k in range(len(parts))]
    return found


class _Contents(NamedTuple):
    """Level, module and names of each import; key -> module of its dictionaries; lines of code."""

    imports: tuple[tuple[int, str, tuple[str, ...]], ...]
    late: dict[str, str]
    code: bytes


def _counts(top: str, own: str) -> bool:
    """Whether a top-level package is the library's, the module's `own`, or not installed."""
    if top in (LIBRARY, own):
        return True
    folders = () if top in sys.stdlib_module_names else _folders(top)
    return bool(folders) and not any(INSTALLED & set(folder.parts) for folder in folders)


def _imported_late(base: str, names: tuple[str, ...], own: str) -> list[str]:
    """Modules that a package imports when it is asked for the names; "*" asks for all."""
    path = _source(base) if _counts(base.partition(".")[0], own) else None
    late = _contents(path).late if path else {}
    return [late[name] for name in (late if "*" in names else names) if name in late]


def _contents(path: Path) -> _Contents:
    if path.suffix != ".py":
        return _Contents((), {}, path.read_bytes())
    stat = path.stat()
    return _parsed(path, stat.st_mtime_ns, stat.st_size)


@cache
def _parsed(path: Path, _changed: int, _size: int) -> _Contents:
    imports: list[tuple[int, str, tuple[str, ...]]] = []
    late: dict[str, str] = {}
    source = path.read_bytes()
    tree = ast.parse(source)
    texts: list[ast.expr | ast.Expr] = []
    waiting: list[ast.AST] = [tree]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            texts.append(node)
            continue
        if isinstance(node, ast.Constant | ast.JoinedStr):
            texts.append(node)
        if isinstance(node, ast.If) and ast.unparse(node.test).endswith("TYPE_CHECKING"):
            waiting += node.orelse
            continue
        waiting += ast.iter_child_nodes(node)
        if isinstance(node, ast.Call) and ast.unparse(node.func).endswith("Registry"):
            imports += [(0, module, ()) for module in map(_member, ast.walk(node)) if module]
        if isinstance(node, ast.Import):
            for alias in node.names:
                imports.append((0, alias.name, ()))
                # Any name of what is bound may be asked for later.
                bound = alias.name if alias.asname else alias.name.partition(".")[0]
                imports.append((0, bound, ("*",)))
        elif isinstance(node, ast.ImportFrom):
            imports.append((node.level, node.module or "", tuple(a.name for a in node.names)))
    for node in tree.body:
        if isinstance(node, ast.Assign | ast.AnnAssign) and isinstance(node.value, ast.Dict):
            for key, value in zip(node.value.keys, node.value.values, strict=True):
                module = _member(value)
                if module and isinstance(key, ast.Constant):
                    late[str(key.value)] = module
    return _Contents(tuple(imports), late, _code(source, texts))


def _code(source: bytes, texts: Iterable[ast.expr | ast.Expr]) -> bytes:
    """The lines of a source without docstrings, lines of comment and empty ones."""
    lines = dict(enumerate(source.splitlines(), 1))
    within: set[int] = set()  # a string of several lines, where "#" begins no comment
    for node in texts:
        rows = range(node.lineno, (node.end_lineno or node.lineno) + 1)
        if _is_docstring(node, lines):
            lines |= dict.fromkeys(rows, b"")
        else:
            within.update(rows[1:])
    return b"\n".join(
        line
        for number, line in lines.items()
        if number in within or (line.strip() and line.lstrip()[:1] != b"#")
    )


def _is_docstring(node: ast.expr | ast.Expr, lines: Mapping[int, bytes]) -> bool:
    """Whether a string stands alone on its lines, and is no more than a remark."""
    before = lines[node.lineno][: node.col_offset]
    after = lines[node.end_lineno or node.lineno][node.end_col_offset :]
    return isinstance(node, ast.Expr) and not before.strip() and not after.split(b"#")[0].strip()


def _member(node: ast.AST) -> str:
    """The module of a "module:attribute", empty for anything else."""
    value = node.value if isinstance(node, ast.Constant) else None
    found = _MEMBER.fullmatch(value) if isinstance(value, str) else None
    return found[1] if found else ""


def _source(module: str) -> Path | None:
    top, _, rest = module.partition(".")
    for folder in _folders(top):
        if folder.is_file():
            return None if rest else folder
        base = folder.joinpath(*rest.split(".")) if rest else folder
        names = [base / "__init__.py", *(base.with_name(base.name + s) for s in all_suffixes())]
        for path in names if rest else names[:1]:
            if path.is_file():
                return path
    return None


@cache
def _folders(top: str) -> tuple[Path, ...]:
    """The folders of a top-level package, several of a namespace, or the file of a module."""
    try:
        spec = find_spec(top)
    except (ImportError, ValueError):  # `__main__`, and modules that were loaded without a spec
        return ()
    if spec is None:
        return ()
    if spec.submodule_search_locations is not None:
        return tuple(map(Path, spec.submodule_search_locations))
    return (Path(spec.origin),) if spec.has_location and spec.origin else ()
