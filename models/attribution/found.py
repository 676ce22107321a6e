"""An effect found by a trace, with its confidence interval."""

from dataclasses import dataclass, replace

import numpy as np

from surefoot.sim.effects import Effect
from surefoot.sim.robot.limbs import Limbs


@dataclass(frozen=True)
class Found:
    """An effect and the 95 % interval of its size."""

    effect: Effect
    interval: tuple[float, float]


def with_clipped_size(one: Effect, value: float, limbs: Limbs) -> Effect:
    """The effect with its value clipped to its bounds on a machine with these limbs."""
    return replace(one, value=float(np.clip(value, *type(one).interior_bounds(one.target, limbs))))
