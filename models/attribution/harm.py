"""Does an effect that was found make a channel worse on data that no fit has seen?"""

import numpy as np

from surefoot.models.attribution.evidence import Evidence, linearise
from surefoot.models.attribution.levels import channel_levels, without_bias
from surefoot.models.attribution.refinement import Data
from surefoot.sim.effects import Effect


def harmful_in(known: Data, declared: Evidence, report: np.ndarray) -> tuple[Effect, str] | None:
    """The first channel that is the worse for what was found (`ChannelLevel.worse`), and the effect
    without which least of it is left; None where there is no such channel.

    Args:
        known: the evidence with all effects, and the floor of a model with them.
        declared: with none.
        report: bins (M,) that no fit has seen.
    """
    weights = known.robust_weights

    def left(evidence: Evidence) -> np.ndarray:
        return without_bias(evidence, weights, ~report)[report]

    levels = channel_levels(left(declared), left(known.evidence), known.evidence, known.floor)
    worse = next((name for name, level in levels.items() if level.worse), None)
    if worse is None:
        return None

    def without(one: Effect) -> float:
        others = linearise(known.cases, [e for e in known.explained if e != one], ())
        return float(np.nanmean(left(others)[:, declared.layout.of(worse)] ** 2))

    return min(known.explained, key=without), worse
