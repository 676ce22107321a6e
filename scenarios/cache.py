"""Results of long runs on disk, each found again while all that decides it is as it was.

Products of experiments are files named by a key, a hash of all that decides them; cases of studies
are JSON rows by a name, which hold what decides them, so that a folder of them can be read.

A key hashes what the product is made from and the source of the code that makes it. An input that
is itself a product enters by its contents, not by its key: code that changed and made the same
bits again invalidates nothing further down.
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
        code: the module that makes it, such as "surefoot.sim.walking.batch"; it and all that it
        imports count.
        suffix: of the file.
        make: writes the file at the path it is given and returns the facts.
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
    # The card comes last: a file without one is one that a kill left, and is made again.
    with kept_file(card) as temporary:
        values = {"inputs": dict(inputs), "digest": digest, "facts": facts}
        values["card"] = _json_digest(values)
        temporary.write_text(json.dumps(values, indent=1), encoding="utf-8")
    return Product(path, digest, facts)


def product_key(kind: str, inputs: Mapping[str, Any], code: str) -> str:
    """The name under which a product is kept."""
    text = json.dumps([kind, inputs, sources_digest(code)], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def contents_digest(log: Log) -> str:
    """SHA-256 of all that a log holds: its columns, and what it says of itself."""
    about = json.dumps([list(log.frame), asdict(log.meta)], sort_keys=True, default=repr)
    rows = pd.util.hash_pandas_object(log.frame, index=False).to_numpy()
    return hashlib.sha256(about.encode() + rows.tobytes()).hexdigest()


def _read(card: Path, path: Path) -> Product | None:
    """The product that a card names, None where either is missing or not as it was written."""
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
    """The row of a case: read where it was finished by the same code, else made and written.

    Args:
        folder: of the study's rows; committed ones lie in docs/data/STUDY.
        name: of the case, and of its file.
        inputs: all that decides the case beside the code, as JSON.
        module: dotted name of the module that runs it; it and all that it imports count.
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
    """The row of a case that the same code finished, None where there is none, or a damaged one."""
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
