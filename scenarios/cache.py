"""Cache of results of long runs, valid as long as all that determines them is unchanged.

Products of experiments are files named by a key, a hash of all that determines them. Cases of
studies are JSON rows under a name that contain what determines them, so that a folder of them is
readable.

A key hashes the inputs of a product and the source of the code that makes it. An input that is
itself a product enters by its contents, not by its key: changed code that reproduces the same bits
invalidates nothing downstream.
"""

import hashlib
import json
import sys
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from surefoot.sim.common.files import file_digest, kept_file, private_folder
from surefoot.sim.common.sources import sources_digest
from surefoot.sim.log import Log


@dataclass(frozen=True)
class Product:
    """A file in the cache, the SHA-256 of its contents, and some facts about it (plain JSON)."""

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
    """Return the product of these inputs, from `folder` if it exists there, else newly made.

    Args:
        folder: the cache's.
        kind: of product; files of a kind share a folder.
        inputs: all that determines it, as JSON; for another product, its digest.
        code: the module that makes it, such as "surefoot.sim.walking.batch"; it and all its imports
            count.
        suffix: of the file.
        make: writes the file at the given path and returns the facts.
    """
    key = product_key(kind, inputs, code)
    private_folder(folder)
    path = folder / kind / f"{key}{suffix}"
    card = path.with_name(f"{key}.json") if suffix != ".json" else path.with_suffix(".card")
    found = _read(card, path)
    if found:
        return found
    with kept_file(path) as temporary:
        facts = make(temporary)
        digest = file_digest(temporary)
    # The card is written last: a file without one is incomplete and is made again.
    with kept_file(card) as temporary:
        values = {"inputs": dict(inputs), "digest": digest, "facts": facts}
        values["card"] = _json_digest(values)
        temporary.write_text(json.dumps(values, indent=1), encoding="utf-8")
    return Product(path, digest, facts)


def product_key(kind: str, inputs: Mapping[str, Any], code: str) -> str:
    """Name under which a product is stored."""
    text = json.dumps([kind, inputs, sources_digest(code)], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def contents_digest(log: Log) -> str:
    """SHA-256 of a log's columns and metadata."""
    about = json.dumps([list(log.frame), asdict(log.meta)], sort_keys=True, default=repr)
    rows = pd.util.hash_pandas_object(log.frame, index=False).to_numpy()
    return hashlib.sha256(about.encode() + rows.tobytes()).hexdigest()


def _read(card: Path, path: Path) -> Product | None:
    """The product of a card; None where either is missing or damaged."""
    try:
        values = json.loads(card.read_text(encoding="utf-8"))
        found = Product(path, values["digest"], values["facts"])
        if values.pop("card") == _json_digest(values) and file_digest(path) == found.digest:
            return found
        print(f"note: {path}: damaged since it was made, made again", file=sys.stderr)
    except FileNotFoundError:
        return None
    except (OSError, ValueError, KeyError, TypeError):
        print(f"note: {card}: cannot be read, made again", file=sys.stderr)
    return None


def _json_digest(values: Any) -> str:
    """SHA-256 of plain JSON."""
    text = json.dumps(values, sort_keys=True, default=float)
    return hashlib.sha256(text.encode()).hexdigest()


def finished_case(
    folder: Path,
    name: str,
    inputs: Mapping[str, Any],
    module: str,
    make: Callable[[], Mapping[str, Any]],
) -> dict[str, Any]:
    """Return the row of a case, from disk if the same code finished it, else newly made.

    Args:
        folder: of the study's rows; committed ones are in docs/data/STUDY.
        name: of the case, and of its file.
        inputs: all that determines the case besides the code, as JSON.
        module: dotted name of the module that runs it; it and all its imports count.
        make: runs the case and returns its row, as JSON.
    """
    row = read_case(folder, name, inputs, module)
    if row is None:
        row = dict(make())
        values = {"code": sources_digest(module), "inputs": inputs, "row": row}
        values["sha256"] = _json_digest(row)
        with kept_file(folder / f"{name}.json") as temporary:
            temporary.write_text(json.dumps(values, indent=1, default=float), encoding="utf-8")
    return json.loads(json.dumps(row, default=float))


def read_case(
    folder: Path, name: str, inputs: Mapping[str, Any], module: str
) -> dict[str, Any] | None:
    """The row of a case finished by the same code; None where there is none, or a damaged one."""
    try:
        values = json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    current = sources_digest(module), json.loads(json.dumps(inputs, default=float))
    if not isinstance(values, dict) or "row" not in values:
        return None
    if (values.get("code"), values.get("inputs")) != current:
        return None
    # Rows of surefoot 0.1.0 have no digest.
    whole = values.get("sha256") in (None, _json_digest(values["row"]))
    return values["row"] if whole else None
