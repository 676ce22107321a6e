"""Finished cases of long studies, a small JSON row each: a stopped study goes on from them.

Rows are kept with the code that made them: where that, or what a case is made from, has changed,
the case is run again.
"""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from surefoot.sim.common.files import whole_file
from surefoot.sim.common.sources import sources_digest


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
        with whole_file(folder / f"{name}.json", force=True) as temporary:
            temporary.write_text(json.dumps(values, indent=1, default=float), encoding="utf-8")
    return json.loads(json.dumps(row, default=float))


def read_case(
    folder: Path, name: str, inputs: Mapping[str, Any], module: str
) -> dict[str, Any] | None:
    """The row of a case that the same code finished, None where there is none."""
    try:
        values = json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    current = sources_digest(module), json.loads(json.dumps(inputs, default=float))
    return values["row"] if (values.get("code"), values.get("inputs")) == current else None
