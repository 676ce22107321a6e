"""An effect found by a trace, with its confidence interval."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from surefoot.sim.effects import Effect
from surefoot.sim.robot.limbs import Limbs


@dataclass(frozen=True)
class Found:
    """An effect and the 95 % interval of its size."""

    effect: Effect
    interval: tuple[float, float]


def in_order(effects: Sequence[Effect]) -> tuple[Effect, ...]:
    """Effects in the order in which they are compensated: errors of sensors before those of the
    body, whose sizes are in true units.
    """
    return tuple(sorted(effects, key=lambda one: type(one).edit_spec is not Effect.edit_spec))


def with_clipped_size(one: Effect, value: float, limbs: Limbs) -> Effect:
    """The effect with its value clipped to its bounds on a machine with these limbs."""
    return replace(one, value=float(np.clip(value, *type(one).interior_bounds(one.target, limbs))))
