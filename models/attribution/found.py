"""An effect that the model lacks, as a trace gives it."""

from dataclasses import dataclass

from surefoot.sim.effects import Effect


@dataclass(frozen=True)
class Found:
    """An effect with the 95 % interval of its size."""

    effect: Effect
    interval: tuple[float, float]
