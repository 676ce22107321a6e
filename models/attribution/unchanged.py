"""What runs of one machine show in which nothing changed: the measure of whether it has changed.

No model is exact. What it lacks shows a little differently in every run, so that a single run has
sizes of its own of effects that no run has. Of a machine that was left alone for n runs, a size in
a new one is a change only beyond what theirs differ by.
"""

from collections.abc import Sequence

import numpy as np

from surefoot.models.attribution.evidence import Evidence, all_keys, linearise
from surefoot.models.attribution.fit import design, fit, normal_equations
from surefoot.models.attribution.levels import trimmed_rms
from surefoot.models.attribution.noise_floor import NoiseFloor, Unchanged
from surefoot.models.attribution.robust_weights import RobustWeights
from surefoot.models.attribution.zeros import Run
from surefoot.sim.effects import Effect

FEWEST_RUNS = 3
"""Runs from which it is told what runs differ by."""
LIKE_OTHERS = 4
"""Runs that the other candidates together count for, in what one differs by between a few runs."""


def unchanged(
    runs: Sequence[Run],
    effects: Sequence[Effect],
    floor: NoiseFloor,
    known: Evidence,
    left: np.ndarray,
    weights: RobustWeights,
) -> Unchanged | None:
    """What these runs of one machine differ by once `effects` are in its model; None of too few.

    A candidate's variance is moderated by that of all of them, each in units of its own noise
    (Smyth, Statistical Applications in Genetics and Molecular Biology 3, 2004).

    Args:
        runs: each with its zeros taken off.
        effects: that they share.
        floor: noise floor of the model with the effects.
        known: evidence of the runs with the effects.
        left: (M, W) of its table, less the free parts.
        weights: of its bins.
    """
    if len(runs) < FEWEST_RUNS:
        return None
    count, sigma = len(runs), floor.counted(weights.sigma)
    keys = [k for k in all_keys(runs[0].case) if all(k in all_keys(r.case) for r in runs)]
    size, precision = np.empty((2, count, len(keys)))
    for number, run in enumerate(runs):
        table = design(linearise([run.case], effects, keys))
        sums = normal_equations(table, sigma, weights.weight[known.log == number]).total()
        size[number] = [fit(sums, [key], errors=False).sizes[0] for key in keys]
        precision[number] = np.diag(sums.whole)[1 : 1 + len(keys)]
    square, precision = np.mean(size**2, axis=0), precision.mean(axis=0)
    told = precision > 0.0
    typical = np.median((square * precision)[told]) if told.any() else 0.0
    others = typical / np.where(told, precision, np.inf)
    variance = (count * square + LIKE_OTHERS * others) / (count - 1 + LIKE_OTHERS)
    deviation = np.sqrt(variance * (1.0 + 1.0 / count))
    differ = {k: float(one) for k, one in zip(keys, deviation, strict=True)}
    most = {}
    for name, columns in known.layout.channels.items():
        parts = [left[known.log == number][:, columns] for number in range(count)]
        levels = [trimmed_rms(part) for part in parts if np.isfinite(part).any()]
        if levels:
            most[name] = 2.0 * max(levels) - min(levels)
    return Unchanged(count, differ, most)
