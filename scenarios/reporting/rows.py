"""Rows of finished cases of a study, valid as long as all that determines them is unchanged.

A row is a JSON file under the name of its case that contains what determines it, so that a folder
of them is readable.
"""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from surefoot.sim.common.files import json_digest, kept_file, kept_json, say_made_again
from surefoot.sim.common.sources import sources_digest


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
        values["sha256"] = json_digest(row)
        with kept_file(folder / f"{name}.json") as temporary:
            temporary.write_text(json.dumps(values, indent=1, default=float), encoding="utf-8")
    return json.loads(json.dumps(row, default=float))


def read_case(
    folder: Path, name: str, inputs: Mapping[str, Any], module: str
) -> dict[str, Any] | None:
    """The row of a case finished by the same code; None where there is none, or a damaged one."""
    values = kept_json(folder / f"{name}.json")
    current = sources_digest(module), json.loads(json.dumps(inputs, default=float))
    if values is None or (values.get("code"), values.get("inputs")) != current:
        return None
    # Rows of surefoot 0.1.0 have no digest.
    if values.get("sha256") in (None, json_digest(values.get("row"))):
        return values.get("row")
    return say_made_again(folder / f"{name}.json")
