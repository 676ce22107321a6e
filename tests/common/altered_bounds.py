"""Bounds files altered by hand whose digest fits: then it is their values that are judged."""

import json
from pathlib import Path
from typing import Any

from surefoot.sim.common.files import json_digest


def write_bounds(path: Path, values: dict[str, Any]) -> None:
    """Write the values of a bounds file, in place of their `digest` that of what they now say."""
    said = {name: value for name, value in values.items() if name != "digest"}
    path.write_text(json.dumps({"digest": json_digest(said)} | said))
