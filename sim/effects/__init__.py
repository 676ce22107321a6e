"""Effects that a real robot has and a model may lack: one small class each, and their catalogue."""

# ruff: noqa: F401
from surefoot.sim.effects.base import AXES, Effect
from surefoot.sim.effects.catalogue import (
    CATALOGUE,
    add,
    compensate_all,
    declared_effects,
    effect,
    in_order,
    known_effects,
)
