"""Observers that surefoot stored as files of torch, up to 0.1.0: reading one, to convert it."""

from pathlib import Path
from typing import Any

import torch

from surefoot.models.observer.observer import Observer, ObserverError, checked_observer
from surefoot.sim.common.limits import admitted

TORCH_SCHEMA = 2


def observer_of_torch(path: str | Path) -> Observer:
    """Read a file of torch. Raises SurefootError, one line, where it is no observer, or damaged."""
    path = admitted(path, "piece")
    try:
        values: Any = torch.load(path, map_location="cpu", weights_only=True)
        # Those from before leg odometry have no legs.
        content = {"legs": {}} | {name: _in_numpy(value) for name, value in values.items()}
    except Exception as error:
        # torch raises many types here, depending on the file's contents.
        raise ObserverError(f"{path}: not a surefoot observer, or a damaged one") from error
    return checked_observer(content, TORCH_SCHEMA, path)


def _in_numpy(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _in_numpy(one) for name, one in value.items()}
    return value.numpy() if isinstance(value, torch.Tensor) else value
