"""Effects that a real robot has and a model may lack: one small class each, and their catalogue."""

from surefoot.sim.effects.base import AXES, Effect
from surefoot.sim.effects.catalogue import (
    CATALOGUE,
    add,
    compensate_all,
    declared_effects,
    effect,
    known_effects,
)

__all__ = [
    "AXES",
    "CATALOGUE",
    "Effect",
    "add",
    "compensate_all",
    "declared_effects",
    "effect",
    "known_effects",
]
