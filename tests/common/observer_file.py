"""The contents of an observer's file, to alter and write again."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import safe_open
from safetensors.numpy import save_file


def observer_contents(path: Path) -> dict[str, Any]:
    """Plain values and arrays by name; weights and legs are dicts of arrays."""
    values: dict[str, Any] = {"weights": {}, "legs": {}}
    with safe_open(path, "numpy") as file:
        for name in file.keys():  # noqa: SIM118
            group, dot, key = name.partition(".")
            (values[group] if dot else values)[key or name] = file.get_tensor(name)
        return json.loads(file.metadata()["surefoot"]) | values


def write_observer(path: Path, values: dict[str, Any]) -> None:
    arrays, about = {}, {}
    for name, value in values.items():
        if isinstance(value, dict):
            arrays |= {f"{name}.{key}": np.array(one) for key, one in value.items()}
        elif isinstance(value, np.ndarray):
            arrays[name] = value.copy()
        else:
            about[name] = value
    save_file(arrays, path, {"surefoot": json.dumps(about)})
