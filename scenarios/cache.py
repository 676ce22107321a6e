"""Results of long computations that are kept on disk, valid as long as all that determines them is
unchanged.

The row of a case is a JSON file under the case's name that contains what determines it, so that a
folder of rows is readable. A product is a file named by a key, a hash of all that determines it;
its digest and facts are the row of that key.

What determines them are inputs and the source of the code that makes them. An input that is itself
a product enters by its contents, not by its key: changed code that reproduces the same bits
invalidates nothing downstream.
"""

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from surefoot.sim.common import files
from surefoot.sim.common.sources import sources_digest
from surefoot.sim.log import Log


@dataclass(frozen=True)
class Product:
    """A file in the cache, the SHA-256 of its contents, and some facts about it (plain JSON)."""

    path: Path
    digest: str
    facts: dict[str, Any]


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
        _write_case(folder / f"{name}.json", inputs, module, row)
    return json.loads(json.dumps(row, default=float))


def read_case(
    folder: Path, name: str, inputs: Mapping[str, Any], module: str
) -> dict[str, Any] | None:
    """The row of a case finished by the same code; None where there is none, or a damaged one."""
    values = files.kept_json(folder / f"{name}.json")
    current = sources_digest(module), json.loads(json.dumps(inputs, default=float))
    if values is None or (values.get("code"), values.get("inputs")) != current:
        return None
    row = values.get("row")
    intact = values.get("sha256") == files.json_digest(row)
    return row if intact else files.say_made_again(folder / f"{name}.json")


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
        suffix: of the file; not ".json", which is that of its row.
        make: writes the file at the given path and returns the facts.
    """
    files.private_folder(folder)
    key = product_key(kind, inputs, code)
    path = folder / kind / f"{key}{suffix}"
    row = read_case(path.parent, key, inputs, code)
    if row is None or not files.as_made(path, row["digest"]):
        with files.kept_file(path) as temporary:
            row = {"facts": make(temporary), "digest": files.file_digest(temporary)}
        # The row is written last: a file without one is incomplete and is made again.
        _write_case(path.parent / f"{key}.json", inputs, code, row)
    return Product(path, row["digest"], row["facts"])


def product_key(kind: str, inputs: Mapping[str, Any], code: str) -> str:
    """Name under which a product is stored."""
    return files.json_digest([kind, inputs, sources_digest(code)])[:32]


def contents_digest(log: Log) -> str:
    """SHA-256 of a log's columns and metadata."""
    about = json.dumps([list(log.frame), asdict(log.meta)], sort_keys=True, default=repr)
    rows = pd.util.hash_pandas_object(log.frame, index=False).to_numpy()
    return hashlib.sha256(about.encode() + rows.tobytes()).hexdigest()


def _write_case(path: Path, inputs: Mapping[str, Any], module: str, row: Mapping[str, Any]) -> None:
    code, digest = sources_digest(module), files.json_digest(row)
    values = {"code": code, "inputs": inputs, "row": row, "sha256": digest}
    with files.kept_file(path) as temporary:
        temporary.write_text(json.dumps(values, indent=1, default=float), encoding="utf-8")
