"""Which sources a module is made of: its own and those of every module that it imports in turn.

Compiled kernels and products of long runs are kept under a digest of them. Modules outside the
library and outside the package of the first one, numpy say, do not count.
"""

import ast
import hashlib
from functools import cache
from importlib.util import find_spec, resolve_name
from pathlib import Path

LIBRARY = "surefoot"


@cache
def sources_digest(module: str, file: str | None = None) -> str:
    """SHA-256 of the names and sources of `imported_sources`."""
    digest = hashlib.sha256()
    for name, path in sorted(imported_sources(module, file).items()):
        digest.update(name.encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()


def imported_sources(module: str, file: str | None = None) -> dict[str, Path]:
    """Name -> source file of a module and of all that it imports in turn.

    Args:
        module: its dotted name; a name that no source has yields nothing.
        file: its source, where Python cannot find it by name: a script, a test.

    Counts imports inside functions, relative ones, every package that a name lies in, and what a
    Registry names as "module:attribute"; not those for type checkers alone. Other imports that are
    made of strings are not seen.
    """
    found: dict[str, Path] = {}
    waiting = [module]
    packages = {LIBRARY, module.partition(".")[0]}
    while waiting:
        name = waiting.pop()
        if name in found or name.partition(".")[0] not in packages:
            continue
        path = Path(file) if file and name == module else _source(name)
        if path is None:
            continue
        found[name] = path
        is_package = path.name == "__init__.py"
        stat = path.stat()
        for level, base, names in _imports(path, stat.st_mtime_ns, stat.st_size):
            if level:
                package = name if is_package else name.rpartition(".")[0]
                base = resolve_name("." * level + base, package) if package else base
            # `from a import b`: b may be a module itself. A package runs before what lies in it.
            for one in (base, *(f"{base}.{n}" for n in names)):
                parts = one.split(".")
                waiting += [".".join(parts[: k + 1]) for k in range(len(parts))]
    return found


@cache
def _imports(path: Path, _changed: int, _size: int) -> tuple[tuple[int, str, tuple[str, ...]], ...]:
    """Level, module and names of each import of a source."""
    out: list[tuple[int, str, tuple[str, ...]]] = []
    waiting: list[ast.AST] = [ast.parse(path.read_bytes())]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.If) and ast.unparse(node.test).endswith("TYPE_CHECKING"):
            waiting += node.orelse
            continue
        waiting += ast.iter_child_nodes(node)
        if isinstance(node, ast.Call) and ast.unparse(node.func).endswith("Registry"):
            strings = (n.value for n in ast.walk(node) if isinstance(n, ast.Constant))
            out += [(0, s.partition(":")[0], ()) for s in strings if type(s) is str and ":" in s]
        if isinstance(node, ast.Import):
            out += [(0, alias.name, ()) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            out.append((node.level, node.module or "", tuple(a.name for a in node.names)))
    return tuple(out)


def _source(module: str) -> Path | None:
    top, _, rest = module.partition(".")
    folder = _folder(top)
    if folder is None:
        return None
    if folder.suffix == ".py":
        return None if rest else folder
    base = folder.joinpath(*rest.split(".")) if rest else folder
    for path in (base / "__init__.py", base.with_name(f"{base.name}.py")):
        if path.is_file():
            return path
    return None


@cache
def _folder(top: str) -> Path | None:
    """The folder of a top-level package, or the file of a top-level module."""
    try:
        spec = find_spec(top)
    except (ImportError, ValueError):  # `__main__`, and modules that were loaded without a spec
        return None
    if spec is None or not spec.origin or not spec.origin.endswith(".py"):
        return None
    origin = Path(spec.origin)
    return origin.parent if spec.submodule_search_locations else origin
