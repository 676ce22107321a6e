"""An effect found by a trace, with its confidence interval."""

from dataclasses import dataclass

from surefoot.sim.effects import Effect


@dataclass(frozen=True)
class Found:
    """An effect and the 95 % interval of its size."""

    effect: Effect
    interval: tuple[float, float]
