"""Where a training stands, on disk: a killed one goes on there, to the same bits."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import torch

from surefoot.models.observer.data import Walk
from surefoot.models.observer.observer import ObserverError
from surefoot.sim.common.files import whole_file

FORMAT = "surefoot training state"


@dataclass(frozen=True)
class State:
    """All that the next step depends on, after `step` of them.

    network, optimiser and best: state dicts; rng: the generator's state as JSON; score and rmse
    (3,) in m/s: those of `best` on the held-out rows; since: validations without a better one.
    """

    step: int
    network: dict[str, Any]
    optimiser: dict[str, Any]
    rng: str
    best: dict[str, Any]
    score: float
    rmse: list[float]
    since: int

    def save(self, path: Path, task: str) -> None:
        """Write it in place of an earlier one, whole or not at all; `task` says of what it is."""
        values = {"format": FORMAT, "task": task}
        values |= {field.name: getattr(self, field.name) for field in fields(self)}
        with whole_file(path, force=True) as temporary:
            torch.save(values, temporary)

    @classmethod
    def load(cls, path: Path, task: str) -> State | None:
        """The state at `path`, None where there is none or it is another task's.

        Raises ObserverError where the file is something else, which is then left alone.
        """
        if not path.exists():
            return None
        try:
            values: Any = torch.load(path, map_location="cpu", weights_only=True)
            if values["format"] != FORMAT:
                raise ValueError
            known = {field.name: values[field.name] for field in fields(cls)}
        except Exception as error:
            # torch raises many kinds here, depending on what the file turns out to be.
            raise ObserverError(
                f"{path}: not a training that was broken off; move it away, or delete it"
            ) from error
        return cls(**known) if values["task"] == task else None


def partial_path(observer: Path) -> Path:
    """Where the training of `observer` keeps its state: beside it, with `.partial` added."""
    return observer.with_name(observer.name + ".partial")


def task_digest(walks: Sequence[Walk], **settings: object) -> str:
    """SHA-256 of what decides a training's outcome: walks, settings, and torch's version."""
    settings["torch"] = torch.__version__
    digest = hashlib.sha256(json.dumps(settings, sort_keys=True).encode())
    for walk in walks:
        for tensor in (walk.x, walk.y, walk.learn, walk.held):
            digest.update(tensor.numpy().tobytes())
    return digest.hexdigest()
