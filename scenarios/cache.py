"""Cache of products of experiments, valid as long as all that determines them is unchanged.

A product is a file named by a key, a hash of all that determines it.

A key hashes the inputs of a product and the source of the code that makes it. An input that is
itself a product enters by its contents, not by its key: changed code that reproduces the same bits
invalidates nothing downstream.
"""

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from surefoot.sim.common.files import (
    as_made,
    file_digest,
    json_digest,
    kept_file,
    kept_json,
    private_folder,
    say_made_again,
)
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
        values["card"] = json_digest(values)
        temporary.write_text(json.dumps(values, indent=1), encoding="utf-8")
    return Product(path, digest, facts)


def product_key(kind: str, inputs: Mapping[str, Any], code: str) -> str:
    """Name under which a product is stored."""
    return json_digest([kind, inputs, sources_digest(code)])[:32]


def contents_digest(log: Log) -> str:
    """SHA-256 of a log's columns and metadata."""
    about = json.dumps([list(log.frame), asdict(log.meta)], sort_keys=True, default=repr)
    rows = pd.util.hash_pandas_object(log.frame, index=False).to_numpy()
    return hashlib.sha256(about.encode() + rows.tobytes()).hexdigest()


def _read(card: Path, path: Path) -> Product | None:
    """The product of a card; None where either is missing or damaged."""
    values = kept_json(card)
    if values is None:
        return None
    if values.pop("card", None) != json_digest(values):
        return say_made_again(card)
    whole = as_made(path, values["digest"])
    return Product(path, values["digest"], values["facts"]) if whole else None
