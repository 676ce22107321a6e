"""Products on disk, each under a key made of all that decides it: made once, found again.

A key hashes what the product is made from and the source of the code that makes it. An input that
is itself a product enters by its contents, not by its key: code that changed and made the same
bits again invalidates nothing further down.
"""

import ast
import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from sim.files import whole_file

ROOT = Path(__file__).parents[1]
ROOMS = ("sim", "models", "estimator", "scenarios")


@dataclass(frozen=True)
class Product:
    """A file in the cache, the SHA-256 of its contents, and a few facts of it (plain JSON)."""

    path: Path
    digest: str
    facts: dict[str, Any]


def product(
    folder: Path,
    kind: str,
    inputs: Mapping[str, Any],
    code: str,
    suffix: str,
    make: Callable[[Path], dict[str, Any]],
) -> Product:
    """The product of these inputs: read from `folder` where it is there, made where not.

    Args:
        folder: the cache's.
        kind: of product; files of a kind share a folder.
        inputs: all that decides it, as JSON; of another product, its digest.
        code: the module that makes it, such as "sim.batch"; it and all that it imports count.
        suffix: of the file.
        make: writes the file at the path it is given and returns the facts.
    """
    key = product_key(kind, inputs, code)
    path = folder / kind / f"{key}{suffix}"
    card = path.with_name(f"{key}.json") if suffix != ".json" else path.with_suffix(".card")
    found = _read(card, path)
    if found:
        return found
    with whole_file(path, force=True) as temporary:
        facts = make(temporary)
        digest = file_digest(temporary)
    # The card comes last: a file without one is one that a kill left, and is made again.
    with whole_file(card, force=True) as temporary:
        values = {"inputs": dict(inputs), "digest": digest, "facts": facts}
        temporary.write_text(json.dumps(values, indent=1), encoding="utf-8")
    return Product(path, digest, facts)


def product_key(kind: str, inputs: Mapping[str, Any], code: str) -> str:
    """The name under which a product is kept."""
    text = json.dumps([kind, inputs, code_digest(code)], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def file_digest(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


@cache
def code_digest(module: str) -> str:
    """SHA-256 of the sources of a module of surefoot and of all those that it imports in turn."""
    digest = hashlib.sha256()
    for name, path in sorted(imported_modules(module).items()):
        digest.update(name.encode() + path.read_bytes())
    return digest.hexdigest()


def imported_modules(module: str) -> dict[str, Path]:
    """The module and every module of surefoot that it imports in turn: name -> source file."""
    found: dict[str, Path] = {}
    waiting = [module]
    while waiting:
        name = waiting.pop()
        path = _source(name)
        if path is None or name in found:
            continue
        found[name] = path
        for node in ast.walk(ast.parse(path.read_bytes())):
            if isinstance(node, ast.Import):
                waiting += [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                # `from a import b`: b may be a module itself.
                waiting += [node.module, *(f"{node.module}.{a.name}" for a in node.names)]
    return found


def _source(module: str) -> Path | None:
    parts = module.split(".")
    if parts[0] not in ROOMS:
        return None
    path = ROOT.joinpath(*parts).with_suffix(".py")
    return path if path.is_file() else None


def _read(card: Path, path: Path) -> Product | None:
    try:
        values = json.loads(card.read_text(encoding="utf-8"))
        found = Product(path, values["digest"], values["facts"])
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return found if path.exists() else None
