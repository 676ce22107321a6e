"""Effects that a real robot has and a model may lack: one small class each, and their catalogue.

Imported on first use, since the names of the catalogue need neither MuJoCo nor the classes.
"""

# ruff: noqa: F401
from typing import TYPE_CHECKING

from surefoot.lazy import lazy_names

if TYPE_CHECKING:
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

__getattr__, __dir__ = lazy_names(globals())
