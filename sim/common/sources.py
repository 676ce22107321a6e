"""The sources that a module depends on: its own and those of all modules that it imports, directly
or not, and the data files that these name.

Compiled kernels and results of long runs are stored with a digest of their code. Docstrings,
comment lines and empty lines do not count, nor do installed packages (such as numpy) and the
standard library, except for the package of the module itself.

A data file counts where a string of a module is its path relative to the module's folder, such as
"table.toml" or "data/table.csv". A string that names a folder does not count: which of its files
is read depends on an input, whose content enters as one. Nor do the strings of a script, which name
what it reads and writes.
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
_FILE = re.compile(r"\w[\w./-]*\.(?!py$)\w+")


def code_digest(*members: Any) -> str:
    """SHA-256 of the code of classes, functions or instances.

    It combines `sources_digest` of the modules that define them, independent of their order. It
    identifies results that depend on what a user chose by name, such as effects.
    """
    modules = sorted({member.__module__ for member in members})
    files = (getattr(sys.modules.get(module), "__file__", None) for module in modules)
    digests = [sources_digest(module, file) for module, file in zip(modules, files, strict=True)]
    return hashlib.sha256("".join(digests).encode()).hexdigest()


@cache
def sources_digest(module: str, file: str | None = None) -> str:
    """SHA-256 of the names of `imported_sources` and of their code lines.

    For a module without a source file, such as one typed at a prompt, it differs between processes,
    so that its results are never reused.
    """
    sources = imported_sources(module, file)
    if not sources:
        return secrets.token_hex(32)
    digest = hashlib.sha256()
    for name, path in sorted(sources.items()):
        digest.update(name.encode() + b"\0" + _contents(path).code + b"\0")
    return digest.hexdigest()


def imported_sources(module: str, file: str | None = None) -> dict[str, Path]:
    """Name -> source file, for a module and all modules that it imports, directly or not.

    Args:
        module: its dotted name; without a source file the result is empty.
        file: its source, for a script or a test that Python cannot find by name.

    Includes imports inside functions, relative imports, the packages that contain a module,
    compiled modules, "module:attribute" entries of a Registry, and what a module with __getattr__
    imports for type checkers, as names are requested. Other imports for type checkers are excluded.
    Imports by other strings are not detected. A data file is found under "package/path".
    """
    found: dict[str, Path] = {}
    waiting = [module]
    home = module.partition(".")[0]
    while waiting:
        name = waiting.pop()
        if name in found or not _counts(name.partition(".")[0], home):
            continue
        path = Path(file) if file and name == module else _source(name)
        if path is None or not path.is_file():
            continue
        found[name] = path
        package = name if path.name == "__init__.py" else name.rpartition(".")[0]
        for text in _contents(path).files if name != "__main__" else ():
            if (path.parent / text).is_file():
                found[f"{package}/{text}"] = path.parent / text
        for level, base, names in _contents(path).imports:
            if level:
                base = resolve_name("." * level + base, package) if package else base
            # `from a import b`: b may be a module itself. A package runs before what lies in it.
            for one in (base, *(f"{base}.{n}" for n in names), *_imported_late(base, names, home)):
                parts = one.split(".")
                waiting += [".".join(parts[: k + 1]) for k in range(len(parts))]
    return found


class _Contents(NamedTuple):
    """Contents of a source: level, module and names of each import; name -> module of those that
    it imports on request; strings that may name a file; lines of code.
    """

    imports: tuple[tuple[int, str, tuple[str, ...]], ...]
    lazy: dict[str, str]
    files: frozenset[str]
    code: bytes


def _counts(top: str, home: str) -> bool:
    """Whether a top-level package counts: surefoot, the module's own (`home`), or one that is not
    installed.
    """
    if top in (LIBRARY, home):
        return True
    folders = () if top in sys.stdlib_module_names else _folders(top)
    return bool(folders) and not any(INSTALLED & set(folder.parts) for folder in folders)


def _imported_late(base: str, names: tuple[str, ...], home: str) -> list[str]:
    """Modules that a package imports when these names are requested; "*" stands for all."""
    path = _source(base) if _counts(base.partition(".")[0], home) else None
    lazy = _contents(path).lazy if path else {}
    return [lazy[name] for name in (lazy if "*" in names else names) if name in lazy]


@cache
def _contents(path: Path) -> _Contents:
    imports: list[tuple[int, str, tuple[str, ...]]] = []
    lazy: dict[str, str] = {}
    source = path.read_bytes()
    if path.suffix != ".py":
        return _Contents((), {}, frozenset(), source)
    tree = ast.parse(source)
    texts: list[ast.expr | ast.Expr] = []
    typed: list[ast.ImportFrom] = []
    waiting: list[ast.AST] = [tree]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.Name | ast.expr_context | ast.operator):
            continue  # two thirds of all nodes, with nothing inside
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            texts.append(node)
            continue
        if isinstance(node, ast.Constant | ast.JoinedStr):
            texts.append(node)
        if isinstance(node, ast.If) and ast.unparse(node.test).endswith("TYPE_CHECKING"):
            waiting += node.orelse
            typed += [one for one in node.body if isinstance(one, ast.ImportFrom)]
            continue
        waiting += ast.iter_child_nodes(node)
        if isinstance(node, ast.Call) and ast.unparse(node.func).endswith("Registry"):
            imports += [(0, module, ()) for module in map(_member, ast.walk(node)) if module]
        if isinstance(node, ast.Import):
            for alias in node.names:
                imports.append((0, alias.name, ()))
                # Any attribute of the bound module may be used later.
                bound = alias.name if alias.asname else alias.name.partition(".")[0]
                imports.append((0, bound, ("*",)))
        elif isinstance(node, ast.ImportFrom):
            imports.append((node.level, node.module or "", tuple(a.name for a in node.names)))
    if b"__getattr__" in source:
        lazy = {a.asname or a.name: node.module or "" for node in typed for a in node.names}
    strings = {node.value for node in texts if isinstance(node, ast.Constant)}
    files = {one for one in strings if isinstance(one, str) and _FILE.fullmatch(one)}
    return _Contents(tuple(imports), lazy, frozenset(files), _code(source, texts))


def _code(source: bytes, texts: Iterable[ast.expr | ast.Expr]) -> bytes:
    """The lines of a source without docstrings, comment lines and empty lines."""
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
    """Whether a string is a statement by itself on its lines."""
    before = lines[node.lineno][: node.col_offset]
    after = lines[node.end_lineno or node.lineno][node.end_col_offset :]
    return isinstance(node, ast.Expr) and not before.strip() and not after.split(b"#")[0].strip()


def _member(node: ast.AST) -> str:
    """The module of a "module:attribute" string, "" for anything else."""
    value = node.value if isinstance(node, ast.Constant) else None
    found = _MEMBER.fullmatch(value) if isinstance(value, str) else None
    return found[1] if found else ""


@cache
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
    """The folders of a top-level package (several for a namespace package), or the file of a
    module.
    """
    try:
        spec = find_spec(top)
    except (ImportError, ValueError):  # `__main__`, and modules that were loaded without a spec
        return ()
    if spec is None:
        return ()
    if spec.submodule_search_locations is not None:
        return tuple(map(Path, spec.submodule_search_locations))
    return (Path(spec.origin),) if spec.has_location and spec.origin else ()
